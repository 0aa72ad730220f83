"""Image -> vector: encoders of images, and what puts features on one scale."""

from ._edge_histograms import EdgeHistograms
from ._hu import HuMoments
from ._kernel_pca import KernelPCA
from ._moments import CentroidMoments
from ._moments import sorted_taxels as sorted_taxels
from ._named import ENCODINGS as ENCODINGS
from ._named import encoder_named
from ._pad_shapes import PadShapes
from ._photometric import PhotometricGradients
from ._pixels import GridLevels, ScaledPixels, TaxelVector
from ._polar_gradients import PolarGradients
from ._principal import OrientedPCA, PrincipalShare, ZernikePCA
from ._rings import RingPatterns, RingQuantiles
from ._shape import FourierDescriptors, ShapeGeometry
from ._union import EncodingUnion, RootScaler
from ._zernike import ZernikeMoments
from ._zernike_polynomials import zernike_degrees as zernike_degrees
from ._zernike_polynomials import zernike_values as zernike_values

__all__ = [
    "CentroidMoments",
    "EdgeHistograms",
    "EncodingUnion",
    "FourierDescriptors",
    "GridLevels",
    "HuMoments",
    "KernelPCA",
    "OrientedPCA",
    "PadShapes",
    "PhotometricGradients",
    "PolarGradients",
    "PrincipalShare",
    "RingPatterns",
    "RingQuantiles",
    "RootScaler",
    "ScaledPixels",
    "ShapeGeometry",
    "TaxelVector",
    "ZernikeMoments",
    "ZernikePCA",
    "encoder_named",
]
