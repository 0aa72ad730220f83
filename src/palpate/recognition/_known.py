"""The classes that a model file may name: our own, and three of scikit-learn's."""

from sklearn.decomposition import PCA
from sklearn.preprocessing import StandardScaler

from .. import classifiers, encodings, images
from ._contact import ContactCheck
from ._encoder import TouchEncoder
from ._modality import Modality
from ._sequence import SequenceCalibration
from ._unknown import UnknownScale

# Made anew from a stored model; making one computes, which reading a file must not.
_NEVER_STORED = ("IndexQuality", "KernelDensityIndex")


def _public_classes() -> dict[str, type]:
    rooms = (classifiers, encodings, images)
    named = {name: getattr(room, name) for room in rooms for name in room.__all__}
    return {
        name: item
        for name, item in named.items()
        if isinstance(item, type) and name not in _NEVER_STORED
    }


KNOWN_CLASSES: dict[str, type] = {
    **_public_classes(),
    "ContactCheck": ContactCheck,
    "Modality": Modality,
    "PCA": PCA,
    "StandardScaler": StandardScaler,
    "TouchEncoder": TouchEncoder,
    "SequenceCalibration": SequenceCalibration,
    "UnknownScale": UnknownScale,
}
