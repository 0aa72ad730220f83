"""What the Corradi 2015 study measures, and the figures to set beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from .._study import Plan

N_KNOWN = 10
# Share right in per cent after so many touches, as the text of the paper gives it.
PAPER: dict[int, float] = {15: 87.0, 30: 95.0}
PAPER_CLUSTERS: dict[int, float] = {30: 70.0}
# Milliseconds: Zernike moments of an image; learning; a touch tested.
PAPER_MS: dict[tuple[str, int], float] = {
    ("encode", 0): 3.7,
    ("learn", 600): 1.7e-5,
    ("learn", 1200): 1.7e-5,
    ("recognise", 600): 0.86,
    ("recognise", 1200): 1.2,
}
# The first author's later figures on all 60 objects of the released touches.
LATER_OBJECTS: dict[int, float] = {1: 18.8, 5: 38.8, 10: 51.2, 15: 62.5, 20: 68.2}
LATER_CATEGORY: dict[int, float] = {20: 62.1}
LATER_TRAIN = 54
# The same by touch, by one photograph (after 0 touches) and by both.
LATER_SIGHT: dict[tuple[str, str], dict[int, float]] = {
    ("object", "touch"): LATER_OBJECTS,
    ("object", "sight"): {0: 39.7},
    ("object", "both"): {1: 45.2, 5: 59.5, 10: 69.8, 15: 79.3, 20: 84.0},
    ("category", "touch"): LATER_CATEGORY,
    ("category", "sight"): {0: 68.9},
    ("category", "both"): {20: 78.6},
}


@dataclass(frozen=True)
class Corradi2015Plan(Plan):
    """Sizes of the study; the defaults are the whole of it.

    Of the random `partitions`, `default` and the controls answer `default_partitions`;
    `later_partitions` are of all objects. `n_train` and `n_test` touches of each object
    are learnt and recognised, `few_train` learnt where there are fewer than both.
    Figures are given after each number of `touches`, timings for learning `timed` ones.
    Objects never learnt are touched in `orders`. `clusters` are chosen from inside the
    training touches; `components` are those of each object's mixture. `later` is
    whether all objects and categories are recognised too, with a photograph, and across
    a move of the camera.
    """

    partitions: int = 100
    default_partitions: int = 10
    later_partitions: int = 5
    n_train: int = 60
    n_test: int = 30
    few_train: int = 45
    touches: tuple[int, ...] = (1, 3, 5, 10, 15, 20, 30)
    n_simulated: int = 90
    orders: int = 20
    clusters: tuple[int, ...] = (10, 20, 40, 80)
    components: tuple[int, ...] = (1, 2, 4)
    timed: tuple[int, ...] = (600, 1200)
    later: bool = True
    first_look: ClassVar[Mapping[str, Any]] = {
        "partitions": 5,
        "default_partitions": 1,
        "later_partitions": 1,
        "few_train": 30,
        "n_simulated": 60,
        "orders": 5,
        "clusters": (40,),
        "components": (1, 2),
        "timed": (600,),
        "later": False,
    }

    def __post_init__(self) -> None:
        self.check_counts("partitions", "later_partitions", "n_test", "orders")
        self.check_counts("default_partitions", "seed", at_least=0)
        self.check_counts("n_train", "few_train", at_least=6)
        self.check_counts("n_simulated", at_least=self.least)
        self.check_counts("touches", "clusters", "components", "timed")

    @property
    def least(self) -> int:
        """Fewest touches an object may have."""
        return self.few_train + self.n_test
