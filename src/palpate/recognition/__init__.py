"""Touches -> object: recogniser, belief, presets and model files.

`Touches -> encode -> Evidence -> Belief`, a file for each. `__init__.pyi` lists every
name with its file, which is loaded when the name is first used.
"""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach_stub(__name__, __file__)
__all__ = [
    "PRESETS",
    "Belief",
    "Episode",
    "Evidence",
    "Modality",
    "ModelFileError",
    "ObjectRecogniser",
    "Recentring",
    "adapt",
]
