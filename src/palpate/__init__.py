"""Recognise things by touch: from tactile images to a belief over objects.

What people reach for first can be imported from here; the rest lives in rooms:
`palpate.touches`, `images`, `encodings`, `classifiers`, `library`, `recognition`,
`evaluation`, `simulation`, `sensors`, `exploration`. Everything is loaded when it is
first used, so that `import palpate` is cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .evaluation import evaluate
    from .exploration import explore
    from .library import TouchLibrary
    from .recognition import Belief, Evidence, ObjectRecogniser
    from .sensors import open_sensor
    from .simulation import simulate_presses, simulate_touches
    from .touches import Touches

__version__ = "0.2.0"
__all__ = [
    "Belief",
    "Evidence",
    "ObjectRecogniser",
    "TouchLibrary",
    "Touches",
    "__version__",
    "evaluate",
    "explore",
    "open_sensor",
    "simulate_presses",
    "simulate_touches",
]

_ROOM_OF = {
    "Belief": "recognition",
    "Evidence": "recognition",
    "ObjectRecogniser": "recognition",
    "TouchLibrary": "library",
    "Touches": "touches",
    "evaluate": "evaluation",
    "explore": "exploration",
    "open_sensor": "sensors",
    "simulate_presses": "simulation",
    "simulate_touches": "simulation",
}
_ROOMS = {*_ROOM_OF.values(), "classifiers", "encodings", "images"}


def __getattr__(name: str) -> Any:
    """Load a name when it is first used."""
    if name in _ROOMS:
        return import_module(f".{name}", __name__)
    if name not in _ROOM_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_ROOM_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_ROOMS})
