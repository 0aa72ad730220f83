"""The folder of an episode: one file per attempt, written once, never changed.

`episode.json` says with which settings it was begun; `touch_00000.npz` and so on hold
one attempt each: `record` (JSON) and, where a frame was taken, `image`. A file gets
its name only when all of it is on the disk, so a program or a machine that dies at
any moment leaves every recorded attempt whole; what it had not named yet is swept
away when the episode goes on.
"""

import json
import os
import re
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np

from ._record import TouchRecord

_FORMAT = 1
_TOUCH = re.compile(r"touch_(\d{5,})\.npz")
_PARTIAL = ".partial-"
_LOCK = ".lock"


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
        _make_folder(self.folder)
        self._lock = _locked(self.folder)
        try:
            for partial in self.folder.glob(f"{_PARTIAL}*"):
                partial.unlink()
            self._begin_or_compare(self.folder)
            self.history = read_episode(self.folder)
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
            arrays: dict[str, Any] = {"record": np.array(json.dumps(record.as_plain()))}
            if record.image is not None:
                arrays["image"] = record.image
            path = self.folder / f"touch_{len(self.history):05d}.npz"
            write_whole(path, lambda file: np.savez(file, **arrays))
        self.history.append(record)

    def _begin_or_compare(self, folder: Path) -> None:
        path = folder / "episode.json"
        wanted = json.loads(json.dumps({"format": _FORMAT, "settings": self.settings}))
        if not path.exists():
            _refuse_strangers(folder)
            text = json.dumps(wanted, indent=1).encode()
            write_whole(path, lambda file: file.write(text))
            return
        found = _read_settings(path)
        if found != wanted:
            raise EpisodeError(
                f"{folder} holds an episode that was begun with {found}, got "
                f"{wanted}. Go on with the same settings, or use another folder."
            )


def read_episode(folder: str | Path) -> list[TouchRecord]:
    """Return all recorded attempts of an episode, in order.

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


def write_whole(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file under another name, flush it to the disk, then name it."""
    partial = path.with_name(f"{_PARTIAL}{secrets.token_hex(6)}")
    try:
        with partial.open("xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        with suppress(OSError):
            partial.unlink()
    with suppress(OSError):  # Folders cannot be opened on every system.
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _read_record(path: Path) -> TouchRecord:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            plain = json.loads(str(arrays["record"]))
            image = arrays.get("image")
            return TouchRecord.from_plain(plain, image)
    except Exception as error:
        raise EpisodeError(
            f"{path} is damaged: {type(error).__name__}: {error}. Take the attempts "
            "before it into a new folder, or bring the file back."
        ) from error


def _read_settings(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise EpisodeError(f"{path} is damaged: {error}. Bring it back.") from error


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        upward = (folder, *folder.parents)
        file = next(path for path in upward if path.exists() and not path.is_dir())
        raise EpisodeError(
            f"folder must be a folder or a new name, got the file {str(file)!r}. Use "
            "another folder."
        ) from error


def _refuse_strangers(folder: Path) -> None:
    """Begin an episode only where nothing else is."""
    others = sorted(p.name for p in folder.iterdir() if p.name != _LOCK)
    if others:
        raise EpisodeError(
            f"{folder} must be empty or an episode, got {others[0]!r} in it. "
            "Use another folder."
        )


def _locked(folder: Path) -> IO[bytes]:
    """Open the lock of a folder; the system gives it back when a program dies."""
    lock = (folder / _LOCK).open("ab")
    try:
        import fcntl
    except ImportError:  # Windows: nothing keeps two programs apart.
        return lock
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise EpisodeError(
            f"{folder} is in use: another program adds to this episode. Wait for it "
            "or use another folder."
        ) from error
    return lock
