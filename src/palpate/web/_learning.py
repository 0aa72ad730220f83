"""Learning in a process of its own, so that frames go on.

The other process stays for the next lesson: starting it takes longer than learning a
few touches. It reads jobs as lines of JSON from standard input, writes the model file
all or nothing, and answers each with a line.
"""

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from threading import Lock
from typing import Any

import numpy as np
from sklearn.base import clone

from .._checks import size_text
from .._types import Array
from ..library import LibraryError, TouchLibrary, TouchRow
from ..recognition import (
    EmptyTouchError,
    Memory,
    ObjectRecogniser,
)
from ..sensors import SensorMemory
from ..touches import TouchSource

LEAST_OBJECTS, LEAST_TOUCHES = 2, 2
# So many touches, spread over all, show what a sensor answers, read so many at once.
_ENOUGH, _AT_ONCE = 200, 16
_NOT_FURTHER = (
    "The model must be of the sensor's {new} to be learnt further, but it knows "
    "{names} from images of {old}, and their touches are not in the library. Forget "
    "those, or start with another `model`."
)


class LearningError(ValueError):
    """Nothing could be learnt; the message says what is missing."""


def learn_in_process(*job: Any) -> dict[str, Any]:
    """Do what `learn_job` does, in another process."""
    answer = _LEARNER.ask(job)
    if "refused" in answer:
        raise LearningError(answer["refused"])
    return answer


def start_learning() -> None:
    """Start the process that learns, so that the first lesson need not wait for it."""
    _LEARNER.start()


class _Learner:
    """The process that learns, one job at a time."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start the process where there is none; one that is busy is there."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._running()
        finally:
            self._lock.release()

    def ask(self, job: Sequence[Any]) -> dict[str, Any]:
        """Return the answer to a job; a process that ended is replaced by the next."""
        with self._lock:
            process = self._running()
            assert process.stdin is not None
            assert process.stdout is not None
            with suppress(OSError):  # it has ended, and says nothing below
                # Folders and files as text.
                print(json.dumps(job, default=str), file=process.stdin, flush=True)
            try:
                answer: dict[str, Any] = json.loads(process.stdout.readline())
            except ValueError as error:
                self.stop()
                how = f"its process ended with {process.returncode}"
                why = "; was memory short?" if process.returncode == -9 else "."
                raise LearningError(
                    f"Learning ended without a model: {how}{why}"
                ) from error
            return answer

    def stop(self) -> None:
        """End the process, whatever it does: a model is written whole or not at all."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            process.communicate()

    def _running(self) -> "subprocess.Popen[str]":
        if self._process is None or self._process.poll() is not None:
            self.stop()
            self._process = subprocess.Popen(
                [sys.executable, "-c", f"from {__name__} import main; main()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._process


_LEARNER = _Learner()
atexit.register(_LEARNER.stop)


def of_size(image_shape: Sequence[int]) -> str:
    """Return a filter of the touches whose images have this shape."""
    n_rows, n_cols, *more = image_shape
    channels = f"= {more[0]}" if more else "is null"
    return f"n_rows = {n_rows} and n_cols = {n_cols} and n_channels {channels}"


def newest_row(library: TouchLibrary) -> TouchRow | None:
    """Return the touch that was added last, None without any."""
    rows = library.list(limit=1, offset=max(0, len(library) - 1))
    return rows[0] if rows else None


def learn_job(
    library: str | Path,
    output: str | Path,
    base: str | Path | None = None,
    changes: Sequence[tuple[str, str]] = (),
    image_shape: tuple[int, ...] | None = None,
) -> dict[str, Any]:
    """Learn what a library holds into the model file `output`.

    Kept are the touches of the model in `base` that are not of the library, which
    decides about its own. `changes` are objects of these that are called otherwise, or
    are forgotten where the new name is "", in order. Learnt are touches of
    `image_shape`, by default of the newest one's. Returns `n_touches`, `n_elsewhere` of
    them, `objects`, and `kept`, those with touches that were kept; no `objects` where
    too little is left to be a model, and why the base `stays`. Touches that hold no
    number at all are left out; `left_out` are their ids.
    """
    left_out: list[str] = []
    while True:
        try:
            learn_args = library, output, base, changes, image_shape
            return {**_learnt_once(*learn_args, left_out), "left_out": left_out}
        except EmptyTouchError as error:
            if {*error.touch_ids} <= {*left_out}:
                raise
            left_out += error.touch_ids


def _learnt_once(
    library: str | Path,
    output: str | Path,
    base: str | Path | None,
    changes: Sequence[tuple[str, str]],
    image_shape: tuple[int, ...] | None,
    left_out: Sequence[str],
) -> dict[str, Any]:
    with TouchLibrary.open(library) as opened:
        model, elsewhere = None, None
        if base is not None and Path(base).is_file():
            model = ObjectRecogniser.load(base)
            elsewhere = _of_elsewhere(model.memory_, opened, changes)
        kept = [] if elsewhere is None else elsewhere.classes.astype(str).tolist()
        touches = _taught(opened, image_shape, left_out, kept)
        names = [] if touches is None else touches.object.tolist()
        if len({*kept, *names}) < LEAST_OBJECTS:
            stays = [f"{name} is known from it alone" for name in kept[:1]]
            old = None if model is None else _shape_of(model)
            if old is not None and old != tuple(image_shape or old):
                stays.append(f"it is of another sensor ({size_text(old)})")
            return {"objects": [], "n_touches": 0, "n_elsewhere": 0, "stays": stays}
        model = _learnt(model, elsewhere, touches)
        if touches is not None:
            remember_sensor(model, opened, touches)
        model.save(output)
    n_touches, n_taught = len(model.memory_), 0 if touches is None else len(touches)
    return {
        "objects": model.classes_.tolist(),
        "n_touches": n_touches,
        "n_elsewhere": n_touches - n_taught,
        "kept": kept,
    }


def _of_elsewhere(
    memory: Memory, opened: TouchLibrary, changes: Sequence[tuple[str, str]]
) -> Memory | None:
    """Return the touches of a model that its library does not hold, None without any.

    What is of this library it now says: renamed, moved, left out or still there.
    """
    stored = {row.id for row in opened.list(limit=None, retracted=True)}
    rest = memory.of_rows(~np.isin(memory.touch_ids, list(stored)))
    for old, new in changes:
        rest = rest.renamed(old, new) if new else rest.without([old])
    names, counts = np.unique(rest.labels, return_counts=True)
    rest = rest.without(names[counts < LEAST_TOUCHES])
    return rest if len(rest) else None


def remember_library(
    model: ObjectRecogniser, folder: str | Path, where: str | None
) -> None:
    """Keep in a model what the sensor was like whose touches it learnt.

    `where` is the filter of those touches in the library `folder`.
    """
    with TouchLibrary.open(folder) as library:
        remember_sensor(model, library, library.select(where))


def remember_sensor(
    model: ObjectRecogniser, library: TouchLibrary, touches: TouchSource
) -> None:
    """Keep what the sensor of these touches was like, where its baseline is known."""
    baseline = _latest_baseline(library, touches)
    if baseline is None:
        return
    rows = np.unique(np.linspace(0, len(touches) - 1, _ENOUGH).round().astype(int))
    pieces = (rows[i : i + _AT_ONCE] for i in range(0, len(rows), _AT_ONCE))
    images = (
        image
        for rows_at_once in pieces
        for image in touches.touches(rows_at_once).images
    )
    memory = SensorMemory.of(images, baseline)
    model.remember_sensor(memory.to_dict())


def _taught(
    library: TouchLibrary,
    image_shape: Sequence[int] | None,
    left_out: Sequence[str],
    kept: Sequence[str],
) -> Any:
    """Return what to learn: of objects not `kept` two touches each at least."""
    if image_shape is None:
        newest = newest_row(library)
        if newest is None:
            return None
        image_shape = newest.image_shape
    where = f"object is not null and {of_size(image_shape)}"
    if not library.list(where, limit=1):
        return None
    chosen = library.select(where)
    if left_out:
        whole = np.flatnonzero(~np.isin(chosen.touch_id, left_out))
        if not len(whole):
            return None
        chosen = chosen[whole]
    labels = np.asarray(chosen.object)
    at, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    rows = np.flatnonzero((counts[at] >= LEAST_TOUCHES) | np.isin(labels, kept))
    return chosen[rows] if len(rows) else None


def _learnt(
    base: ObjectRecogniser | None, elsewhere: Memory | None, touches: Any
) -> ObjectRecogniser:
    """Return a model of touches, beside those of the base model from elsewhere.

    It is as the base model was made (preset, floor...), where that is of their size.
    """
    shape = () if touches is None else touches.touches([0]).images.shape[1:]
    if base is None or elsewhere is None:
        model = ObjectRecogniser()
        if base is not None and _shape_of(base) == shape:
            model = clone(base).set_params(label="object")
        return model.fit(touches)
    if touches is not None and _shape_of(base) != shape:
        old, new = size_text(_shape_of(base)), size_text(shape)
        names = ", ".join(map(repr, elsewhere.classes.astype(str).tolist()))
        raise LearningError(_NOT_FURTHER.format(old=old, new=new, names=names))
    return base.learn_beside(elsewhere, touches)


def _shape_of(model: ObjectRecogniser) -> tuple[int, ...]:
    return tuple(model.encoder_.image_shape_)


def _latest_baseline(library: TouchLibrary, touches: TouchSource) -> Array | None:
    """Return the newest no-contact image that has the size of these touches."""
    shape = touches.touches(np.array([len(touches) - 1])).images.shape[1:]
    sessions: list[Any] = [None]
    if touches.session is not None:
        named = [s for s in touches.session.tolist()[::-1] if s not in ("", None)]
        sessions = [*dict.fromkeys(named)] or sessions
    for session in sessions:
        try:
            baseline = library.no_contact(session)
        except LibraryError:  # damaged: `palpate library check` tells of it
            continue
        if baseline is not None and baseline.shape == shape:
            return baseline
    return None


def main() -> None:
    """Do the jobs on standard input, less urgently than what goes on beside them."""
    if hasattr(os, "nice"):
        os.nice(5)
    signal(SIGINT, SIG_IGN)  # of the terminal: who started this one ends it
    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        try:
            answer = learn_job(*json.loads(line))
        except (ValueError, OSError, MemoryError) as error:
            answer = {"refused": str(error)}
        print(json.dumps(answer), file=answers, flush=True)
