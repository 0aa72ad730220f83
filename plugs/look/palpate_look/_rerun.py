"""Rerun: images, a series of each object's posterior, decisions as lines of text."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._log import Belief, Log, nanoseconds

Array = NDArray[Any]
_RGB = ("r", "g", "b")


class RerunLog(Log):
    """A recording of Rerun, `.rrd`; `Log` explains the rest.

    Entities: `tactile` and `touch` (an image; with channels other than r, g and b a
    tensor), `belief/OBJECT`, `unknown/probability` (numbers), `decision`
    (text). Values have the type that they have in the sensor. Timelines: `time`, and
    `touch`, counted through all episodes.

    Raises
    ------
    ImportError
        rerun-sdk is missing.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            import rerun
        except ImportError as error:
            raise ImportError(
                "A recording for Rerun needs rerun, which is not installed: "
                "pip install rerun-sdk"
            ) from error
        super().__init__(path)
        self._rerun, self._n_touches = rerun, 0
        self._to = rerun.RecordingStream("palpate", recording_id=self.path.stem)
        self._to.save(self.path)

    def _image(
        self, name: str, image: Array, time_s: float, channels: Sequence[str] | None
    ) -> None:
        self._at(time_s)
        if image.ndim == 2:
            self._to.log(name, self._rerun.Image(image, "L"))
        elif tuple(channels or ()) == _RGB:
            self._to.log(name, self._rerun.Image(image, "RGB"))
        else:
            names = "row", "column", "channel"
            self._to.log(name, self._rerun.Tensor(image, dim_names=names))

    def _belief(self, belief: Belief, time_s: float) -> None:
        self._n_touches += 1
        self._at(time_s)
        self._to.set_time("touch", sequence=self._n_touches)
        path, number = self._rerun.new_entity_path, self._rerun.Scalars
        for label, share in belief["posterior"].items():
            self._to.log(path(["belief", label]), number(share))
        if belief["unknown"] is not None:
            self._to.log("unknown/probability", number(belief["unknown"]))

    def _decision(self, words: str, time_s: float) -> None:
        self._at(time_s)
        self._to.log("decision", self._rerun.TextLog(words, level="INFO"))

    def _at(self, time_s: float) -> None:
        self._to.reset_time()
        self._to.set_time("time", timestamp=np.datetime64(nanoseconds(time_s), "ns"))

    def _end(self) -> None:
        self._to.flush()
        self._to.disconnect()
