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
_STAND_IN = "\ta name nobody can give"


class LearningError(ValueError):
    """Nothing could be learnt; the message says what is missing."""


def learn_apart(
    library: Path, output: Path, base: Path | None, drop: Sequence[str] = ()
) -> dict[str, Any]:
    """Learn what a library holds in another process, and wait for it.

    Parameters
    ----------
    library : Path
        Folder of the library.
    output : Path
        The model file to write.
    base : Path or None
        Model whose objects that are not in the library are kept.
    drop : sequence of str
        Objects of the base model that are not kept.

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

    library = TouchLibrary.open(job["library"])
    enough = [o.name for o in library.objects() if o.n_touches >= LEAST_TOUCHES]
    base, kept = None, []
    if job["base"] is not None and Path(job["base"]).is_file():
        base = ObjectRecogniser.load(job["base"])
        taught = set(getattr(base, "taught_", []))
        kept = [n for n in base.classes_.tolist() if n not in {*taught, *job["drop"]}]
    if len(kept) + len(set(enough) - set(kept)) < LEAST_OBJECTS:
        return {"objects": [], "n_touches": 0, "kept": kept}
    touches, ids = taught_touches(library, enough)
    if base is not None and kept:
        model = _added_to(base, kept, touches)
        ids = []
    else:
        model = ObjectRecogniser().fit(touches)
    _remember(model, touches, library.no_contact(), enough, ids)
    model.save(job["output"])
    names = model.classes_.tolist()
    return {"objects": names, "n_touches": len(model.labels_), "kept": kept}


def taught_touches(library: Any, names: Sequence[str]) -> tuple[Any, list[str]]:
    """Return the touches of some objects of a library, and their ids in that order."""
    rows = [row for row in library.list(limit=None) if row.object is not None]
    touches = library.touches("object is not null")
    wanted = [n for n, row in enumerate(rows) if row.object in set(names)]
    return touches[wanted], [rows[n].id for n in wanted]


def _added_to(base: Any, kept: Sequence[str], touches: Any) -> Any:
    """Return the base model with what was taught, in place of what it had of it.

    A model cannot fall below two objects, so new ones come before old ones go.
    """
    taught = {
        name: touches[touches.object == name]
        for name in dict.fromkeys(touches.object.tolist())
    }
    again = [name for name in taught if name in base.classes_]
    for name in set(taught) - set(again):
        base.add_object(name, taught[name])
    for name in set(base.classes_.tolist()) - {*kept, *taught}:
        base.forget_object(name)
    for name in again:
        _replace(base, name, taught[name])
    return base


def _replace(base: Any, name: str, touches: Any) -> None:
    """Learn an object anew; a stand-in keeps a model of two above its least size."""
    stands_in = len(base.classes_) == LEAST_OBJECTS
    if stands_in:
        base.add_object(_STAND_IN, touches)
    base.forget_object(name)
    base.add_object(name, touches)
    if stands_in:
        base.forget_object(_STAND_IN)


def _remember(
    model: Any, touches: Any, zero: Any, taught: list[str], ids: list[str]
) -> None:
    """Keep beside the model what its sensor was like and where its touches are."""
    import numpy as np

    from ..sensors import SensorMemory

    model.taught_ = taught
    model.touch_ids_ = np.array(ids, dtype=str) if ids else np.empty(0, "U1")
    if zero is not None and zero.shape == touches.images.shape[1:]:
        memory = SensorMemory.of(touches.images, zero)
        model.sensor_ = memory.to_dict()


def main() -> None:
    """Do the job on standard input, less urgently than what goes on beside it."""
    if hasattr(os, "nice"):
        os.nice(5)
    try:
        answer = learn_job(json.load(sys.stdin))
    except (ValueError, OSError, MemoryError) as error:
        answer = {"refused": str(error)}
    print(json.dumps(answer))
