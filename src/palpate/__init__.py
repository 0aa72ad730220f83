"""Recognise things by touch: from tactile images to a belief over objects.

What people reach for first can be imported from here; the rest lives in subpackages:
`palpate.touches`, `images`, `encodings`, `classifiers`, `library`, `recognition`,
`evaluation`, `simulation`, `sensors`, `exploration`. `__init__.pyi` lists every name
with its subpackage, which is loaded when the name is first used, so that `import
palpate` is cheap.
"""

import lazy_loader

from ._version import __version__

__getattr__, _names, _ = lazy_loader.attach_stub(__name__, __file__)

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


def __dir__() -> list[str]:
    return [*_names(), "__version__"]
