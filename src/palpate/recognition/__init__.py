"""Touches -> object: recogniser, belief, presets and model files."""

from ._adapting import adapt
from ._belief import Belief
from ._geometry import find_geometry
from ._model_file import ModelFileError, check_model_path
from ._presets import PRESETS
from ._recogniser import ObjectRecogniser, summary
from ._sequence import Trust, log_posteriors, unknown_scores, with_floor
from ._training import training_groups

__all__ = [
    "PRESETS",
    "Belief",
    "ModelFileError",
    "ObjectRecogniser",
    "Trust",
    "adapt",
    "check_model_path",
    "find_geometry",
    "log_posteriors",
    "summary",
    "training_groups",
    "unknown_scores",
    "with_floor",
]
