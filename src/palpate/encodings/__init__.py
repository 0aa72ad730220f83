"""Image -> vector: one estimator per file, and what puts features on one scale."""

from ._fourier import FourierDescriptors
from ._geometry import ShapeGeometry
from ._kernel_pca import KernelPCA
from ._moments import CentroidMoments, sorted_taxels
from ._root import RootScaler
from ._taxel_vector import TaxelVector
from ._union import EncodingUnion
from ._zernike import ZernikeMoments

__all__ = [
    "CentroidMoments",
    "EncodingUnion",
    "FourierDescriptors",
    "KernelPCA",
    "RootScaler",
    "ShapeGeometry",
    "TaxelVector",
    "ZernikeMoments",
    "sorted_taxels",
]
