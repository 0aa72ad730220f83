"""Multiple kernel learning: machines that learn their kernel from a bank of kernels."""

from ._kernels import GaussianKernel, LinearKernel, PolynomialKernel
from ._kernels import kernel_diagonals as kernel_diagonals
from ._kernels import paper_kernels as paper_kernels
from ._simplemkl import Answer as Answer
from ._simplemkl import reduced_gradient_walk as reduced_gradient_walk
from ._svc import MKLSVC

__all__ = ["MKLSVC", "GaussianKernel", "LinearKernel", "PolynomialKernel"]
