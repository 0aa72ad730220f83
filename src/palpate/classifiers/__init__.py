"""Vector -> class: classifiers with log-likelihoods a belief can add up."""

from ._corradi2014 import KernelDensityNaiveBayes, OnePerLabelSVC
from ._encoding_pool import EncodingPool
from ._kernel_density import KernelDensityBayes
from ._kernel_density_index import KernelDensityIndex
from ._kernel_ridge import KernelRidgeClassifier
from ._kernel_ridge import learns_by_landmarks as learns_by_landmarks
from ._nearby import NearbyTouches as NearbyTouches
from ._rehearsed import Drawn as Drawn
from ._rehearsed import RehearsedMachine as RehearsedMachine
from ._rehearsed import halves as halves
from ._rehearsed import rehearsed as rehearsed
from ._touch_classifier import BayesRule as BayesRule
from ._touch_classifier import FromProbabilities, TouchClassifier
from ._touch_classifier import as_touch_classifier as as_touch_classifier
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
