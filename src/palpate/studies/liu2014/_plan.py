"""What the Liu 2014 study measures, and the paper's figures to set beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ..._checks import check_number, check_option
from .._study import Plan

PROTOCOLS = ("both", "nested", "paper")
SCALINGS = ("z-scored", "raw")
PAPER_N = 40
PAPER_PARTITIONS = 2
PAPER_LOAD_KGF = 4.0
PAPER_COVER_MM = 0.9

# Part numbers of Table 1 in each class set of Figs 12 to 14.
CLASS_SETS: dict[str, tuple[int, ...]] = {
    "3 vs 7 vs 12": (3, 7, 12),
    "all hollow": (3, 5, 7, 9, 11),
    "all solid": (4, 6, 8, 10, 12),
    "all": tuple(range(1, 13)),
}
# Table 2, in per cent.
TABLE_2: dict[str, float] = {
    "FD+GE k-NN": 68.69,
    "FD+GE SVM": 76.17,
    "KPCA+SVM": 82.13,
    "KPCA+MKL-SVM": 85.54,
}
# Figs 12 to 14 as far as the text gives their values: (features, class set), n = 40.
FIGURES: dict[tuple[str, str], float] = {
    ("FD", "all"): 43.0,
    ("GE", "all"): 63.3,
    ("FD+GE", "all"): 68.69,
    ("FD", "all solid"): 60.8,
    ("GE", "all solid"): 74.45,
    ("FD+GE", "all solid"): 84.3,
}


@dataclass(frozen=True)
class Liu2014Plan(Plan):
    """Sizes and grids of the study; the defaults are the whole of it.

    `parts` are numbers of the paper's Table 1, each pressed `n_presses` times, in
    `runs` of twofold cross-validation; `n` is the number of descriptors in Table 2,
    `counts` those of Figs 12 to 14. Of the n x n `partitions` thresholded each by
    itself, 2 is the paper's best, the only one with all rows. `loads_kgf` are at the
    paper's cover, `covers_mm` at its load. `inner_folds` choose `widths` of kernel PCA
    and of the SVM (median distances of the training touches), numbers of `components`,
    and C: `mkl_costs` are larger, as its kernels have trace 1. `presses` are further
    numbers for `simulate_presses`, such as `{"tilt_sd_deg": 0.2}`. `protocol`:
    parameters chosen "nested" in the training half, on the runs reported as the "paper"
    did, or "both".
    """

    parts: tuple[int, ...] = CLASS_SETS["all"]
    n_presses: int = 20
    runs: int = 10
    counts: tuple[int, ...] = (5, 10, 15, 20, 25, 30, 35, 40)
    n: int = PAPER_N
    partitions: tuple[int, ...] = (2, 1, 3)
    loads_kgf: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0)
    covers_mm: tuple[float, ...] = (0.3, 0.6, 0.9, 1.5, 2.0, 3.0)
    inner_folds: int = 3
    widths: tuple[float, ...] = (1.0, 2.0, 4.0)
    components: tuple[int, ...] = (10, 20, 40)
    svm_widths: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    svm_costs: tuple[float, ...] = (1.0, 10.0, 100.0)
    mkl_costs: tuple[float, ...] = (1e2, 1e3)
    presses: Mapping[str, Any] = field(default_factory=dict)
    protocol: str = "both"
    first_look: ClassVar[Mapping[str, Any]] = {
        "runs": 2,
        "counts": (5, 20, 40),
        "partitions": (2,),
        "loads_kgf": (1.0, 4.0),
        "covers_mm": (0.3, 0.9, 3.0),
        "inner_folds": 2,
        "widths": (2.0,),
        "components": (20, 40),
        "svm_widths": (1.0, 2.0),
        "svm_costs": (10.0, 100.0),
        "mkl_costs": (1e3,),
    }

    def __post_init__(self) -> None:
        check_option("protocol", self.protocol, PROTOCOLS)
        self.check_counts("runs", "n")
        self.check_counts("inner_folds", at_least=2)
        self.check_counts("n_presses", at_least=2 * self.inner_folds)
        self.check_counts("seed", at_least=0)
        for number in self.parts:
            check_number("parts", number, low=1, high=12)
        if len(self.parts) < 2:
            raise ValueError(f"parts must be two or more, got {self.parts}.")

    @property
    def equal_costs(self) -> Sequence[float]:
        """As many C of the MKL-SVM as the SVM has settings, small ones first.

        From 0.1, where kernels of variance 1 fit loosely, to 30,000, where those of
        trace 1 have long fitted every training touch.
        """
        n_settings = len(self.svm_widths) * len(self.svm_costs)
        costs: Sequence[float] = np.logspace(4.5, -1, n_settings)[::-1].tolist()
        return costs

    @property
    def protocols(self) -> tuple[str, ...]:
        """The protocols to report, the honest one first."""
        return ("nested", "paper") if self.protocol == "both" else (self.protocol,)

    @property
    def class_sets(self) -> dict[str, tuple[int, ...]]:
        """Class sets of which at least two parts are pressed."""
        held = {
            name: tuple(number for number in numbers if number in self.parts)
            for name, numbers in CLASS_SETS.items()
        }
        return {name: some for name, some in held.items() if len(some) > 1}
