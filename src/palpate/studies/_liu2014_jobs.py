"""Everything the Liu 2014 study compares, as a list of jobs: one row each, or two."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..encodings import CentroidMoments, sorted_taxels
from ..touches import Touches
from ._liu2014_methods import MKL, Fused, GaussianSVM, Neighbours
from ._liu2014_plan import (
    FIGURES,
    PAPER_N,
    PAPER_PARTITIONS,
    SCALINGS,
    TABLE_2,
    Liu2014Plan,
)
from ._liu2014_touches import Encoded, Floats, encode
from ._recorded import labels
from ._twofold import Codes, Method


@dataclass(frozen=True, eq=False)
class Job:
    """Features, labels and a method; `row` is what is known before the figures."""

    row: dict[str, Any]
    features: Floats
    codes: Codes
    method: Method
    scaled: bool
    group: str = field(default="light")


def study_jobs(plan: Liu2014Plan, touches: Touches, data: str) -> list[Job]:
    """Return Table 2, the controls and Figs 12 to 14 for one set of touches."""
    encoded = {p: encode(touches.images, p, _most(plan)) for p in plan.partitions}
    jobs = [
        job
        for partitions, features in encoded.items()
        for job in _table_2(plan, features, _codes(touches), partitions)
    ]
    jobs += _controls(plan, touches)
    if PAPER_PARTITIONS in encoded:
        jobs += _figures(plan, encoded[PAPER_PARTITIONS], touches)
    for job in jobs:
        job.row["data"] = data
    return jobs


def curve_jobs(
    plan: Liu2014Plan, touches: Touches, encoded: Encoded, row: dict[str, Any]
) -> Iterator[Job]:
    """Return 3-NN on the paper's features, and the controls, at one condition."""
    compared = {
        "FD+GE": encoded.features("FD+GE", plan.n),
        "sorted pixels": sorted_taxels(touches.images, normalise=True),
        "raw pixels": _flat(touches),
    }
    codes = _codes(touches)
    for name, features in compared.items():
        for scaling in SCALINGS:
            known = {
                **row,
                "name": f"{name} k-NN, {row['condition']}",
                "data": "simulated",
                "encoding": name,
            }
            yield _job(known, features, codes, Neighbours(), scaling)


def _table_2(
    plan: Liu2014Plan, encoded: Encoded, codes: Codes, partitions: int
) -> Iterator[Job]:
    features = encoded.features("FD+GE", plan.n)
    svm = GaussianSVM(plan.svm_widths, plan.svm_costs)
    mkl, grid = MKL(plan.mkl_costs), (plan.widths, plan.components)
    methods: dict[str, Method] = {
        "FD+GE k-NN": Neighbours(),
        "FD+GE SVM": svm,
        "KPCA+SVM": Fused(svm, *grid),
        "KPCA+MKL-SVM": Fused(mkl, *grid),
    }
    paper: dict[str, float] = TABLE_2 if partitions == PAPER_PARTITIONS else {}
    if partitions == PAPER_PARTITIONS:
        methods["KPCA (eq. 5)+MKL-SVM"] = Fused(mkl, *grid, scaling="paper")
    suffix = "" if partitions == PAPER_PARTITIONS else f", {partitions} x {partitions}"
    for name, method in methods.items():
        for scaling in SCALINGS:
            row = {
                "name": name + suffix,
                "table": "Table 2",
                "paper": paper.get(name) if plan.n == PAPER_N else None,
                "encoding": "FD+GE",
                "classes": "all",
                "n": plan.n,
                "partitions": partitions,
            }
            yield _job(row, features, codes, method, scaling)


def _controls(plan: Liu2014Plan, touches: Touches) -> Iterator[Job]:
    """Pixels without geometry, pixels as they are, and moments, on all classes."""
    encodings = {
        "sorted pixels": sorted_taxels(touches.images, normalise=True),
        "raw pixels": _flat(touches),
        "centroid moments": CentroidMoments().fit_transform(touches.images),
    }
    methods: dict[str, Method] = {
        "k-NN": Neighbours(),
        "SVM": GaussianSVM(plan.svm_widths, plan.svm_costs),
    }
    for encoding, features in encodings.items():
        for classifier, method in methods.items():
            for scaling in SCALINGS:
                row = {
                    "name": f"{encoding} {classifier}",
                    "table": "controls",
                    "encoding": encoding,
                    "classes": "all",
                }
                yield _job(row, features, _codes(touches), method, scaling)


def _figures(plan: Liu2014Plan, encoded: Encoded, touches: Touches) -> Iterator[Job]:
    """3-NN on each class set: FD, GE, both, and two controls."""
    part = touches.columns.get("part")
    whole = {"all": np.ones(len(touches), dtype=bool)}
    sets = (
        whole
        if part is None
        else {name: np.isin(part, found) for name, found in plan.class_sets.items()}
    )
    codes = _codes(touches)
    for classes, held in sets.items():
        for figure, encoding, n, features in _figure_features(plan, encoded, touches):
            paper = FIGURES.get((encoding, classes)) if n in (None, PAPER_N) else None
            shown = "" if n is None else f", n = {n}"
            for scaling in SCALINGS:
                row = {
                    "name": f"{encoding} k-NN{shown}, {classes}",
                    "table": figure,
                    "paper": paper,
                    "encoding": encoding,
                    "classes": classes,
                    "n": n,
                    "partitions": PAPER_PARTITIONS,
                }
                yield _job(row, features[held], codes[held], Neighbours(), scaling)


def _figure_features(
    plan: Liu2014Plan, encoded: Encoded, touches: Touches
) -> Iterator[tuple[str, str, int | None, Floats]]:
    yield "Fig. 13", "GE", None, encoded.geometry
    for n in plan.counts:
        yield "Fig. 12", "FD", n, encoded.features("FD", n)
        yield "Fig. 14", "FD+GE", n, encoded.features("FD+GE", n)
    sorted_levels = sorted_taxels(touches.images, normalise=True)
    yield "Figs 12-14", "sorted pixels", None, sorted_levels
    yield "Figs 12-14", "raw pixels", None, _flat(touches)


def _job(
    row: dict[str, Any], features: Floats, codes: Codes, method: Method, scaling: str
) -> Job:
    known = {
        "paper": None,
        "n_classes": len(np.unique(codes)),
        "n_touches": len(codes),
        "features": scaling,
    }
    light = len(method.settings) == 1
    group = f"{row.get('data', '')} {scaling}" if light else ""
    return Job({**known, **row}, features, codes, method, scaling == "z-scored", group)


def _most(plan: Liu2014Plan) -> int:
    return max(plan.n, *plan.counts)


def _codes(touches: Touches) -> Codes:
    codes: Codes = np.unique(labels(touches), return_inverse=True)[1]
    return codes


def _flat(touches: Touches) -> Floats:
    pixels: NDArray[Any] = touches.images.reshape(len(touches), -1)
    return pixels.astype(np.float64)
