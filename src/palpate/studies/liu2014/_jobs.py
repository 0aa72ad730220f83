"""Everything the Liu 2014 study compares, as a list of jobs: one row each, or two.

The paper looks at images of a bar: light loads leave them incomplete, heavy ones
distort them, thin covers break them up, thick ones blur them (Figs 5 and 6). Here the
same is counted over all presses.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import Floats
from ...encodings import CentroidMoments, sorted_taxels
from ...touches import Touches
from .._report import Row
from .._study import Work
from .._touches import Codes, coded
from ._methods import (
    MKL,
    Fused,
    GaussianSVM,
    Half,
    Method,
    Neighbours,
    Twofold,
    nested_figure,
    paper_figure,
)
from ._plan import (
    FIGURES,
    PAPER_COVER_MM,
    PAPER_LOAD_KGF,
    PAPER_N,
    PAPER_PARTITIONS,
    SCALINGS,
    TABLE_2,
    Liu2014Plan,
)
from ._presses import (
    Encoded,
    count_pieces,
    encode,
    footprints,
    overlap,
    simulated_presses,
)

Runs = Sequence[list[Half]]


@dataclass(frozen=True, eq=False)
class Job:
    """Features, labels and a method; `row` is what is known before the figures."""

    row: Row
    features: Floats
    codes: Codes
    method: Method

    @property
    def light(self) -> bool:
        """Whether nothing is chosen, so that a run takes milliseconds."""
        return len(self.method.settings) == 1

    @property
    def work(self) -> float:
        """How long a run takes, in no unit."""
        return float(len(self.method.settings) * self.row["n_classes"] ** 2)

    def run(self, plan: Liu2014Plan, number: int) -> list[Half]:
        """Do one run of twofold cross-validation."""
        twofold = Twofold(self.row["features"] == "z-scored", plan.inner_folds)
        seed = (plan.seed, number)
        return twofold.run(self.method, self.features, self.codes, seed)

    def rows(self, runs: Runs, plan: Liu2014Plan) -> Iterator[Row]:
        """Yield a row per protocol; where nothing is chosen, one outside Table 2."""
        single = self.light and self.row["table"] != "Table 2"
        for protocol in plan.protocols[:1] if single else plan.protocols:
            summary = nested_figure if protocol == "nested" else paper_figure
            figure = summary(self.method.settings, runs)
            yield {**self.row, "protocol": protocol, **figure}


def run_jobs(jobs: Sequence[Job], plan: Liu2014Plan, work: Work) -> list[Row]:
    """Return the rows of all jobs; light ones of one kind share their tasks."""
    shared: dict[str, list[int]] = {}
    for number, job in enumerate(jobs):
        light = f"{job.row['data']}, {job.row['features']}"
        shared.setdefault(light if job.light else f"alone {number}", []).append(number)
    # The longest first, so that no worker is left with one at the end.
    groups = sorted(shared.values(), key=lambda some: -sum(jobs[j].work for j in some))
    asked = [(group, number) for group in groups for number in range(plan.runs)]
    tasks = [([jobs[j] for j in group], plan, number) for group, number in asked]
    runs: list[list[list[Half]]] = [[] for _ in jobs]
    done = work.done(_run_all, tasks, "cross-validating")
    for (group, _), halves in zip(asked, done, strict=True):
        for j, one in zip(group, halves, strict=True):
            runs[j].append(one)
    both = zip(jobs, runs, strict=True)
    return [row for job, its_runs in both for row in job.rows(its_runs, plan)]


def study_jobs(plan: Liu2014Plan, touches: Touches, data: str) -> list[Job]:
    """Return Table 2, the controls and Figs 12 to 14 for one set of touches."""
    most = max(plan.n, *plan.counts)
    encoded = {p: encode(touches.images, p, most) for p in plan.partitions}
    jobs = [
        job
        for partitions, features in encoded.items()
        for job in _table_2(plan, features, coded(touches), partitions)
    ]
    jobs += _controls(plan, touches)
    if PAPER_PARTITIONS in encoded:
        jobs += _equal_grids(plan, encoded[PAPER_PARTITIONS], coded(touches))
        jobs += _figures(plan, encoded[PAPER_PARTITIONS], touches)
    for job in jobs:
        job.row["data"] = data
    return jobs


def condition_jobs(plan: Liu2014Plan) -> Iterator[Job]:
    """Press all parts at every load, then under every cover; 3-NN names them."""
    for load in plan.loads_kgf:
        yield from _condition(plan, "Fig. 5", f"{load:g} kgf", load, PAPER_COVER_MM)
    for cover in plan.covers_mm:
        condition = f"cover {cover:g} mm"
        yield from _condition(plan, "Fig. 6", condition, PAPER_LOAD_KGF, cover)


def _run_all(jobs: Iterable[Job], plan: Liu2014Plan, number: int) -> Runs:
    return [job.run(plan, number) for job in jobs]


def _condition(
    plan: Liu2014Plan, table: str, condition: str, load: float, cover: float
) -> Iterator[Job]:
    touches = simulated_presses(plan, load, cover)
    encoded = encode(touches.images, PAPER_PARTITIONS, plan.n)
    whole = encode(touches.images, 1, 1).binary
    pieces = count_pieces(whole)
    truth = footprints(touches, whole.shape[1:])
    row: Row = {
        "table": table,
        "condition": condition,
        "classes": "all",
        "load_kgf": load,
        "cover_mm": cover,
        "pieces": float(pieces.mean()),
        "in_pieces": 100 * float((pieces > 1).mean()),
        "pieces_2x2": float(count_pieces(encoded.binary).mean()),
        "overlap": 100 * float(overlap(whole, truth).mean()),
        "overlap_2x2": 100 * float(overlap(encoded.binary, truth).mean()),
        "data": "simulated",
    }
    compared = {"FD+GE": encoded.features("FD+GE", plan.n), **_pixels(touches)}
    for encoding, features in compared.items():
        known = {"name": f"{encoding} k-NN, {condition}", "encoding": encoding, **row}
        yield from _jobs(known, features, coded(touches), Neighbours())


def _table_2(
    plan: Liu2014Plan, encoded: Encoded, codes: Codes, partitions: int
) -> Iterator[Job]:
    svm = GaussianSVM(plan.svm_widths, plan.svm_costs)
    mkl, grid = MKL(plan.mkl_costs), (plan.widths, plan.components)
    methods: dict[str, Method] = {
        "FD+GE k-NN": Neighbours(),
        "FD+GE SVM": svm,
        "KPCA+SVM": Fused(svm, *grid),
        "KPCA+MKL-SVM": Fused(mkl, *grid),
    }
    suffix, paper = f", {partitions} x {partitions}", dict[str, float]()
    if partitions == PAPER_PARTITIONS:
        methods["KPCA (eq. 5)+MKL-SVM"] = Fused(mkl, *grid, scaling="paper")
        suffix, paper = "", TABLE_2 if plan.n == PAPER_N else {}
    for name, method in methods.items():
        row = {
            "name": name + suffix,
            "table": "Table 2",
            "paper": paper.get(name),
            "encoding": "FD+GE",
            "classes": "all",
            "n": plan.n,
            "partitions": partitions,
        }
        yield from _jobs(row, encoded.features("FD+GE", plan.n), codes, method)


def _equal_grids(plan: Liu2014Plan, encoded: Encoded, codes: Codes) -> Iterator[Job]:
    """SVM and MKL on the same components, each with the same number of settings."""
    costs = plan.equal_costs
    methods: dict[str, Method] = {
        "KPCA+SVM": GaussianSVM(plan.svm_widths, plan.svm_costs),
        "KPCA+MKL-SVM, trace": MKL(costs),
        "KPCA+MKL-SVM, variance": MKL(costs, "variance"),
    }
    width, kept = plan.widths[len(plan.widths) // 2], max(plan.components)
    for name, method in methods.items():
        row = {
            "name": f"{name}, {len(costs)} settings",
            "table": "equal grids",
            "encoding": "FD+GE",
            "classes": "all",
            "n": plan.n,
            "partitions": PAPER_PARTITIONS,
        }
        fused = Fused(method, (width,), (kept,))
        yield from _jobs(row, encoded.features("FD+GE", plan.n), codes, fused)


def _controls(plan: Liu2014Plan, touches: Touches) -> Iterator[Job]:
    """Pixels without geometry, pixels as they are, and moments, on all classes."""
    moments = CentroidMoments().fit_transform(touches.images)
    methods: dict[str, Method] = {
        "k-NN": Neighbours(),
        "SVM": GaussianSVM(plan.svm_widths, plan.svm_costs),
    }
    for encoding, features in {**_pixels(touches), "centroid moments": moments}.items():
        known = {"table": "controls", "encoding": encoding, "classes": "all"}
        for name, method in methods.items():
            row = {"name": f"{encoding} {name}", **known}
            yield from _jobs(row, features, coded(touches), method)


def _figures(plan: Liu2014Plan, encoded: Encoded, touches: Touches) -> Iterator[Job]:
    """3-NN on each class set: FD, GE, both, and two controls."""
    compared: list[tuple[str, str, int | None]] = [("Fig. 13", "GE", None)]
    for n in plan.counts:
        compared += [("Fig. 12", "FD", n), ("Fig. 14", "FD+GE", n)]
    pixels = _pixels(touches)
    compared += [("Figs 12-14", encoding, None) for encoding in pixels]
    part = touches.columns.get("part")
    sets = {"all": np.ones(len(touches), dtype=bool)}
    if part is not None:
        sets = {name: np.isin(part, some) for name, some in plan.class_sets.items()}
    asked = [(classes, *one) for classes in sets for one in compared]
    for classes, figure, encoding, count in asked:
        held, known = sets[classes], FIGURES.get((encoding, classes))
        shown = "" if count is None else f", n = {count}"
        row = {
            "name": f"{encoding} k-NN{shown}, {classes}",
            "table": figure,
            "paper": known if count in (None, PAPER_N) else None,
            "encoding": encoding,
            "classes": classes,
            "n": count,
            "partitions": PAPER_PARTITIONS,
        }
        features = pixels.get(encoding)
        if features is None:
            features = encoded.features(encoding, count or 0)
        yield from _jobs(row, features[held], coded(touches)[held], Neighbours())


def _jobs(row: Row, features: Floats, codes: Codes, method: Method) -> Iterator[Job]:
    """Yield the same for z-scored and for raw features."""
    sizes: dict[str, Any] = {
        "n_classes": len(np.unique(codes)),
        "n_touches": len(codes),
    }
    for scaling in SCALINGS:
        known = {"paper": None, **sizes, "features": scaling}
        yield Job({**known, **row}, features, codes, method)


def _pixels(touches: Touches) -> dict[str, Floats]:
    flat = touches.images.reshape(len(touches), -1)
    return {
        "sorted pixels": sorted_taxels(touches.images, normalise=True),
        "raw pixels": flat.astype(np.float64),
    }
