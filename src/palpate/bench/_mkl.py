"""Multiple kernel learning beside MKLpy, beside plain machines, and for many touches.

The setting of Liu et al. 2014: 12 classes, 10 touches each to learn from, 66 pairs of
classes, 22 kernels, 20 features from kernel PCA; the touches are drawn at random.
Ours solves every pair to a proven gap of 1e-6. EasyMKL solves a problem of its own,
one-against-one, with its default options; 22 plain machines, one for each kernel,
are what choosing a kernel by trial would take. Nobody calibrates probabilities.
"""

import contextlib
import io
import json
import subprocess
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics.pairwise import polynomial_kernel, rbf_kernel
from sklearn.svm import SVC

from ..classifiers import MKLSVC, PolynomialKernel
from ..classifiers._kernels import paper_kernels
from ..classifiers._simplemkl import Answer, reduced_gradient_walk
from ..encodings import KernelPCA
from ._timing import cpu_ms, one_thread, row

Floats = NDArray[np.float64]

_N_CLASSES, _PER_CLASS, _N_FEATURES = 12, 10, 20
_PRICES = (1.0, 100.0)
_EASY, _SVCS, _WALK = "MKLpy EasyMKL", "22 SVC fits", "SimpleMKL on SVC"
_MANY = (10_000, 100_000)
_LARGE = """
import json, sys, time
import numpy as np
from palpate.classifiers import MKLSVC, GaussianKernel

def peak_gib():
    try:
        with open("/proc/self/status") as lines:
            return next(int(l.split()[1]) for l in lines if "VmHWM" in l) / 2**20
    except OSError:
        import resource
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (2**30 if sys.platform == "darwin" else 2**20)

n = int(sys.argv[1])
rng = np.random.default_rng(0)
codes = rng.integers(2, size=n)
touches = rng.normal(size=(n, 20)) + 0.5 * np.eye(2, 20)[codes]
kernels = [GaussianKernel(s) for s in (2.0, 4.0, 8.0, 16.0)]
machine = MKLSVC(C=n, kernels=kernels, probability=False, random_state=0)
before, start = peak_gib(), time.process_time()
machine.fit(touches, codes)
spent = time.process_time() - start
print(json.dumps(dict(ms=1e3 * spent, gap=machine.gap_[0], peak=peak_gib(),
    before=before, n_iter=int(machine.n_iter_[0]))))
"""


def bench_mkl(
    *, seconds: float = 1.0, large: bool = True, random_state: int = 0
) -> list[dict[str, object]]:
    """Time learning from given kernel matrices, and from features.

    Parameters
    ----------
    seconds : float, default=1.0
        CPU time to spend on each figure.
    large : bool, default=True
        Also learn from 10,000 and from 100,000 touches, in processes of their own;
        takes about a minute.
    random_state : int, default=0

    Returns
    -------
    list of dict
        Rows with `name`, `ours_ms`, `peer`, `peer_ms`, `ratio`. Where the peer is
        not installed or there is none, `ratio` is None and `reason` says so.
    """
    touches, codes = _draw(random_state)
    rows = []
    with one_thread():
        for C in _PRICES:
            rows += _rows_given(touches, codes, C, seconds)
            rows += _rows_counted(touches, codes, C, seconds)
            rows.append(_row_simplemkl(touches, codes, C, seconds))
    return rows + ([_row_large(n) for n in _MANY] if large else [])


def _draw(random_state: int) -> tuple[Floats, NDArray]:
    """Touches of 12 classes in 40 features, fused to 20 by kernel PCA."""
    rng = np.random.default_rng(random_state)
    codes = np.repeat(np.arange(_N_CLASSES), _PER_CLASS)
    centres = 0.7 * rng.normal(size=(_N_CLASSES, 40))
    raw = centres[codes] + rng.normal(size=(len(codes), 40))
    return KernelPCA(n_components=_N_FEATURES).fit_transform(raw), codes


def _name(what: str, C: float) -> str:
    size = f"{_N_CLASSES} x {_PER_CLASS} touches 22 kernels"
    return f"{size} float64 {what} C {C:g}"


def _rows_given(
    touches: Floats, codes: NDArray, C: float, seconds: float
) -> list[dict[str, object]]:
    stack = _kernels(touches)
    machine = MKLSVC(C=C, kernels="precomputed", probability=False)
    given = np.ascontiguousarray(stack.transpose(1, 2, 0))
    ours_ms = cpu_ms(lambda: machine.fit(given, codes), seconds)
    facts = {"gap": float(machine.gap_.max()), "n_iter": int(machine.n_iter_.max())}
    name = _name("kernels given", C)
    plain_ms = cpu_ms(lambda: _fit_each(stack, codes, C), seconds)
    return [
        _easy_row(name, ours_ms, lambda: stack, codes, seconds, facts),
        row(name, ours_ms, _SVCS, plain_ms, **facts),
    ]


def _rows_counted(
    touches: Floats, codes: NDArray, C: float, seconds: float
) -> list[dict[str, object]]:
    machine = MKLSVC(C=C, probability=False)
    ours_ms = cpu_ms(lambda: machine.fit(touches, codes), seconds)
    facts = {"gap": float(machine.gap_.max()), "n_iter": int(machine.n_iter_.max())}
    name = _name("kernels counted", C)
    plain_ms = cpu_ms(lambda: _fit_each(_kernels(touches), codes, C), seconds)
    return [
        _easy_row(name, ours_ms, lambda: _kernels(touches), codes, seconds, facts),
        row(name, ours_ms, _SVCS, plain_ms, **facts),
    ]


def _row_simplemkl(
    touches: Floats, codes: NDArray, C: float, seconds: float
) -> dict[str, object]:
    """Compare one algorithm on our machines and on scikit-learn's, gap 1e-2."""
    stack = _kernels(touches)
    given = np.ascontiguousarray(stack.transpose(1, 2, 0))
    machine = MKLSVC(
        C=C,
        kernels="precomputed",
        solver="simplemkl",
        probability=False,
    )
    ours_ms = cpu_ms(lambda: machine.fit(given, codes), seconds)
    # A fraction of the pairs will do: the whole takes some seconds a time.
    some = machine.pairs_[::6]

    def walk_some() -> None:
        for pair in some:
            _walk(stack, codes, pair, C)

    peer_ms = cpu_ms(walk_some, 0.0)
    peer_ms *= len(machine.pairs_) / len(some)
    facts = {"gap": float(machine.gap_.max())}
    return row(_name("SimpleMKL kernels given", C), ours_ms, _WALK, peer_ms, **facts)


def _kernels(touches: Floats) -> Floats:
    """The bank of the paper by scikit-learn, each of trace 1."""
    stack = np.stack([_kernel(kernel, touches) for kernel in paper_kernels()])
    stack /= np.einsum("kii->k", stack)[:, None, None]
    return stack


def _kernel(kernel: Any, touches: Floats) -> Floats:
    if isinstance(kernel, PolynomialKernel):
        return polynomial_kernel(touches, degree=kernel.degree, gamma=1, coef0=1)
    return rbf_kernel(touches, gamma=1 / (2 * kernel.sigma**2))


def _fit_each(stack: Floats, codes: NDArray, C: float) -> None:
    for kernel in stack:
        SVC(kernel="precomputed", C=C).fit(kernel, codes)


def _walk(stack: Floats, codes: NDArray, pair: NDArray, C: float) -> None:
    """SimpleMKL for one pair of classes, its machines by scikit-learn."""
    chosen = np.flatnonzero(np.isin(codes, pair))
    kernels = np.ascontiguousarray(stack[:, chosen[:, None], chosen])
    walk = reduced_gradient_walk(len(kernels), tol=1e-2, max_iter=500)
    weights = next(walk)
    with contextlib.suppress(StopIteration):
        while True:
            summed = np.tensordot(weights, kernels, 1)
            machine = SVC(kernel="precomputed", C=C, tol=1e-6)
            machine.fit(summed, codes[chosen])
            signed = np.zeros(len(chosen))
            signed[machine.support_] = machine.dual_coef_[0]
            energies = 0.5 * ((kernels @ signed) @ signed)
            value = float(np.abs(signed).sum() - weights @ energies)
            weights = walk.send(Answer(value, energies))


def _easy_row(
    name: str,
    ours_ms: float,
    make: Callable[[], Floats],
    codes: NDArray,
    seconds: float,
    facts: dict[str, Any],
) -> dict[str, object]:
    if find_spec("MKLpy") is None or find_spec("torch") is None:
        reason = "MKLpy is not installed; `make bench` installs it (GPL-3, with torch)"
        return row(name, ours_ms, _EASY, None, reason=reason, **facts)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        torch = import_module("torch")
        algorithms = import_module("MKLpy.algorithms")
        torch.set_num_threads(1)
        machine = algorithms.EasyMKL(multiclass_strategy="ovo")

        def fit() -> None:
            machine.fit([torch.tensor(kernel) for kernel in make()], codes)

        peer_ms = cpu_ms(fit, seconds)
    return row(name, ours_ms, _EASY, peer_ms, **facts)


def _row_large(n_touches: int) -> dict[str, object]:
    """Learn from very many touches, and say the memory it took."""
    command = [sys.executable, "-c", _LARGE, str(n_touches)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    name = f"2 classes {n_touches} touches 4 kernels float64 Nystroem 200 landmarks"
    exact = 4 * 8 * n_touches**2 / 2**30
    return row(
        name,
        found["ms"],
        "none",
        None,
        reason=f"the four kernel matrices alone would take {exact:.0f} GiB",
        gap=found["gap"],
        n_iter=found["n_iter"],
        peak_gib=found["peak"],
        peak_before_gib=found["before"],
    )
