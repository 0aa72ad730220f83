"""Multiple kernel learning beside MKLpy and beside one plain SVC per kernel.

Liu's setting: 12 labels of 10 touches, 66 one-against-one problems, 22 kernels.
"""

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.svm import SVC

from ..classifiers import MKLSVC
from ._timing import cpu_ms, one_thread, row

N_LABELS, N_EACH, N_FEATURES, COST = 12, 10, 20, 100.0
NO_MKLPY = "MKLpy is not installed: `make bench` gives it an environment of its own"

Floats = NDArray[np.float64]


def bench_mkl(*, seconds: float = 1.0, random_state: int = 0) -> list[dict[str, Any]]:
    """Measure learning 66 machines over 22 kernels, one thread, CPU time.

    Parameters
    ----------
    seconds : float, default=1.0
        CPU time spent on each side.
    random_state : int, default=0
        Seed of the drawn touches.

    Returns
    -------
    list of dict
        `name`, `ours_ms`, `peer`, `peer_ms`, `ratio`, and `gap`: the largest
        relative duality gap that ours ends with. With the kernel matrices given,
        and with their computation counted on both sides.
    """
    rng = np.random.default_rng(random_state)
    labels = np.repeat(np.arange(N_LABELS), N_EACH)
    X = rng.normal(size=(N_LABELS, N_FEATURES))[labels]
    X += rng.normal(size=X.shape)
    kernels = paper_kernels(X)
    given = MKLSVC(COST, kernels="precomputed", probability=False)
    whole = MKLSVC(COST, probability=False)
    rows = []
    with one_thread():
        rows += _rows(
            "matrices given",
            given,
            np.ascontiguousarray(np.moveaxis(kernels, 0, 2)),
            labels,
            lambda: kernels,
            seconds,
        )
        rows += _rows(
            "matrices counted", whole, X, labels, lambda: paper_kernels(X), seconds
        )
    return rows


def _rows(
    what: str,
    machine: MKLSVC,
    touches: Floats,
    labels: NDArray,
    matrices: Callable[[], Floats],
    seconds: float,
) -> list[dict[str, Any]]:
    """Time learning beside one SVC per kernel, and recognising too beside MKLpy."""
    size = f"{N_LABELS} labels x {N_EACH} touches, 22 kernels, {what}"
    fit_ms = cpu_ms(lambda: machine.fit(touches, labels), seconds)
    gap = float(np.max(machine.gap_))
    both_ms = cpu_ms(lambda: machine.fit(touches, labels).predict(touches), seconds)
    svc_ms = cpu_ms(lambda: _one_svc_each(matrices(), labels), seconds)
    rows = [row(f"{size}, learn", fit_ms, "22 SVC fits", svc_ms, gap=gap)]
    name, peer = f"{size}, learn and recognise", "MKLpy EasyMKL"
    easy = _easy_mkl(matrices, labels)
    if easy is None:
        return [*rows, row(name, both_ms, peer, None, gap=gap, reason=NO_MKLPY)]
    return [*rows, row(name, both_ms, peer, cpu_ms(easy, seconds), gap=gap)]


def paper_kernels(X: Floats) -> Floats:
    """Return the 22 kernel matrices of Liu et al. divided by their mean diagonal.

    Shape (n_kernels, n_touches, n_touches): 16 Gaussians of width 2^-5 to 2^10 and 6
    polynomials of degree 1 to 6.
    """
    inner = X @ X.T
    norms = np.diag(inner)
    squared = np.maximum(norms[:, np.newaxis] + norms - 2 * inner, 0)
    gaussians = [np.exp(-squared / (2 * 4.0**k)) for k in range(-5, 11)]
    polynomials = [(1 + inner) ** degree for degree in range(1, 7)]
    kernels = np.array(gaussians + polynomials)
    return kernels / np.einsum("kii->k", kernels)[:, None, None] * len(X)


def _one_svc_each(kernels: Floats, labels: NDArray) -> list[SVC]:
    return [SVC(C=COST, kernel="precomputed").fit(k, labels) for k in kernels]


def _easy_mkl(
    matrices: Callable[[], Floats], labels: NDArray
) -> Callable[[], object] | None:
    try:
        import torch
        from MKLpy.algorithms import EasyMKL
    except ImportError:
        return None
    torch.set_num_threads(1)

    def learn_and_recognise() -> object:
        listed = [torch.tensor(kernel) for kernel in matrices()]
        machine = EasyMKL(lam=0.1, multiclass_strategy="ovo").fit(listed, labels)
        with redirect_stdout(io.StringIO()):  # it prints a shape per kernel
            return machine.predict(listed)

    return learn_and_recognise
