"""What the Corradi 2014 study measures, and the paper's figures to set beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from .._study import Plan

# Table 2: (our sensor, TacTip) on the image, then on the derivative.
TABLE_2: dict[str, dict[str, tuple[float, float]]] = {
    "hu": {"image": (5.3, 10.4), "derivative": (5.1, 13.2)},
    "zernike": {"image": (2.0, 2.5), "derivative": (1.9, 3.8)},
    "oriented-pca": {"image": (2.6, 5.9), "derivative": (1.8, 5.4)},
    "zernike-pca": {"image": (1.5, 2.6), "derivative": (1.4, 2.9)},
    "scaled-pixels": {"image": (37.1, 37.9), "derivative": (10.4, 1378.8)},
}
# Fig. 3, the one value that the text gives, in per cent.
BEST = {("zernike-pca", "1-NN", "image"): 96.4}
PAPER_ENCODINGS = tuple(TABLE_2)
VARIANTS = ("image", "derivative")
CLASSIFIERS = ("1-NN", "network", "SVMs", "naive Bayes")

HU = (1, 2, 3, 4, 5, 6, 7)
MOMENTS = (3, 8, 15, 24, 35, 48, 71)
PRINCIPAL = (2, 4, 7, 11, 16, 22, 30, 40)
SQUARES = (4, 9, 25, 49, 100, 169)
COUNTS: dict[str, tuple[int, ...]] = {
    "hu": HU,
    "zernike": MOMENTS,
    "zernike-noll-abs": MOMENTS,
    "oriented-pca": PRINCIPAL,
    "zernike-pca": PRINCIPAL,
    "scaled-pixels": SQUARES,
}


@dataclass(frozen=True)
class Corradi2014Plan(Plan):
    """Sizes of the study; the defaults are the whole of it.

    Half of the `n_touches` of each simulated shape choose with. `runs` are of
    randomised fivefold cross-validation, `slow_runs` those for the network and the
    support vector machines; `choice_runs` choose the number of components for 1-NN,
    `slow_choice_runs` for the others; every `choice_step`-th number is tried. To name
    categories of unseen objects, in at most `fold_limit` folds, every `thinning`-th
    training touch is learnt, fewer by half for the paper's classifiers, and once more
    where something is chosen. Every `recorded_step`-th recorded touch is used; with
    `recorded_upright` shapes are named upright too, not only with test touches turned.
    Inner folds choose among `candidates`; the first is the one to beat.
    """

    n_touches: int = 50
    encodings: tuple[str, ...] = (
        "hu",
        "zernike",
        "zernike-noll-abs",
        "oriented-pca",
        "zernike-pca",
        "scaled-pixels",
    )
    runs: int = 20
    slow_runs: int = 3
    choice_runs: int = 20
    slow_choice_runs: int = 1
    choice_step: int = 1
    thinning: int = 2
    recorded_step: int = 1
    recorded_upright: bool = True
    fold_limit: int = 5
    candidates: tuple[str, ...] = (
        "zernike-pca",
        "zernike",
        "zernike to order 20",
        "zernike to order 30",
        "zernike, image and derivative",
        "polar gradients",
        "polar gradients and zernike to order 30",
    )
    first_look: ClassVar[Mapping[str, Any]] = {
        "n_touches": 20,
        "encodings": PAPER_ENCODINGS,
        "runs": 2,
        "slow_runs": 1,
        "choice_runs": 1,
        "slow_choice_runs": 1,
        "choice_step": 4,
        "thinning": 2,
        "recorded_step": 8,
        "recorded_upright": False,
        "fold_limit": 1,
        "candidates": ("zernike-pca", "zernike", "zernike to order 20"),
    }

    def __post_init__(self) -> None:
        self.check_counts("runs", "slow_runs", "choice_runs", "slow_choice_runs")
        self.check_counts("thinning", "recorded_step", "fold_limit", "choice_step")
        self.check_counts("n_touches", at_least=10)
        self.check_counts("seed", at_least=0)

    def counts(self, encoding: str) -> tuple[int, ...]:
        """Numbers of components to try, always with the largest."""
        known = COUNTS[encoding]
        return tuple(reversed(known[::-1][:: self.choice_step]))
