"""What is kept of one attempt to touch, whatever came of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .._checks import check_option
from ..simulation import SensorPose
from ..touches import Touches

OUTCOMES = (
    "touched",
    "nothing",
    "force not reached",
    "force sensor",
    "limit exceeded",
    "timed out",
    "no frame",
    "robot error",
)
_NUMBERS = ("force_n", "peak_force_n", "travel_mm", "duration_s")


@dataclass(frozen=True, eq=False)
class TouchRecord:
    """One attempt to touch.

    Attributes
    ----------
    outcome : str
        "touched": the force was reached and a frame taken. "nothing": nothing was
        met on the whole way. Any other of `OUTCOMES` is a fault, said in `message`;
        "force not reached" where the line ended in too light a contact.
    start : SensorPose
        Where the approach began.
    position_mm : tuple of float
        Where the tip was at the end of the approach, before it was pulled back.
    force_n : float
        Force there, offset removed; of the last readings that were taken.
    peak_force_n : float
        Magnitude of the greatest single reading of the approach, offset removed.
    travel_mm : float
        Length of the approach.
    duration_s : float
        From the start of the approach until the arm was back.
    image : ndarray of shape (n_rows, n_cols) or None
        The frame, where one was taken.
    message : str
        What went wrong, else empty.
    retracted : bool
        Whether the arm is known to be back.
    """

    outcome: str
    start: SensorPose
    position_mm: tuple[float, float, float]
    force_n: float = 0.0
    peak_force_n: float = 0.0
    travel_mm: float = 0.0
    duration_s: float = 0.0
    image: NDArray[Any] | None = None
    message: str = ""
    retracted: bool = True

    @property
    def touched(self) -> bool:
        """Whether there is a frame of a touch."""
        return self.outcome == "touched"

    @property
    def faulty(self) -> bool:
        """Whether something went wrong, beyond finding nothing."""
        return self.outcome not in ("touched", "nothing")

    @property
    def direction(self) -> NDArray[np.float64]:
        """Way in which the sensor was pushed, of length 1, (3,)."""
        return np.asarray(self.start.direction)

    def as_plain(self) -> dict[str, Any]:
        """Return everything but the image as plain values for JSON."""
        plain: dict[str, Any] = {name: getattr(self, name) for name in _NUMBERS}
        return {
            "outcome": self.outcome,
            "start_mm": np.asarray(self.start.position_mm).tolist(),
            "direction": self.direction.tolist(),
            "roll_rad": self.start.roll_rad,
            "position_mm": list(self.position_mm),
            **plain,
            "message": self.message,
            "retracted": self.retracted,
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any], image: NDArray[Any] | None) -> Self:
        """Rebuild a record from `as_plain` and its image."""
        start = SensorPose(plain["start_mm"], plain["direction"], plain["roll_rad"])
        return cls(
            outcome=check_option("outcome", plain["outcome"], OUTCOMES),
            start=start,
            position_mm=tip_mm(SensorPose(plain["position_mm"], plain["direction"])),
            image=image,
            message=str(plain["message"]),
            retracted=bool(plain["retracted"]),
            **{name: float(plain[name]) for name in _NUMBERS},
        )


def tip_mm(pose: SensorPose) -> tuple[float, float, float]:
    """Return the place of a pose as plain numbers."""
    x, y, z = np.asarray(pose.position_mm)
    return float(x), float(y), float(z)


def as_touches(
    history: Sequence[TouchRecord],
    *,
    object: str | None = None,
    category: str | None = None,
    geometry: str | None = None,
    no_contact: NDArray[Any] | None = None,
) -> Touches:
    """Return the records that are touches, ready to be learnt or recognised.

    Columns: `position_mm` and `direction`, both (n_touches, 3), `force_n`, `order`
    (number of the attempt), and the labels given.

    Raises
    ------
    ValueError
        None of the records is a touch.
    """
    felt = [(order, record) for order, record in enumerate(history) if record.touched]
    if not felt:
        raise ValueError(
            f"history must hold a touch, got {len(history)} attempts without one. "
            "Look at their outcomes and messages."
        )
    labels = {"object": object, "category": category}
    return Touches(
        np.stack([np.asarray(record.image) for _, record in felt]),
        position_mm=[record.position_mm for _, record in felt],
        direction=np.stack([record.direction for _, record in felt]),
        force_n=[record.force_n for _, record in felt],
        order=[order for order, _ in felt],
        geometry=geometry,
        no_contact=no_contact,
        **{name: [word] * len(felt) for name, word in labels.items() if word},
    )
