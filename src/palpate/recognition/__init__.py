"""Touches -> object: recogniser, belief, presets and model files.

`Touches -> encode -> Evidence -> Belief`, a file for each.
"""

from ._belief import Belief
from ._belief import Judge as Judge
from ._calibration import Modality
from ._contact import correlation as correlation
from ._encoder import find_geometry
from ._evidence import Evidence, SequenceCalibration
from ._evidence import as_touches as as_touches
from ._evidence import doubts as doubts
from ._evidence import given_prior as given_prior
from ._evidence import log_posteriors as log_posteriors
from ._evidence import n_informative as n_informative
from ._evidence import with_floor as with_floor
from ._learning import what_matters as what_matters
from ._memory import Memory
from ._memory import left_out_groups as left_out_groups
from ._memory import without_copies as without_copies
from ._model_file import ModelFileError
from ._model_file import check_model_path as check_model_path
from ._model_file import read_model as read_model
from ._model_file import write_model as write_model
from ._presets import PRESETS
from ._recogniser import ObjectRecogniser
from ._remounting import OTHER_MOUNTING as OTHER_MOUNTING
from ._remounting import MountingCheck, adapt
from ._remounting import across_sessions as across_sessions
from ._remounting import said_of_sessions as said_of_sessions
from ._unknown import episode_scores as episode_scores
from ._unknown import upper_bound as upper_bound

__all__ = [
    "PRESETS",
    "Belief",
    "Evidence",
    "Memory",
    "Modality",
    "ModelFileError",
    "MountingCheck",
    "ObjectRecogniser",
    "SequenceCalibration",
    "adapt",
    "find_geometry",
]
