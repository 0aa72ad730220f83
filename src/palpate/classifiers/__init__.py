"""Vector -> class: classifiers with log-likelihoods a belief can add up."""

from ._kernel_density import KernelDensityBayes
from ._kernel_ridge import KernelRidgeClassifier

__all__ = ["KernelDensityBayes", "KernelRidgeClassifier"]
