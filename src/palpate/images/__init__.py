"""Images made cleaner: arrays, camera domes, orientation and calibration."""

from ._array import ArrayCleanUp, correct_gamma, filter_noise, resize, stage_pictures
from ._calibration import TaxelCalibration
from ._central_moments import (
    CentralMoments,
    above_least,
    central_moments,
    inscribed_mask,
)
from ._dead_taxels import fill_dead_taxels
from ._derivative import DerivativeMagnitude, derivative_magnitude
from ._dome import DomeCrop, crop_discs, disc_mask, standardise_discs
from ._orientation import OrientationRegulariser, Orientations, orientations
from ._otsu import binarise, otsu_threshold
from ._outline_pose import Poses, press_pose
from ._press_pose import PressPose
from ._repose import repose
from ._rim import Circle, Rims, find_rim, find_rims, typical_rim

__all__ = [
    "ArrayCleanUp",
    "CentralMoments",
    "Circle",
    "DerivativeMagnitude",
    "DomeCrop",
    "OrientationRegulariser",
    "Orientations",
    "Poses",
    "PressPose",
    "Rims",
    "TaxelCalibration",
    "above_least",
    "binarise",
    "central_moments",
    "correct_gamma",
    "crop_discs",
    "derivative_magnitude",
    "disc_mask",
    "fill_dead_taxels",
    "filter_noise",
    "find_rim",
    "find_rims",
    "inscribed_mask",
    "orientations",
    "otsu_threshold",
    "press_pose",
    "repose",
    "resize",
    "stage_pictures",
    "standardise_discs",
    "typical_rim",
]
