"""Multiple kernel learning beside MKLpy, beside plain machines, and for many touches.

The setting of Liu et al. 2014: 12 classes, 10 touches each to learn from and 10 to
recognise, 66 pairs of classes, 22 kernels, 20 features from kernel PCA; the touches
are drawn at random.
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
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics.pairwise import polynomial_kernel, rbf_kernel
from sklearn.svm import SVC

from ..classifiers.mkl import (
    MKLSVC,
    Answer,
    PolynomialKernel,
    kernel_diagonals,
    paper_kernels,
    reduced_gradient_walk,
)
from ..encodings import KernelPCA
from ._timing import cpu_ms, one_thread, row

Floats = NDArray[np.float64]
Tensors = Callable[[Floats], list[Any]]
Easy = Callable[[Any, Tensors], None]

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
    case = _draw(random_state)
    rows = []
    with one_thread():
        for C in _PRICES:
            rows += _rows_given(case, C, seconds)
            rows += _rows_counted(case, C, seconds, recognise=False)
            rows += _rows_counted(case, C, seconds, recognise=True)
            rows.append(_row_simplemkl(case, C, seconds))
    return rows + ([_row_large(n) for n in _MANY] if large else [])


@dataclass
class _Case:
    """Touches to learn from and as many to recognise, of the same labels."""

    touches: Floats
    others: Floats
    codes: NDArray

    def kernels(self) -> Floats:
        return _kernels(self.touches, self.touches, _traces(self.touches))

    def both_kernels(self) -> tuple[Floats, Floats]:
        traces = _traces(self.touches)
        learn = _kernels(self.touches, self.touches, traces)
        return learn, _kernels(self.others, self.touches, traces)


def _draw(random_state: int) -> _Case:
    """Touches of 12 classes in 40 features, fused to 20 by kernel PCA."""
    rng = np.random.default_rng(random_state)
    codes = np.repeat(np.arange(_N_CLASSES), _PER_CLASS)
    centres = 0.7 * rng.normal(size=(_N_CLASSES, 40))
    raw, other = centres[codes] + rng.normal(size=(2, len(codes), 40))
    fusion = KernelPCA(n_components=_N_FEATURES).fit(raw)
    return _Case(fusion.transform(raw), fusion.transform(other), codes)


def _name(what: str, C: float) -> str:
    size = f"{_N_CLASSES} x {_PER_CLASS} touches 22 kernels"
    return f"{size} float64 {what} C {C:g}"


def _rows_given(case: _Case, C: float, seconds: float) -> list[dict[str, object]]:
    stack = case.kernels()
    given = np.ascontiguousarray(stack.transpose(1, 2, 0))
    machine = MKLSVC(C=C, kernels="precomputed", probability=False)

    def easy(model: Any, tensors: Tensors) -> None:
        model.fit(tensors(stack), case.codes)

    ours_ms = cpu_ms(lambda: machine.fit(given, case.codes), seconds)
    plain_ms = cpu_ms(lambda: _fit_each(stack, case.codes, C), seconds)
    name = _name("kernels given learn", C)
    return _pair_of_rows(name, machine, ours_ms, plain_ms, easy, seconds)


def _rows_counted(
    case: _Case, C: float, seconds: float, *, recognise: bool
) -> list[dict[str, object]]:
    machine = MKLSVC(C=C, probability=False)

    def ours() -> None:
        machine.fit(case.touches, case.codes)
        if recognise:
            machine.predict(case.others)

    def plain() -> None:
        if recognise:
            learn, others = case.both_kernels()
            _fit_each(learn, case.codes, C, others)
        else:
            _fit_each(case.kernels(), case.codes, C)

    def easy(model: Any, tensors: Tensors) -> None:
        if recognise:
            learn, others = case.both_kernels()
            model.fit(tensors(learn), case.codes)
            model.predict(tensors(others))
        else:
            model.fit(tensors(case.kernels()), case.codes)

    ours_ms, plain_ms = cpu_ms(ours, seconds), cpu_ms(plain, seconds)
    what = "learn and recognise" if recognise else "learn"
    name = _name(f"kernels counted {what}", C)
    return _pair_of_rows(name, machine, ours_ms, plain_ms, easy, seconds)


def _pair_of_rows(
    name: str,
    machine: MKLSVC,
    ours_ms: float,
    plain_ms: float,
    easy: Easy,
    seconds: float,
) -> list[dict[str, object]]:
    facts = {"gap": float(machine.gap_.max()), "n_iter": int(machine.n_iter_.max())}
    easy_ms, reason = _time_easy(easy, seconds)
    if easy_ms is None:
        facts_of_easy: dict[str, Any] = {**facts, "reason": reason}
    else:
        facts_of_easy = facts
    return [
        row(name, ours_ms, _EASY, easy_ms, **facts_of_easy),
        row(name, ours_ms, _SVCS, plain_ms, **facts),
    ]


def _time_easy(easy: Easy, seconds: float) -> tuple[float | None, str]:
    """Return the milliseconds that EasyMKL takes, or why there are none."""
    if find_spec("MKLpy") is None or find_spec("torch") is None:
        return None, "MKLpy is not installed; `make bench` installs it (GPL-3)"
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        torch = import_module("torch")
        torch.set_num_threads(1)
        model = import_module("MKLpy.algorithms").EasyMKL(multiclass_strategy="ovo")

        def tensors(stack: Floats) -> list[Any]:
            return [torch.tensor(kernel) for kernel in stack]

        return cpu_ms(lambda: easy(model, tensors), seconds), ""


def _row_simplemkl(case: _Case, C: float, seconds: float) -> dict[str, object]:
    """Compare one algorithm on our machines and on scikit-learn's, gap 1e-2."""
    stack = case.kernels()
    given = np.ascontiguousarray(stack.transpose(1, 2, 0))
    machine = MKLSVC(C=C, kernels="precomputed", solver="simplemkl", probability=False)
    ours_ms = cpu_ms(lambda: machine.fit(given, case.codes), seconds)
    # A part of the pairs will do: all of them take seconds.
    some = machine.pairs_[::6]

    def walk_some() -> None:
        for pair in some:
            _walk(stack, case.codes, pair, C)

    peer_ms = cpu_ms(walk_some, 0.0) * len(machine.pairs_) / len(some)
    name = _name("SimpleMKL kernels given learn", C)
    return row(name, ours_ms, _WALK, peer_ms, gap=float(machine.gap_.max()))


def _kernels(left: Floats, right: Floats, traces: Floats) -> Floats:
    """The bank of the paper by scikit-learn, each of trace 1 where it is learnt."""
    stack = np.stack([_kernel(kernel, left, right) for kernel in paper_kernels()])
    return stack / traces[:, None, None]


def _kernel(kernel: Any, left: Floats, right: Floats) -> Floats:
    if isinstance(kernel, PolynomialKernel):
        return polynomial_kernel(left, right, degree=kernel.degree, gamma=1, coef0=1)
    return rbf_kernel(left, right, gamma=1 / (2 * kernel.sigma**2))


def _traces(touches: Floats) -> Floats:
    return kernel_diagonals(paper_kernels(), touches, np.zeros(_N_FEATURES)).sum(axis=1)


def _fit_each(
    stack: Floats, codes: NDArray, C: float, others: Floats | None = None
) -> None:
    for k, kernel in enumerate(stack):
        machine = SVC(kernel="precomputed", C=C).fit(kernel, codes)
        if others is not None:
            machine.predict(others[k])


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
