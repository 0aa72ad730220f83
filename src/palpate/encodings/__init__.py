"""Image -> vector: one estimator per file, and what puts features on one scale."""

from ._first_features import FirstFeatures
from ._fourier import FourierDescriptors
from ._geometry import ShapeGeometry
from ._hu import HuMoments
from ._kernel_pca import KernelPCA
from ._moments import CentroidMoments, sorted_taxels
from ._names import ENCODINGS, Encoding, encoder_named
from ._oriented_pca import OrientedPCA
from ._polar_gradients import PolarGradients
from ._principal_share import PrincipalShare
from ._root import RootScaler
from ._scaled_pixels import ScaledPixels
from ._taxel_vector import TaxelVector
from ._union import EncodingUnion
from ._zernike import ZernikeMoments
from ._zernike_pca import ZernikePCA

__all__ = [
    "ENCODINGS",
    "CentroidMoments",
    "Encoding",
    "EncodingUnion",
    "FirstFeatures",
    "FourierDescriptors",
    "HuMoments",
    "KernelPCA",
    "OrientedPCA",
    "PolarGradients",
    "PrincipalShare",
    "RootScaler",
    "ScaledPixels",
    "ShapeGeometry",
    "TaxelVector",
    "ZernikeMoments",
    "ZernikePCA",
    "encoder_named",
    "sorted_taxels",
]
