"""Vector -> class: classifiers with log-likelihoods a belief can add up."""

from ._kernel_density import KernelDensityBayes
from ._kernel_density_index import IndexQuality, KernelDensityIndex
from ._kernel_density_naive import KernelDensityNaiveBayes
from ._kernel_ridge import KernelRidgeClassifier
from ._one_per_label import OnePerLabelSVC
from .mkl import MKLSVC, GaussianKernel, LinearKernel, PolynomialKernel

__all__ = [
    "MKLSVC",
    "GaussianKernel",
    "IndexQuality",
    "KernelDensityBayes",
    "KernelDensityIndex",
    "KernelDensityNaiveBayes",
    "KernelRidgeClassifier",
    "LinearKernel",
    "OnePerLabelSVC",
    "PolynomialKernel",
]
