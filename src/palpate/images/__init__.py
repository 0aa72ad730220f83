"""Images made cleaner: arrays, camera domes, orientation and calibration."""

from ._dome import DomeCrop, crop_discs, disc_mask, standardise_discs
from ._rim import Circle, Rims, find_rim, find_rims, typical_rim

__all__ = [
    "Circle",
    "DomeCrop",
    "Rims",
    "crop_discs",
    "disc_mask",
    "find_rim",
    "find_rims",
    "standardise_discs",
    "typical_rim",
]
