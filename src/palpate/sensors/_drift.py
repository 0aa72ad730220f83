"""Whether a sensor still is what it was when its touches were learnt.

What is remembered of a sensor: its frame of no contact, how much its touches change
it, and, for arrays, how strongly each taxel answers. All of it can be kept in a
model file.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from .._types import Array, Floats

MOST_TAXELS = 4096
_ENOUGH_TOUCHES = 10
_BASELINE_TOLERANCE, _GAIN_TOLERANCE, _SURE_SD = 0.25, 2.0, 4.0
_NAMED = 3


@dataclass(frozen=True, eq=False)
class SensorMemory:
    """What touches tell of the sensor that made them.

    `no_contact` (n_rows, n_cols) is its baseline, `touch_change` the median over
    touches of their root mean square difference from it. `response` is the mean over
    touches of the share that each taxel has in a touch's change, over channels,
    `response_var` the variance of that mean, both (n_rows, n_cols), or (0, 0) for
    sensors of over 4096 taxels.
    """

    no_contact: Floats
    touch_change: float
    response: Floats
    response_var: Floats
    n_touches: int

    @classmethod
    def of(cls, images: Iterable[Array], no_contact: Array) -> Self:
        """Remember the sensor that made these touches, each (n_rows, n_cols)."""
        baseline = np.asarray(no_contact, dtype=np.float64)
        changes, shares = [], []
        for image in images:
            size = np.abs(image - baseline)
            changes.append(float(np.sqrt(np.nanmean(size**2))))
            size = size.reshape(*size.shape[:2], -1).mean(axis=2)
            shares.append(size / max(float(np.nansum(size)), np.finfo(float).tiny))
            if baseline.size > MOST_TAXELS:
                shares.clear()
        response = np.mean(shares, axis=0) if shares else np.empty((0, 0))
        spread = np.var(shares, axis=0) / len(shares) if shares else np.empty((0, 0))
        return cls(baseline, float(np.median(changes)), response, spread, len(changes))

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Self:
        """Return what `to_dict` gave."""
        return cls(
            np.asarray(stored["no_contact"], dtype=np.float64),
            float(stored["touch_change"]),
            np.asarray(stored["response"], dtype=np.float64),
            np.asarray(stored["response_var"], dtype=np.float64),
            int(stored["n_touches"]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return arrays and plain values, for a model file."""
        return dict(vars(self))


def baseline_warning(memory: SensorMemory, no_contact: Array) -> str:
    """Return a sentence if rest is off by over a quarter of a touch, else nothing."""
    if memory.no_contact.shape != no_contact.shape:
        both = (memory.no_contact.shape, no_contact.shape)
        known, found = (" x ".join(map(str, shape)) for shape in both)
        return (
            f"The model learnt from a sensor of {known} taxels, this one has {found}. "
            "Learn again with this sensor."
        )
    off = float(np.sqrt(np.nanmean((no_contact - memory.no_contact) ** 2)))
    if off <= _BASELINE_TOLERANCE * memory.touch_change:
        return ""
    share = f"{off / memory.touch_change:.0%}" if memory.touch_change else "all"
    return (
        f"At rest the sensor differs from when the model learnt by {share} of what a "
        "touch changes. Check how it is mounted and lit, or learn again."
    )


def gain_warning(memory: SensorMemory, now: SensorMemory) -> str:
    """Return a sentence if taxels answer otherwise than they did, else nothing.

    Asks for 10 touches learnt and 10 recent ones. A taxel is named whose share in
    touches differs by a factor of 2, up or down, and by 4 standard errors.
    """
    if min(memory.n_touches, now.n_touches) < _ENOUGH_TOUCHES:
        return ""
    if not memory.response.size or memory.response.shape != now.response.shape:
        return ""
    before, after = np.nan_to_num(memory.response), np.nan_to_num(now.response)
    error = np.sqrt(np.nan_to_num(memory.response_var + now.response_var))
    sure = np.abs(after - before) > _SURE_SD * error
    far = (after > _GAIN_TOLERANCE * before) | (after < before / _GAIN_TOLERANCE)
    taxels = np.argwhere(sure & far)
    if not len(taxels):
        return ""
    named = ", ".join(f"row {row} column {col}" for row, col in taxels[:_NAMED])
    more = f" and {len(taxels) - _NAMED} more" if len(taxels) > _NAMED else ""
    return (
        f"Taxels answer otherwise than when the model learnt: {named}{more}. "
        "They may be damaged or loose; calibrate, or learn again."
    )
