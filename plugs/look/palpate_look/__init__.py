"""Frames, touches and beliefs, written for Rerun (.rrd) and Foxglove (.mcap, ws://).

`python -m palpate_look MODEL TOUCHES -o FILE` writes what a model believes of touches;
`palpate live --log FILE` and `palpate serve --log FILE` write a live sensor, which this
package's entry points (group `palpate.logs`, named by the file's ending) make work.
"""

from ._foxglove import FoxgloveLive, FoxgloveLog
from ._log import Log, log_episodes, open_log
from ._rerun import RerunLog

__all__ = ["FoxgloveLive", "FoxgloveLog", "Log", "RerunLog", "log_episodes", "open_log"]
