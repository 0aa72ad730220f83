"""Ready models of simulated sensors: made by today's code when first asked for.

Nothing is downloaded and no model is part of the package. A model is made in seconds
and kept; its file is named after the code that made it, so that other code makes its
own and takes away what is older.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from ..touches import Touches

_PACKAGE = Path(__file__).parents[1]
_MADE_BY = (
    "datasets",
    "simulation",
    "touches",
    "images",
    "encodings",
    "classifiers",
    "recognition",
)
_SEED = 0
# Those that `palpate demo` explores, and what a small gel can tell from another in a
# few presses; the other objects of a `sim:` sensor are strangers.
_OF_DOME = ("stapler", "toothbrush", "mug", "box", "pen", "ball")
_OF_GEL = ("ball", "massage ball", "pen", "toothbrush")
# Of each model: touches of each object, and what it knows, in words.
READY: dict[str, tuple[int, str]] = {
    "sim-array": (24, "twelve flat parts on the pressure array of sim:array"),
    "sim-dome": (60, f"{', '.join(_OF_DOME)} under the dome camera of sim:dome"),
    "sim-gel": (40, f"{', '.join(_OF_GEL)} on the gel, in colour, of sim:gel"),
}


def ready_file(name: str, folder: Path) -> Path:
    """Return where the model of `READY` is, or will be, within a folder."""
    return folder / "models" / f"{name}-{_code()}.palpate"


def make_ready(name: str, folder: Path, say: Callable[[str], None] | None) -> Path:
    """Return the file of a ready model, made first where it is not there.

    Raises ImportError where the simulation's packages are missing, OSError where the
    folder cannot be written.
    """
    from ..recognition import ObjectRecogniser

    path = ready_file(name, folder)
    if path.is_file():
        return path
    if say is not None:
        say(f"{name}: simulating touches and learning them, once")
    recogniser = ObjectRecogniser().fit(_touches(name))
    path.parent.mkdir(parents=True, exist_ok=True)
    recogniser.save(path)
    for older in path.parent.glob(f"{name}-*.palpate"):
        if older != path:
            older.unlink(missing_ok=True)
    return path


def _touches(name: str) -> Touches:
    """Return the touches that a ready model learns: as its `sim:` sensor gives them."""
    from .. import simulation

    n_touches = READY[name][0]
    how: dict[str, Any] = {"random_state": _SEED}
    if name == "sim-array":
        array = simulation.PressureArray()
        return simulation.simulate_presses(None, n_touches, array=array, **how)
    how |= {"drift": False}
    if name == "sim-gel":
        gel = simulation.GelCamera(image_shape=(120, 160))
        return simulation.simulate_touches(_OF_GEL, n_touches, gel, **how)
    dome = simulation.DomeCamera(image_shape=(120, 120))
    return simulation.simulate_touches(_OF_DOME, n_touches, dome, **how)


@cache
def _code() -> str:
    """Return what names the code that makes ready models."""
    code = hashlib.sha256()
    for path in sorted(p for room in _MADE_BY for p in (_PACKAGE / room).rglob("*.py")):
        code.update(path.read_bytes())
    return code.hexdigest()[:12]
