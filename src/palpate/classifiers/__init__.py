"""Vector -> class: classifiers with log-likelihoods a belief can add up."""

from ._corradi2014 import KernelDensityNaiveBayes, OnePerLabelSVC
from ._encoding_pool import EncodingPool
from ._kernel_density import KernelDensityBayes
from ._kernel_density_index import KernelDensityIndex
from ._kernel_ridge import KernelRidgeClassifier
from ._touch_classifier import FromProbabilities, TouchClassifier
from .mkl import MKLSVC, GaussianKernel, LinearKernel, PolynomialKernel

__all__ = [
    "MKLSVC",
    "EncodingPool",
    "FromProbabilities",
    "GaussianKernel",
    "KernelDensityBayes",
    "KernelDensityIndex",
    "KernelDensityNaiveBayes",
    "KernelRidgeClassifier",
    "LinearKernel",
    "OnePerLabelSVC",
    "PolynomialKernel",
    "TouchClassifier",
]
