"""Image -> vector: encoders of images, and what puts features on one scale."""

from ._edges_and_rings import EdgeHistograms, RingPatterns, RingQuantiles
from ._named import EncodingUnion, RootScaler, encoder_named
from ._onnx import OnnxEncoding
from ._pixels import (
    GridLevels,
    PhotometricGradients,
    PolarGradients,
    ScaledPixels,
    TaxelVector,
)
from ._principal import KernelPCA, OrientedPCA, PrincipalShare, ZernikePCA
from ._shape import (
    CentroidMoments,
    FourierDescriptors,
    HuMoments,
    PadShapes,
    ShapeGeometry,
)
from ._zernike import ZernikeMoments

__all__ = [
    "CentroidMoments",
    "EdgeHistograms",
    "EncodingUnion",
    "FourierDescriptors",
    "GridLevels",
    "HuMoments",
    "KernelPCA",
    "OnnxEncoding",
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
