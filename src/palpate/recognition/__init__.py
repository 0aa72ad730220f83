"""Touches -> object: recogniser, belief, presets and model files."""

from ._adapting import adapt
from ._belief import Belief
from ._calibration import left_out_log_likelihood
from ._geometry import find_geometry
from ._modality import Modality
from ._model_file import ModelFileError, check_model_path
from ._presets import PRESETS
from ._recogniser import ObjectRecogniser
from ._sequence import (
    Evidence,
    SequenceCalibration,
    doubts,
    log_posteriors,
    n_informative,
    with_floor,
)
from ._summary import summary
from ._training import left_out_groups

__all__ = [
    "PRESETS",
    "Belief",
    "Evidence",
    "Modality",
    "ModelFileError",
    "ObjectRecogniser",
    "SequenceCalibration",
    "adapt",
    "check_model_path",
    "doubts",
    "find_geometry",
    "left_out_groups",
    "left_out_log_likelihood",
    "log_posteriors",
    "n_informative",
    "summary",
    "told",
    "with_floor",
]
