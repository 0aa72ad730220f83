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
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from sklearn.metrics.pairwise import polynomial_kernel, rbf_kernel
from sklearn.svm import SVC

from palpate._types import Array, Floats
from palpate.classifiers import mkl
from palpate.encodings import KernelPCA

from . import Row, cpu_ms, measured_apart, one_thread, row

Tensors = Callable[[Floats], list[Any]]
Easy = Callable[[Any, Tensors], None]
# Kernel matrices of the touches learnt, and of those recognised if they are asked.
Stacks = tuple[Floats, Floats | None]

_N_CLASSES, _PER_CLASS, _N_FEATURES = 12, 10, 20  # a study of Liu 2014's size
_SIZE = f"{_N_CLASSES} x {_PER_CLASS} touches 22 kernels float64"
_PRICES = (1.0, 100.0)  # values of C: a soft margin and a hard one
_MANY = (10_000, 100_000)  # touches, of which 200 are landmarks
_LARGE = """
import numpy as np
from palpate.classifiers import MKLSVC, GaussianKernel

n = int(sys.argv[1])
rng = np.random.default_rng(0)
codes = rng.integers(2, size=n)
touches = rng.normal(size=(n, 20)) + 0.5 * np.eye(2, 20)[codes]
kernels = [GaussianKernel(s) for s in (2.0, 4.0, 8.0, 16.0)]
machine = MKLSVC(C=n, kernels=kernels, probability=False, random_state=0)
before, start = peak_mib(), time.process_time()
machine.fit(touches, codes)
spent = time.process_time() - start
print(json.dumps(dict(ms=1e3 * spent, gap=machine.gap_[0], peak=peak_mib() / 1024,
    before=before / 1024, n_iter=int(machine.n_iter_[0]))))
"""


def bench_mkl(
    *, seconds: float = 1.0, large: bool = True, random_state: int = 0
) -> list[Row]:
    """Time learning from kernels and features; `large`: from 10^5 touches, a minute."""
    # Touches of 12 classes in 40 features, fused to 20 by kernel PCA.
    rng = np.random.default_rng(random_state)
    codes = np.repeat(np.arange(_N_CLASSES), _PER_CLASS)
    centres = 0.7 * rng.normal(size=(_N_CLASSES, 40))
    raw, other = centres[codes] + rng.normal(size=(2, len(codes), 40))
    fusion = KernelPCA(n_components=_N_FEATURES).fit(raw)
    case = _Case(fusion.transform(raw), fusion.transform(other), codes)
    rows = []
    with one_thread():
        for C in _PRICES:
            rows += _rows(case, C, seconds, "kernels given learn")
            rows += _rows(case, C, seconds, "kernels counted learn")
            rows += _rows(case, C, seconds, "kernels counted learn and recognise")
            rows.append(_row_simplemkl(case, C, seconds))
    return rows + ([_row_large(n) for n in _MANY] if large else [])


@dataclass
class _Case:
    touches: Floats
    others: Floats
    codes: Array

    def kernels(self, *, recognise: bool = False) -> Stacks:
        """Count the paper's kernels by scikit-learn, of trace 1 where they learn."""
        zero = np.zeros(_N_FEATURES)
        traces = mkl.kernel_diagonals(mkl.paper_kernels(), self.touches, zero).sum(
            axis=1
        )
        sides = [self.touches, self.others] if recognise else [self.touches]
        learn, *others = (
            np.stack([_kernel(k, side, self.touches) for k in mkl.paper_kernels()])
            / traces[:, None, None]
            for side in sides
        )
        return learn, others[0] if others else None


def _rows(case: _Case, C: float, seconds: float, what: str) -> list[Row]:
    """Time ours, one machine per kernel, and EasyMKL, at one of three jobs."""
    ready, recognise = "given" in what, "recognise" in what
    stack, _ = case.kernels()
    learnt = np.ascontiguousarray(stack.transpose(1, 2, 0)) if ready else case.touches
    bank: dict[str, Any] = {"kernels": "precomputed"} if ready else {}
    machine = mkl.MKLSVC(C=C, probability=False, **bank)

    def stacks() -> Stacks:
        return (stack, None) if ready else case.kernels(recognise=recognise)

    def ours() -> None:
        machine.fit(learnt, case.codes)
        if recognise:
            machine.predict(case.others)

    def plain() -> None:
        learn, others = stacks()
        for k, kernel in enumerate(learn):
            fitted = SVC(kernel="precomputed", C=C).fit(kernel, case.codes)
            if others is not None:
                fitted.predict(others[k])

    def easy(model: Any, tensors: Tensors) -> None:
        learn, others = stacks()
        model.fit(tensors(learn), case.codes)
        if others is not None:
            model.predict(tensors(others))

    name = f"{_SIZE} {what} C {C:g}"
    ours_ms, plain_ms = cpu_ms(ours, seconds), cpu_ms(plain, seconds)
    facts = {"gap": float(machine.gap_.max()), "n_iter": int(machine.n_iter_.max())}
    return [
        row(name, ours_ms, "MKLpy EasyMKL", **facts, **_time_easy(easy, seconds)),
        row(name, ours_ms, "22 SVC fits", plain_ms, **facts),
    ]


def _time_easy(easy: Easy, seconds: float) -> dict[str, Any]:
    """Return the milliseconds that EasyMKL takes, or why there are none."""
    if find_spec("MKLpy") is None or find_spec("torch") is None:
        return {"reason": "MKLpy is not installed; `make bench` installs it (GPL-3)"}
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        torch = import_module("torch")
        torch.set_num_threads(1)
        model = import_module("MKLpy.algorithms").EasyMKL(multiclass_strategy="ovo")

        def tensors(stack: Floats) -> list[Any]:
            return [torch.tensor(kernel) for kernel in stack]

        return {"peer_ms": cpu_ms(lambda: easy(model, tensors), seconds)}


def _row_simplemkl(case: _Case, C: float, seconds: float) -> Row:
    """Compare one algorithm on our machines and on scikit-learn's, gap 1e-2."""
    stack, _ = case.kernels()
    kernels = np.ascontiguousarray(stack.transpose(1, 2, 0))
    machine = mkl.MKLSVC(
        C=C, kernels="precomputed", solver="simplemkl", probability=False
    )
    ours_ms = cpu_ms(lambda: machine.fit(kernels, case.codes), seconds)
    # A part of the pairs will do: all of them take seconds.
    tested = machine.pairs_[::6]
    walks_ms = cpu_ms(lambda: _walk(stack, case.codes, tested, C), 0.0)
    peer_ms = walks_ms * len(machine.pairs_) / len(tested)
    name = f"{_SIZE} SimpleMKL kernels given learn C {C:g}"
    gap = float(machine.gap_.max())
    return row(name, ours_ms, "SimpleMKL on SVC", peer_ms, gap=gap)


def _kernel(kernel: Any, left: Floats, right: Floats) -> Floats:
    if isinstance(kernel, mkl.PolynomialKernel):
        fixed = {"degree": kernel.degree, "gamma": 1, "coef0": 1}
        return np.asarray(polynomial_kernel(left, right, **fixed))
    return np.asarray(rbf_kernel(left, right, gamma=1 / (2 * kernel.sigma**2)))


def _walk(stack: Floats, codes: Array, pairs: Array, C: float) -> None:
    """Learn SimpleMKL for pairs of classes, with machines of scikit-learn."""
    for pair in pairs:
        chosen = np.flatnonzero(np.isin(codes, pair))
        kernels = np.ascontiguousarray(stack[:, chosen[:, None], chosen])
        walk = mkl.reduced_gradient_walk(len(kernels), tol=1e-2, max_iter=500)
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
                weights = walk.send(mkl.Answer(value, energies))


def _row_large(n_touches: int) -> Row:
    measured = measured_apart(_LARGE, n_touches)
    exact = 4 * 8 * n_touches**2 / 2**30
    return row(
        f"2 classes {n_touches} touches 4 kernels float64 Nystroem 200 landmarks",
        measured["ms"],
        "none",
        reason=f"the four kernel matrices alone would take {exact:.0f} GiB",
        gap=measured["gap"],
        n_iter=measured["n_iter"],
        peak_gib=measured["peak"],
        peak_before_gib=measured["before"],
    )
