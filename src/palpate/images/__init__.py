"""Images made cleaner: arrays, camera domes, orientation and calibration."""

from ._array import ArrayCleanUp, ChannelMean, fill_dead_taxels
from ._array import NoLivingTaxelError as NoLivingTaxelError
from ._calibration import TaxelCalibration
from ._dome import DerivativeMagnitude, DomeCrop
from ._orientation import OrientationRegulariser, repose
from ._press_pose import Poses as Poses
from ._press_pose import PressPose
from ._rim import find_rims
from ._rim import typical_rim as typical_rim

__all__ = [
    "ArrayCleanUp",
    "ChannelMean",
    "DerivativeMagnitude",
    "DomeCrop",
    "OrientationRegulariser",
    "PressPose",
    "TaxelCalibration",
    "fill_dead_taxels",
    "find_rims",
    "repose",
]
