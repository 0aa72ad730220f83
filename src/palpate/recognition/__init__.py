"""Touches -> object: recogniser, belief, presets and model files."""

from ._adapting import adapt
from ._belief import Belief
from ._calibration import left_out_log_likelihood
from ._geometry import find_geometry
from ._modality import Modality
from ._model_file import ModelFileError, check_model_path
from ._presets import PRESETS
from ._recogniser import ObjectRecogniser
from ._sequence import Felt, Trust, doubts, log_posteriors, told, with_floor
from ._summary import summary
from ._training import training_groups

__all__ = [
    "PRESETS",
    "Belief",
    "Felt",
    "Modality",
    "ModelFileError",
    "ObjectRecogniser",
    "Trust",
    "adapt",
    "check_model_path",
    "doubts",
    "find_geometry",
    "left_out_log_likelihood",
    "log_posteriors",
    "summary",
    "told",
    "training_groups",
    "with_floor",
]
