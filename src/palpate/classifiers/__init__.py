"""Vector -> class: classifiers with log-likelihoods a belief can add up."""

from ._kernel_density import KernelDensityBayes
from ._kernel_density_index import IndexQuality, KernelDensityIndex
from ._kernel_density_naive import KernelDensityNaiveBayes
from ._kernel_ridge import KernelRidgeClassifier
from ._one_per_label import OnePerLabelSVC
from ._touch_classifier import FromProbabilities, TouchClassifier
from ._touch_classifier import as_groups as as_groups
from .mkl import MKLSVC, GaussianKernel, LinearKernel, PolynomialKernel

__all__ = [
    "MKLSVC",
    "FromProbabilities",
    "GaussianKernel",
    "IndexQuality",
    "KernelDensityBayes",
    "KernelDensityIndex",
    "KernelDensityNaiveBayes",
    "KernelRidgeClassifier",
    "LinearKernel",
    "OnePerLabelSVC",
    "PolynomialKernel",
    "TouchClassifier",
]
