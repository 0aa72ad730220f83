"""What every log takes: frames, touches with beliefs, and events of a live session."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from palpate import ObjectRecogniser, Touches

Array = NDArray[Any]
Belief = dict[str, Any]
_STEP_S = 1.0  # between touches whose times are not known


class Log(ABC):
    """Where frames, touches and beliefs are written to, from several threads.

    Parameters
    ----------
    path : path, optional
        The file; it must not exist. None where nothing is kept.

    Raises
    ------
    FileExistsError
        There is such a file.

    Notes
    -----
    Times are in seconds since 1970. A belief has the keys `episode`, `touch`,
    `posterior` (probability of each object), `unknown` (of none of them), `best`,
    `decision` (an object, "unknown", or None) and `reason`, a sentence.
    """

    def __init__(self, path: str | Path | None = None) -> None:
        self.path = Path(path or "nothing")
        self._lock, self._failed = threading.Lock(), ""
        self._decided: tuple[Any, Any] = None, None
        if path is None:
            return
        if self.path.exists():
            raise FileExistsError(
                f"{self.path} exists already. Name another, or delete it."
            )
        self.path.parent.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def frame(
        self, image: Array, time_s: float, channels: Sequence[str] | None = None
    ) -> None:
        """Write a frame, (n_rows, n_cols[, n_channels])."""
        with self._lock:
            self._image("tactile", image, time_s, channels)

    def touch(
        self,
        image: Array,
        time_s: float,
        belief: Belief,
        channels: Sequence[str] | None = None,
    ) -> None:
        """Write a touch, the belief after it and, where it is new, the decision."""
        with self._lock:
            self._image("touch", image, time_s, channels)
            self._belief(belief, time_s)
            now = belief["episode"], belief["decision"]
            if belief["decision"] is not None and now != self._decided:
                sentence = f"episode {belief['episode']}: {belief['decision']}"
                self._decision(f"{sentence}. {belief['reason']}", time_s)
            self._decided = now

    def take(self, event: Any) -> None:
        """Take an event of a `LiveSession`, as its `listeners` are sent them."""
        if self._failed or event.image is None:
            return
        try:
            if event.kind == "frame":
                self.frame(event.image, time.time(), event.channels)
            elif event.kind == "touch":
                episode = event.values["episode"]
                (touch,) = episode["touches"]
                kept = {key: touch[key] for key in ("posterior", "unknown")}
                kept |= {key: episode[key] for key in ("best", "decision", "reason")}
                about = {"episode": episode["number"], "touch": touch["number"]}
                self.touch(event.image, touch["time_s"], about | kept, event.channels)
        except OSError as error:  # reported when it is closed; the session goes on
            self._failed = str(error)

    def close(self) -> None:
        """End the file.

        Raises
        ------
        OSError
            Not all could be written.
        """
        with self._lock:
            self._end()
        if self._failed:
            raise OSError(f"{self.path} is not whole: {self._failed}")

    @abstractmethod
    def _image(
        self, name: str, image: Array, time_s: float, channels: Sequence[str] | None
    ) -> None: ...

    @abstractmethod
    def _belief(self, belief: Belief, time_s: float) -> None: ...

    @abstractmethod
    def _decision(self, words: str, time_s: float) -> None: ...

    @abstractmethod
    def _end(self) -> None: ...


def nanoseconds(time_s: float) -> int:
    """Return seconds since 1970 as whole nanoseconds, exact where the float is."""
    whole = int(time_s // 1)
    return whole * 10**9 + round((time_s - whole) * 1e9)


def open_log(path: str | Path) -> Log:
    """Return the log that a file's ending stands for: `.rrd` or `.mcap`.

    Raises
    ------
    ValueError
        It ends otherwise.
    """
    from . import FoxgloveLog, RerunLog

    kinds: dict[str, type[Log]] = {".rrd": RerunLog, ".mcap": FoxgloveLog}
    suffix = Path(path).suffix.lower()
    if suffix not in kinds:
        endings = " or ".join(kinds)
        raise ValueError(f"The file must end in {endings}, got {Path(path).name!r}.")
    return kinds[suffix](path)


def log_episodes(
    path: str | Path,
    recogniser: ObjectRecogniser,
    touches: Touches,
    error: float = 0.01,
) -> int:
    """Recognise touches, an episode per object and session, and write it all.

    Times are `time_s` of the touches, else a second a touch.

    Returns
    -------
    int
        How many episodes.
    """
    evidence = recogniser.evidence(touches)
    times = touches.columns.get("time_s")
    if times is None or not np.isfinite(times).all():
        times = _STEP_S * np.arange(len(touches))
    number = 0
    with open_log(path) as log:
        for number, (label, _, rows) in enumerate(touches.episodes(), start=1):
            episode = recogniser.episode(error=error)
            for count, row in enumerate(rows, start=1):
                episode.add(evidence.of_touch(row))
                belief = {
                    "episode": number,
                    "touch": count,
                    "object": label,
                    "posterior": episode.belief.posterior,
                    "unknown": episode.belief.unknown,
                    "best": episode.belief.best,
                    "decision": episode.decision,
                    "reason": episode.sentence,
                }
                log.touch(
                    touches.images[row], float(times[row]), belief, touches.channels
                )
    return number
