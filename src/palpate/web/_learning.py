"""Learning in a process of its own, so that frames go on while it works.

The other process reads a job as JSON from standard input, writes the model file all
or nothing, and answers with one JSON object.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LEAST_OBJECTS, LEAST_TOUCHES = 2, 2


class LearningError(ValueError):
    """Nothing could be learnt; the message says what is missing."""


def learn_apart(
    library: Path,
    output: Path,
    base: Path | None,
    drop: Sequence[str] = (),
    image_shape: tuple[int, int] | None = None,
) -> dict[str, Any]:
    """Learn what a library holds in another process, and wait for it.

    Parameters
    ----------
    library : Path
        Folder of the library.
    output : Path
        The model file to write.
    base : Path or None
        Model whose objects that are not of the library are kept.
    drop : sequence of str
        Objects of the base model that are not kept.
    image_shape : (int, int), optional
        Learn from touches of this size alone; by default of the newest one's.

    Returns
    -------
    dict
        `n_touches`, `objects`, and `kept`, those of the base model; no `objects`
        where too little is left to be a model.

    Raises
    ------
    LearningError
        Learning failed; says why.
    """
    job = {
        "library": str(library),
        "output": str(output),
        "base": None if base is None else str(base),
        "drop": list(drop),
        "image_shape": image_shape,
    }
    done = subprocess.run(
        [sys.executable, "-c", "from palpate.web._learning import main; main()"],
        input=json.dumps(job),
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError) as error:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise LearningError(f"Learning ended without a model: {last}") from error
    if "refused" in answer:
        raise LearningError(answer["refused"])
    return answer


def learn_job(job: dict[str, Any]) -> dict[str, Any]:
    """Do one job as `learn_apart` describes it, in this process."""
    from ..library import TouchLibrary
    from ..recognition import ObjectRecogniser
    from ._origin import remember_sensor

    with TouchLibrary.open(job["library"]) as library:
        touches = _taught(library, job.get("image_shape"))
        base, kept = None, []
        if job["base"] is not None and Path(job["base"]).is_file():
            base = ObjectRecogniser.load(job["base"])
            kept = _kept(base, library, job["drop"])
        names = set() if touches is None else set(touches.object.tolist())
        if len({*kept, *names}) < LEAST_OBJECTS:
            _refuse_to_empty(base, job.get("image_shape"))
            return {"objects": [], "n_touches": 0, "kept": kept}
        model = _learnt(base, kept, touches)
        if touches is not None:
            remember_sensor(model, library, touches)
        model.save(job["output"])
    objects = model.classes_.tolist()
    return {"objects": objects, "n_touches": len(model.memory_), "kept": kept}


def _taught(library: Any, image_shape: Any) -> Any:
    """Return the touches to learn, None for none."""
    import numpy as np

    from ._chosen import of_size

    if image_shape is None:
        (*_, newest) = library.list(limit=1, offset=max(0, len(library) - 1)) or [None]
        if newest is None:
            return None
        image_shape = newest.n_rows, newest.n_cols
    where = f"object is not null and {of_size(image_shape)}"
    if not library.list(where, limit=1):
        return None
    chosen = library.select(where)
    labels = np.asarray(chosen.object)
    at, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    rows = np.flatnonzero(counts[at] >= LEAST_TOUCHES)
    return chosen[rows] if len(rows) else None


def _kept(base: Any, library: Any, drop: Sequence[str]) -> list[str]:
    """Return the objects of a model that do not come from this library.

    Those that do are what the library says now: renamed, forgotten or learnt anew.
    """
    import numpy as np

    stored = {row.id for row in library.list(limit=None, retracted=True)}
    here = np.isin(base.memory_.touch_ids, list(stored))
    gone = {*map(str, base.memory_.labels[here]), *drop}
    return [name for name in base.classes_.tolist() if name not in gone]


def _learnt(base: Any, kept: Sequence[str], touches: Any) -> Any:
    """Return a model of touches and of what is kept of the base model."""
    from ..recognition import ObjectRecogniser

    if base is None or not kept:
        return ObjectRecogniser().fit(touches)
    if touches is not None:
        _refuse_other_size(base, kept, touches.touches([0]).images.shape[1:])
    return base.replace_objects(touches, forget={*base.classes_.tolist()} - {*kept})


def _refuse_to_empty(base: Any, image_shape: Any) -> None:
    """A model of another sensor is not given up for having no touches of this one."""
    if base is None or image_shape is None:
        return
    old, new = (f"{s[0]} x {s[1]}" for s in (base.encoder_.image_shape_, image_shape))
    if old != new:
        raise LearningError(
            "Too little to learn: at least two objects with two touches each of "
            f"{new} taxels. The model of another sensor ({old}) stays."
        )


def _refuse_other_size(
    base: Any, kept: Sequence[str], image_shape: tuple[int, int]
) -> None:
    old, new = (f"{s[0]} x {s[1]}" for s in (base.encoder_.image_shape_, image_shape))
    if old != new:
        raise LearningError(
            f"The model must be of the sensor's {new} taxels to be learnt further, but "
            f"it knows {', '.join(map(repr, kept))} from images of {old}, and their "
            "touches are not in the library. Forget those, or start with another "
            "--model."
        )


def main() -> None:
    """Do the job on standard input, less urgently than what goes on beside it."""
    if hasattr(os, "nice"):
        os.nice(5)
    try:
        answer = learn_job(json.load(sys.stdin))
    except (ValueError, OSError, MemoryError) as error:
        answer = {"refused": str(error)}
    print(json.dumps(answer))
