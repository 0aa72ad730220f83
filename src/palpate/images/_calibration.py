"""Calibrating a pressure array: raw readings of each taxel to pressure in kPa.

The conductance of a piezoresistive taxel grows linearly with pressure, between a
dead zone, below which it does not answer, and saturation. Both ends and the line
are learnt for every taxel from frames under known uniform loads, as of a pressure
chamber; a taxel that does not follow its load is dead, and reads NaN.
"""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_images, check_number, check_option, one_each
from .._durable import write_text
from .._image_estimator import ImageEstimator
from .._types import Array, Floats, Indices

_FORMAT, _VERSION = "palpate taxel calibration", 1
_NUMBERS = ("gain", "offset", "noise", "dead_zone_kpa", "saturation_kpa")
KPA_PER_UNIT = {"kPa": 1.0, "psi": 6.894757293168361, "Pa": 1e-3, "bar": 100.0}
# More loads than this (a slow ramp) are summarised in groups of neighbours.
_MOST_LOADS = 25
# A flat end must leave the line by this many standard deviations of the noise.
_CLEARLY = 4.0
# The median absolute deviation of a normal variable, as a share of its sd.
_MAD_PER_SD = 0.6744897501960817


class TaxelCalibration(ImageEstimator):
    """Per-taxel gain, offset, dead zone and saturation, from uniform loads.

    Parameters
    ----------
    load_unit : {"kPa", "psi", "Pa", "bar"}, default="kPa"
        Unit of the loads given to `fit`. Everything learnt or returned is in kPa.
    quantity : {"conductance", "resistance"}, default="conductance"
        What raw readings are proportional to. Resistances are inverted first.
    least_gain : float, default=0.1
        Taxels whose gain is below this share of the median gain are dead.

    Attributes
    ----------
    gain_, offset_ : ndarray of shape (n_rows, n_cols)
        Conductance = offset + gain x pressure, gain per kPa; NaN for dead taxels.
    noise_ : ndarray of shape (n_rows, n_cols)
        Robust standard deviation of the conductance about the line.
    dead_zone_kpa_ : ndarray of shape (n_rows, n_cols)
        Pressure below which the taxel does not answer, 0 where it always does.
    saturation_kpa_ : ndarray of shape (n_rows, n_cols)
        Pressure above which it answers no more, infinite where none was seen.
    dead_ : ndarray of bool of shape (n_rows, n_cols)
        Taxels that did not follow their load.
    highest_load_kpa_ : float
        Largest load; pressures above it are extrapolated.
    image_shape_ : tuple of int

    Notes
    -----
    Readings are summarised by their median at each load, lines are Theil-Sen lines,
    and plateaus count only where they leave the line by more than the noise, so that
    a few bad frames do no harm. A calibration needs three different loads, and six
    or more to find dead zone and saturation.

    References
    ----------
    .. [1] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014, Fig. 3.
       doi:10.1155/2014/497275

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import TaxelCalibration
    >>> loads = np.array([10.0, 200.0, 400.0, 580.0])
    >>> frames = 0.5 + 0.01 * loads[:, None, None] * np.ones((4, 2, 2))
    >>> calibration = TaxelCalibration(load_unit="psi").fit(frames, loads)
    >>> calibration.transform(frames[1:2]).round(1)
    array([[[1379., 1379.],
            [1379., 1379.]]])
    """

    def __init__(
        self,
        load_unit: str = "kPa",
        *,
        quantity: str = "conductance",
        least_gain: float = 0.1,
    ) -> None:
        self.load_unit = load_unit
        self.quantity = quantity
        self.least_gain = least_gain

    def fit(self, X: ArrayLike, y: Any = None) -> Self:
        """Learn every taxel's line from frames `X` under uniform loads `y`.

        Parameters
        ----------
        X : array-like of shape (n_frames, n_rows, n_cols)
            Raw readings; NaN where a taxel gave none.
        y : array-like of shape (n_frames,)
            The load on the whole array in each frame, in `load_unit`.

        Raises
        ------
        ValueError
            For fewer than three different loads, loads that are negative or do not
            match the frames, or an array in which no taxel follows the load.
        """
        conductance = self._conductance(self._checked(X))
        loads = self._check_loads(y, len(conductance))
        least_gain = check_number("least_gain", self.least_gain, low=0, high=1)
        n_frames, n_rows, n_cols = conductance.shape
        learnt = fit_taxels(conductance.reshape(n_frames, -1), loads, least_gain)
        if learnt["dead"].all():
            raise ValueError(
                "X must hold taxels whose readings rise with the load, got none among "
                f"{n_rows * n_cols}. Check the loads' order, and quantity="
                f"{self.quantity!r}."
            )
        self.image_shape_ = (n_rows, n_cols)
        for name, values in learnt.items():
            setattr(self, f"{name}_", values.reshape(self.image_shape_))
        self.highest_load_kpa_ = float(loads.max())
        return self

    def transform_checked(self, images: Array) -> Floats:
        """Return pressure in kPa, (n_touches, n_rows, n_cols); NaN for dead taxels.

        Readings in the dead zone give 0, saturated ones the pressure at which the
        taxel saturates; `out_of_range` tells which they are.
        """
        pressure = self._on_the_line(images)
        capped = np.minimum(pressure, self.saturation_kpa_)
        in_dead_zone = pressure < self.dead_zone_kpa_
        return np.where(in_dead_zone, 0.0, np.maximum(capped, 0.0))

    def out_of_range(self, X: ArrayLike) -> NDArray[np.int8]:
        """Say of each reading whether its pressure is known.

        Returns
        -------
        flags : ndarray of int8 of shape (n_touches, n_rows, n_cols)
            -1 in the dead zone; 1 saturated, or above the highest load of the
            calibration; 0 between (and for dead taxels).
        """
        pressure = self._on_the_line(self._images(X))
        highest = np.minimum(self.saturation_kpa_, self.highest_load_kpa_)
        # The highest load itself is within range, whatever rounding says.
        above = pressure > highest * (1 + 1e-9)
        flags: NDArray[np.int8] = above.astype(np.int8)
        flags -= pressure < self.dead_zone_kpa_
        return flags

    def save(self, path: str | Path) -> None:
        """Write the calibration to a JSON file."""
        check_is_fitted(self)
        content: dict[str, Any] = {"format": _FORMAT, "version": _VERSION}
        content["params"] = self.get_params()
        for name in _NUMBERS:
            value = getattr(self, f"{name}_")
            finite: Any = np.where(np.isfinite(value), value, None)
            content[name] = finite.tolist()
        content |= {"dead": self.dead_.tolist(), "image_shape": self.image_shape_}
        content["highest_load_kpa"] = self.highest_load_kpa_
        text = json.dumps(content, indent=1, allow_nan=False)
        write_text(Path(path), text + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a calibration that `save` wrote.

        Raises
        ------
        ValueError
            When the file is no calibration, or of another version, or damaged.
        """
        params, learnt = _read_calibration(path)
        calibration = cls()
        calibration.set_params(**params)
        for name, value in learnt.items():
            setattr(calibration, f"{name}_", value)
        return calibration

    def _checked(self, X: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
        return check_images(X, shape=shape, allow_nan=True)

    def _on_the_line(self, frames: Array) -> Floats:
        line = (self._conductance(frames) - self.offset_) / self.gain_
        return np.where(self.dead_, np.nan, line)

    def _conductance(self, frames: Floats) -> Floats:
        check_option("quantity", self.quantity, ("conductance", "resistance"))
        if self.quantity == "conductance":
            return frames
        if (frames <= 0).any():
            raise ValueError(
                f"Resistances must be positive, got {np.nanmin(frames)}. Write an "
                'unread taxel as NaN, or pass quantity="conductance".'
            )
        return 1 / frames

    def _check_loads(self, y: ArrayLike, n_frames: int) -> Floats:
        check_option("load_unit", self.load_unit, KPA_PER_UNIT)
        loads = one_each("y", np.asarray(y, dtype=np.float64), n_frames, "frames")
        if not (np.isfinite(loads).all() and (loads >= 0).all()):
            raise ValueError(
                "y must be finite loads of at least 0, got values from "
                f"{loads.min()} to {loads.max()}."
            )
        if len(np.unique(loads)) < 3:
            raise ValueError(
                "y must hold at least three different loads, got "
                f"{len(np.unique(loads))}. Record more loads."
            )
        return loads * KPA_PER_UNIT[self.load_unit]

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        tags.target_tags.required = True
        return tags


def _read_calibration(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    content = _read(Path(path))
    try:
        params = dict(content["params"])
        learnt: dict[str, Any] = {n: np.array(content[n], float) for n in _NUMBERS}
        learnt["dead"] = np.array(content["dead"])
        learnt["image_shape"] = tuple(int(side) for side in content["image_shape"])
        learnt["highest_load_kpa"] = float(content["highest_load_kpa"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _bad(path, f"{error!r} while reading it") from error
    dead = learnt["dead"]
    for name in (*_NUMBERS, "dead"):
        if learnt[name].shape != learnt["image_shape"]:
            raise _bad(path, f"{name} is not of shape {learnt['image_shape']}")
    if dead.dtype != bool:
        raise _bad(path, "dead must be true or false")
    # Infinity, "no saturation was seen", is written as null too.
    missing = np.isnan(learnt["saturation_kpa"]) & ~dead
    learnt["saturation_kpa"][missing] = np.inf
    for name in _NUMBERS:
        values = learnt[name][~dead]
        if name == "saturation_kpa":
            values = values[values != np.inf]
        if not np.isfinite(values).all():
            raise _bad(path, f"{name} lacks values of taxels that are not dead")
    if not (learnt["gain"][~dead] > 0).all():
        raise _bad(path, "gain must be positive for taxels that are not dead")
    return params, learnt


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise type(error)(
            f"path must name a calibration that save() wrote, got {path}: "
            f"{error.strerror}. Check the path, or calibrate the array."
        ) from error
    except (ValueError, RecursionError) as error:
        raise _bad(path, "it is not JSON") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _bad(path, f'its "format" is not "{_FORMAT}"')
    if content.get("version") != _VERSION:
        raise _bad(
            path, f"its version is {content.get('version')!r}, known is {_VERSION}"
        )
    return content


def _bad(path: str | Path, reason: str) -> ValueError:
    return ValueError(
        f"path must be a calibration that save() wrote, got {path}: {reason}. "
        "Calibrate the array again."
    )


def fit_taxels(readings: Floats, loads: Floats, least_gain: float) -> dict[str, Floats]:
    """Fit every taxel to loads in kPa, and tell which are dead: arrays by name.

    Readings are conductances (n_frames, n_taxels), NaN where there is none; a taxel is
    dead below the share `least_gain` of the median gain.
    """
    # Distinct loads, rising, and which of them each frame belongs to.
    steps, group = np.unique(loads, return_inverse=True)
    if len(steps) > _MOST_LOADS:
        group = (np.arange(len(steps)) * _MOST_LOADS // len(steps))[group]
        steps = np.array([np.median(loads[group == i]) for i in range(_MOST_LOADS)])
    silent = np.isnan(readings).mean(axis=0) > 0.5
    counts = np.where(silent, 0.0, readings)
    levels = np.stack([_median(counts[group == i]) for i in range(len(steps))])
    silent |= np.isnan(levels).any(axis=0)
    levels = np.where(silent, 0.0, levels)
    first, last, gain, offset = _best_segment(steps, levels)
    linear = (group[:, None] >= first) & (group[:, None] <= last)
    residual = np.where(linear, counts - offset - gain * loads[:, None], np.nan)
    noise = _median(np.abs(residual)) / _MAD_PER_SD
    learnt = {"gain": gain, "offset": offset, "noise": noise}
    learnt |= _ends(steps, levels, first, last, gain, offset, noise)
    span = steps[last] - steps[first]
    alive = gain[~silent & (gain > 0)]
    typical = np.median(alive) if len(alive) else np.inf
    dead = silent | (gain <= 0) | (gain < least_gain * typical)
    dead |= gain * span < 5 * noise
    learnt = {name: np.where(dead, np.nan, value) for name, value in learnt.items()}
    return learnt | {"dead": dead}


def _median(values: Floats) -> Floats:
    """Median down the columns without NaN; NaN for a column that has nothing else."""
    nothing = np.isnan(values).all(axis=0)
    median: Floats = np.nanmedian(np.where(nothing, 0.0, values), axis=0)
    return np.where(nothing, np.nan, median)


def _best_segment(
    loads: Floats, levels: Floats
) -> tuple[Indices, Indices, Floats, Floats]:
    """First and last load of each taxel's linear part, and its line."""
    n_loads, n_taxels = levels.shape
    pairs = np.array(list(combinations(range(n_loads), 2)))
    low, high = pairs.T
    slopes = (levels[high] - levels[low]) / (loads[high] - loads[low])[:, None]
    best = np.full(n_taxels, np.inf)
    first, last = np.zeros((2, n_taxels), dtype=np.intp)
    gain, offset = np.zeros((2, n_taxels))
    scale = np.ptp(levels, axis=0) * 1e-9 + np.finfo(float).tiny
    for i in range(n_loads - 2):
        for j in range(i + 2, n_loads):
            slope = np.median(slopes[(low >= i) & (high <= j)], axis=0)
            rest = levels[i : j + 1] - slope * loads[i : j + 1, None]
            start = np.median(rest, axis=0)
            # Mean size of the residuals of a line with flat ends before i and after j.
            fitted = start + slope * loads[:, None]
            if i > 0:
                fitted[:i] = np.median(levels[:i], axis=0)
            if j < len(loads) - 1:
                fitted[j + 1 :] = np.median(levels[j + 1 :], axis=0)
            error = np.abs(levels - fitted).mean(axis=0)
            n_ends = (i > 0) + (j < n_loads - 1)
            # Bayesian information criterion of Laplace noise; flat ends cost double.
            cost = 2 * n_loads * np.log(error + scale) + 2 * n_ends * np.log(n_loads)
            better = cost < best
            for kept, new in ((best, cost), (gain, slope), (offset, start)):
                kept[better] = new[better]
            first[better], last[better] = i, j
    return first, last, gain, offset


def _ends(loads: Floats, levels: Floats, *lines: Array) -> dict[str, Floats]:
    """Dead zone and saturation: where the flat ends meet the line."""
    n_loads, n_taxels = levels.shape
    dead_zone, saturation = np.zeros(n_taxels), np.full(n_taxels, np.inf)
    for taxel, (i, j, slope, start, sd) in enumerate(zip(*lines, strict=True)):
        if slope <= 0:
            continue
        line = start + slope * loads
        if i > 0:
            rest = np.median(levels[:i, taxel])
            if np.abs(line[:i] - rest).max() > _CLEARLY * sd:
                meet = (rest + 3 * sd - start) / slope
                dead_zone[taxel] = max(meet, loads[i - 1])
        if j < n_loads - 1:
            top = np.median(levels[j + 1 :, taxel])
            if line[-1] - top > _CLEARLY * sd:
                meet = (top - 3 * sd - start) / slope
                saturation[taxel] = min(meet, loads[j + 1])
    return {"dead_zone_kpa": dead_zone, "saturation_kpa": saturation}
