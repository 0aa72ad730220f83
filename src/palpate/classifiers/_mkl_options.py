"""What the parameters of `MKLSVC` mean, and which of them go together."""

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import check_random_state

from .._checks import check_count, check_number, check_option, check_positive
from ._kernels import check_kernels
from ._mkl_banks import FeatureBank, GivenBank
from ._mkl_nystroem import NystroemBank
from ._mkl_pairs import Bank, Settings
from ._mkl_problem import Floats

# Pairs of more touches than this are learnt through landmarks by default.
_MOST_TOUCHES = 3000
_TOLERANCES = {"interior": 1e-6, "simplemkl": 1e-2}
_NORMALIZE = ("trace", "variance", None)
_APPROXIMATION = ("auto", "none", "nystroem")


def is_given(kernels: object) -> bool:
    """Whether the kernels come computed."""
    return isinstance(kernels, str) and kernels == "precomputed"


def check_settings(
    *,
    C: object,
    norm: object,
    solver: object,
    approximation: object,
    tol: object,
    max_iter: object,
    probability: object,
) -> Settings:
    """Return how to learn a pair, or explain what does not fit."""
    check_option("solver", solver, _TOLERANCES)
    check_option("approximation", approximation, _APPROXIMATION)
    check_option("probability", probability, (True, False))
    power = check_number("norm", norm, low=1)
    if solver == "simplemkl" and (power != 1 or approximation == "nystroem"):
        raise ValueError(
            "solver must be 'interior' for norm above 1 or approximation 'nystroem', "
            "got 'simplemkl'. Leave solver at its default."
        )
    default = _TOLERANCES[str(solver)]
    return Settings(
        C=check_positive("C", C),
        norm=power,
        solver=str(solver),
        tol=check_positive("tol", default if tol is None else tol),
        max_iter=check_count("max_iter", max_iter),
        calibrate=bool(probability),
    )


def make_bank(
    touches: Floats,
    codes: NDArray,
    *,
    kernels: object,
    normalize: str | None,
    solver: str,
    approximation: str,
    n_landmarks: object,
    random_state: int | np.random.RandomState | None,
) -> Bank:
    """Return the kernels among training touches: whole, given, or by landmarks."""
    check_option("normalize", normalize, _NORMALIZE)
    landmarks = check_count("n_landmarks", n_landmarks)
    if is_given(kernels):
        if approximation == "nystroem":
            raise ValueError(
                "approximation must be 'none' or 'auto' with precomputed kernels, got "
                "'nystroem'. Pass features and a list of kernels instead."
            )
        return GivenBank(touches, normalize)
    listed = check_kernels(kernels)
    largest = int(np.sort(np.bincount(codes))[-2:].sum())
    many = approximation == "auto" and largest > _MOST_TOUCHES
    if approximation == "nystroem" or (many and solver == "interior"):
        random = check_random_state(random_state)
        return NystroemBank(listed, touches, normalize, landmarks, random)
    return FeatureBank(listed, touches, normalize)
