"""What is asked of an evaluation, and what one fold of it holds."""

from dataclasses import dataclass, field

from numpy.typing import NDArray

from .._checks import check_count, check_number, check_option
from ..recognition import PRESETS, ObjectRecogniser
from ._episodes import Episodes, Floats
from ._splits import Fold


@dataclass(frozen=True)
class Plan:
    """What is asked of an evaluation.

    Attributes
    ----------
    preset, label : str
        As for `ObjectRecogniser`.
    touches : tuple of int
        Numbers of touches after which figures are given.
    orders : int
        Random orders of each object's touches.
    train_touches : int or None
        Training touches drawn per object; None takes all.
    error : float
        Accepted share of wrong decisions, for the stopping rule.
    floor : float or None
        As for `ObjectRecogniser`.
    seed : int
        Seed of every draw.
    """

    preset: str = "default"
    label: str = "object"
    touches: tuple[int, ...] = (1, 5, 15, 30)
    orders: int = 20
    train_touches: int | None = None
    error: float = 0.01
    floor: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_option("preset", self.preset, PRESETS)
        check_option("label", self.label, ("object", "category"))
        check_number("error", self.error, low=1e-6, high=0.5)
        check_count("orders", self.orders)
        check_count("seed", self.seed, at_least=0)
        for k in self.touches:
            check_count("touches", k)


@dataclass
class Trial:
    """One fold, learnt and tested: what the figures and the report are made of."""

    fold: Fold
    recogniser: ObjectRecogniser
    log_likelihood: NDArray
    singles: Episodes
    episodes: Episodes
    unknown_singles: Episodes | None
    unknown_episodes: Episodes | None
    seconds: dict[str, float]
    controls: dict[str, dict[str, float] | None] = field(default_factory=dict)

    def after(self, k: int, *, unknown: bool = False) -> tuple[list[int], list[Floats]]:
        """Return true columns and log posteriors after `k` touches, per object.

        After one touch every touch counts once; with `unknown`, of the episodes
        of unknown objects.
        """
        return self._episodes(k, unknown=unknown).after(k)

    def unknown_after(self, k: int, *, unknown: bool = False) -> Floats:
        """Return the unknown scores after `k` touches, of all episodes."""
        return self._episodes(k, unknown=unknown).unknown_after(k)

    def _episodes(self, k: int, *, unknown: bool) -> Episodes:
        singles = self.unknown_singles if unknown else self.singles
        episodes = self.unknown_episodes if unknown else self.episodes
        assert singles is not None
        assert episodes is not None
        return singles if k == 1 else episodes
