"""Images made cleaner: arrays, camera domes, orientation and calibration."""

from ._array import ArrayCleanUp
from ._array import binarise as binarise
from ._array import correct_gamma as correct_gamma
from ._array import filter_noise as filter_noise
from ._array import otsu_threshold as otsu_threshold
from ._array import resize as resize
from ._array import stage_pictures as stage_pictures
from ._calibration import TaxelCalibration
from ._central_moments import CentralMoments as CentralMoments
from ._central_moments import above_least as above_least
from ._central_moments import central_moments as central_moments
from ._central_moments import inscribed_mask as inscribed_mask
from ._channels import ChannelMean
from ._channels import grey as grey
from ._dead_taxels import fill_dead_taxels
from ._dome import DerivativeMagnitude, DomeCrop
from ._dome import crop_discs as crop_discs
from ._dome import standardise_discs as standardise_discs
from ._orientation import OrientationRegulariser
from ._orientation import orientations as orientations
from ._outline_pose import Poses
from ._outline_pose import press_pose as press_pose
from ._press_pose import PressPose
from ._repose import repose
from ._rim import Circle, Rims, find_rims
from ._rim import find_rim as find_rim
from ._rim import typical_rim as typical_rim

__all__ = [
    "ArrayCleanUp",
    "ChannelMean",
    "Circle",
    "DerivativeMagnitude",
    "DomeCrop",
    "OrientationRegulariser",
    "Poses",
    "PressPose",
    "Rims",
    "TaxelCalibration",
    "fill_dead_taxels",
    "find_rims",
    "repose",
]
