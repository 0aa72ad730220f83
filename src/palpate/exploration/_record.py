"""What is kept of each attempt to touch, and the folder that keeps an episode.

In the folder `episode.json` says with which settings it was begun; `touch_00000.npz`
and so on hold one attempt each, written once and never changed: `record` (JSON) and,
where a frame was taken, `image`. A file gets its name only when all of it is on the
disk, so a program or a machine that dies at any moment leaves every recorded attempt
whole; what it had not named yet is swept away when the episode goes on.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_option
from .._durable import PARTIAL, lock, replacing, write_text
from .._types import Array, Floats
from ..sensors import channels_of
from ..simulation import SensorPose
from ..touches import Touches

_FORMAT = 1
_TOUCH = re.compile(r"touch_(\d{5,})\.npz")
_LOCK = ".lock"
_MOST_BYTES = 2**29  # of one attempt: any camera's image as doubles
OUTCOMES = (
    "touched",
    "nothing",
    "force not reached",
    "force sensor",
    "limit exceeded",
    "timed out",
    "no frame",
    "robot error",
)
_NUMBERS = ("force_n", "peak_force_n", "travel_mm", "duration_s")
_NOTES = ("message", "retracted")
# Directions may have been written with a few digits.
_LENGTH_TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class TouchRecord:
    """One attempt to touch.

    Attributes
    ----------
    outcome : str
        "touched": the force was reached and a frame taken. "nothing": nothing was
        met on the whole way. Any other of `OUTCOMES` is a fault, said in `message`;
        "force not reached" where the line ended in too light a contact.
    start : SensorPose
        Where the approach began.
    position_mm : tuple of float
        Where the tip was at the end of the approach, before it was pulled back; after a
        fault on the way to the start, that start, which was not reached.
    force_n : float
        Force there, offset removed; of the last readings that were taken.
    peak_force_n : float
        Magnitude of the greatest single reading of the approach, offset removed; of a
        way to the start as it was read.
    travel_mm : float
        Length of the approach.
    duration_s : float
        From the start of the approach until the arm was back.
    image : ndarray of shape (n_rows, n_cols[, 3]) or None
        The frame, where one was taken.
    message : str
        What went wrong, else empty.
    retracted : bool
        Whether the arm is known to be back.
    """

    outcome: str
    start: SensorPose
    position_mm: tuple[float, float, float]
    force_n: float = 0.0
    peak_force_n: float = 0.0
    travel_mm: float = 0.0
    duration_s: float = 0.0
    image: Array | None = None
    message: str = ""
    retracted: bool = True

    @property
    def touched(self) -> bool:
        """Whether there is a frame of a touch."""
        return self.outcome == "touched"

    @property
    def faulty(self) -> bool:
        """Whether something went wrong, beyond finding nothing."""
        return self.outcome not in ("touched", "nothing")

    @property
    def direction(self) -> Floats:
        """Way in which the sensor was pushed, of length 1, (3,)."""
        return np.asarray(self.start.direction)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the image as plain values for JSON."""
        return {
            "outcome": self.outcome,
            "start_mm": np.asarray(self.start.position_mm).tolist(),
            "direction": self.direction.tolist(),
            "roll_rad": float(self.start.roll_rad),
            "position_mm": list(self.position_mm),
            **{name: float(getattr(self, name)) for name in _NUMBERS},
            **{name: getattr(self, name) for name in _NOTES},
        }

    @classmethod
    def from_dict(cls, plain: dict[str, Any], image: Array | None) -> Self:
        """Rebuild a record from `to_dict` and its image."""
        return cls(
            outcome=check_option("outcome", plain["outcome"], OUTCOMES),
            start=SensorPose(plain["start_mm"], plain["direction"], plain["roll_rad"]),
            position_mm=tip_mm(SensorPose(plain["position_mm"], plain["direction"])),
            image=image,
            message=str(plain["message"]),
            retracted=bool(plain["retracted"]),
            **{name: float(plain[name]) for name in _NUMBERS},
        )


History = Sequence[TouchRecord]


def tip_mm(pose: SensorPose) -> tuple[float, float, float]:
    x, y, z = np.asarray(pose.position_mm)
    return float(x), float(y), float(z)


def as_touches(
    history: History,
    *,
    object: str | None = None,
    category: str | None = None,
    geometry: str | None = None,
) -> Touches:
    """Return the records that are touches, ready to be learnt or recognised.

    Columns: `position_mm` and `direction`, both (n_touches, 3), `force_n`, `order`
    (number of the attempt), and the labels given. ValueError where there is none, or
    frames are missing or of several sizes.
    """
    order = [number for number, record in enumerate(history) if record.touched]
    if not order:
        raise ValueError(
            f"history must hold a touch, got {len(history)} attempts without one. "
            "Look at their outcomes and messages."
        )
    touched = [history[number] for number in order]
    shapes = [np.asarray(record.image).shape for record in touched]
    if len({*shapes}) > 1 or () in shapes:
        listed = " and ".join(map(str, sorted({*shapes})))
        raise ValueError(
            f"history must hold frames of one shape, got {listed}. Take the touches of "
            "one sensor."
        )
    labels = {"object": object, "category": category}
    images = np.stack([np.asarray(record.image) for record in touched])
    return Touches(
        images,
        channels=channels_of(images.shape[1:]),
        position_mm=[record.position_mm for record in touched],
        direction=np.stack([record.direction for record in touched]),
        force_n=[record.force_n for record in touched],
        order=order,
        geometry=geometry,
        **{name: [word] * len(touched) for name, word in labels.items() if word},
    )


def places_of(touches: object, places: ArrayLike | None, n_turns: int) -> Floats:
    """Return the places of touches, (n_touches, n_dimensions), or explain."""
    if not isinstance(touches, Touches):
        raise TypeError(
            f"touches must be Touches, got {type(touches).__name__}. Write "
            "Touches(images, direction=...)."
        )
    if places is None:
        directions = touches.columns.get("direction")
        if directions is None:
            raise ValueError(
                "touches must have a column 'direction' (unit vectors of approach), "
                f"got {', '.join(touches.columns) or 'none'}. Add it, or give places."
            )
        places = -np.asarray(directions, dtype=np.float64)
        length = np.sqrt((places**2).sum(axis=-1))
        wrong = np.flatnonzero(np.abs(length - 1) > _LENGTH_TOLERANCE)
        if len(wrong):
            raise ValueError(
                "direction must be unit vectors of approach, got "
                f"{(-places[wrong[0]]).tolist()} in touch {wrong[0]}. Divide it by its "
                "length; leave out touches whose direction is not known."
            )
    array = np.asarray(places, dtype=np.float64)
    if array.ndim != 2 or len(array) != len(touches) or not np.isfinite(array).all():
        raise ValueError(
            f"places must be finite, one row for each of {len(touches)} touches, got "
            f"shape {array.shape}."
        )
    if n_turns > 1 and array.shape[1] != 3:
        raise ValueError(
            f"places must be x, y, z to be turned, got {array.shape[1]} numbers each. "
            "Use TouchMap(n_turns=1) for places that do not turn."
        )
    return array


class EpisodeError(ValueError):
    """A folder that is no episode, is damaged, or belongs to another one."""


class EpisodeLog:
    """An episode on disk, open for adding attempts.

    Used as a context manager, so that one program at a time adds to it.

    Parameters
    ----------
    folder : path or None
        Made where there is none; an episode that was begun there goes on. None
        keeps the attempts in memory alone.
    settings : mapping, default={}
        Plain values that must be the same when the episode goes on.

    Attributes
    ----------
    history : list of TouchRecord
        All attempts so far, in order.

    Raises
    ------
    EpisodeError
        On entering: the folder is a file, holds an episode with other settings, a
        damaged attempt, gaps, or another program is adding to it.
    """

    def __init__(
        self, folder: str | Path | None, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.folder = None if folder is None else Path(folder)
        self.settings = dict(settings or {})
        self.history: list[TouchRecord] = []
        self._lock: IO[bytes] | None = None

    def __enter__(self) -> Self:
        if self.folder is None:
            return self
        make_folder(self.folder)
        self._lock = (self.folder / _LOCK).open("ab")
        try:
            if not lock(self._lock):
                raise EpisodeError(
                    f"{self.folder} is in use: another program adds to this episode. "
                    "Wait for it or use another folder."
                )
            for partial in self.folder.glob(f"{PARTIAL}*"):
                partial.unlink()
            self._begin_or_compare(self.folder)
            self.history = read_episode(self.folder)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def append(self, record: TouchRecord) -> None:
        """Add one attempt; it is on the disk when this returns."""
        if self.folder is not None:
            if self._lock is None:
                raise EpisodeError(
                    f"{self.folder} is not open. Use `with EpisodeLog(...)`."
                )
            arrays: dict[str, Any] = {"record": np.array(json.dumps(record.to_dict()))}
            if record.image is not None:
                arrays["image"] = record.image
            path = self.folder / f"touch_{len(self.history):05d}.npz"
            try:
                _write(path, arrays)
            except KeyboardInterrupt:  # the touch is made: kept before that goes on
                _write(path, arrays)
                self.history.append(record)
                raise
        self.history.append(record)

    def _begin_or_compare(self, folder: Path) -> None:
        path = folder / "episode.json"
        header = json.loads(json.dumps({"format": _FORMAT, "settings": self.settings}))
        if not path.exists():
            others = sorted(p.name for p in folder.iterdir() if p.name != _LOCK)
            if others:
                raise EpisodeError(
                    f"{folder} must be empty or an episode, got {others[0]!r} in it. "
                    "Use another folder."
                )
            write_text(path, json.dumps(header, indent=1))
            return
        try:
            stored = json.loads(path.read_bytes())
        except (ValueError, RecursionError) as error:
            raise EpisodeError(f"{path} is damaged: {error}. Bring it back.") from error
        if stored != header:
            raise EpisodeError(
                f"{folder} holds an episode that was begun with {stored}, got "
                f"{header}. Go on with the same settings, or use another folder."
            )


def read_episode(folder: str | Path) -> list[TouchRecord]:
    """Return all recorded attempts of the episode in `folder`, in order.

    Raises
    ------
    EpisodeError
        There is no episode, an attempt is missing, or a file is damaged.
    """
    path = Path(folder)
    if not (path / "episode.json").is_file():
        raise EpisodeError(f"{path} must be the folder of an episode, got none there.")
    numbered = {
        int(match[1]): file
        for file in path.iterdir()
        if (match := _TOUCH.fullmatch(file.name))
    }
    missing = set(range(len(numbered))) - set(numbered)
    if missing:
        raise EpisodeError(
            f"{path} must hold every attempt from 0 on, got no "
            f"touch_{min(missing):05d}. Bring the file back."
        )
    return [_read_record(numbered[number]) for number in sorted(numbered)]


def _write(path: Path, arrays: Mapping[str, Any]) -> None:
    with replacing(path) as file:
        np.savez(file, **arrays)


def _read_record(path: Path) -> TouchRecord:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            n_bytes = sum(member.file_size for member in arrays.zip.infolist())
            if n_bytes > _MOST_BYTES:
                raise ValueError(f"at most {_MOST_BYTES} bytes are read, got {n_bytes}")
            plain = json.loads(str(arrays["record"]))
            return TouchRecord.from_dict(plain, arrays.get("image"))
    except Exception as error:
        raise EpisodeError(
            f"{path} is damaged: {type(error).__name__}: {error}. Take the attempts "
            "before it into a new folder, or bring the file back."
        ) from error


def make_folder(folder: Path) -> None:
    """Make a folder of episodes; `EpisodeError` says that a file is there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        upward = (folder, *folder.parents)
        # A link to nothing is there, though what it leads to is not.
        file = next(
            path for path in upward if os.path.lexists(path) and not path.is_dir()
        )
        raise EpisodeError(
            f"folder must be a folder or a new name, got the file {str(file)!r}. Use "
            "another folder."
        ) from error
