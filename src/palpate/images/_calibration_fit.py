"""Robust fit of a line with flat ends to the readings of many taxels at once."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .._types import Array, Floats

# More loads than this (a slow ramp) are summarised in groups of neighbours.
_MOST_LOADS = 25
# A flat end must leave the line by this many standard deviations of the noise.
_CLEARLY = 4.0
# The median absolute deviation of a normal variable, as a share of its sd.
_MAD_PER_SD = 0.6744897501960817


def fit_taxels(readings: Floats, loads: Floats, least_gain: float) -> dict[str, Floats]:
    """Fit every taxel to loads in kPa, and tell which are dead: arrays by name.

    Readings are conductances (n_frames, n_taxels), NaN where there is none; a taxel is
    dead below the share `least_gain` of the median gain.
    """
    steps, group = _group_loads(loads)
    silent = np.isnan(readings).mean(axis=0) > 0.5
    known = np.where(silent, 0.0, readings)
    levels = np.stack([_median(known[group == i]) for i in range(len(steps))])
    silent |= np.isnan(levels).any(axis=0)
    levels = np.where(silent, 0.0, levels)
    first, last, gain, offset = _best_segment(steps, levels)
    linear = (group[:, None] >= first) & (group[:, None] <= last)
    residual = np.where(linear, known - offset - gain * loads[:, None], np.nan)
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


def _group_loads(loads: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Distinct loads, rising, and which of them each frame belongs to."""
    distinct, which = np.unique(loads, return_inverse=True)
    if len(distinct) <= _MOST_LOADS:
        return distinct, which
    group_of = np.arange(len(distinct)) * _MOST_LOADS // len(distinct)
    group = group_of[which]
    return np.array([np.median(loads[group == i]) for i in range(_MOST_LOADS)]), group


def _best_segment(
    loads: Floats, levels: Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
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
            error = _mean_error(loads, levels, i, j, slope, start)
            n_ends = (i > 0) + (j < n_loads - 1)
            # Bayesian information criterion of Laplace noise; flat ends cost double.
            cost = 2 * n_loads * np.log(error + scale) + 2 * n_ends * np.log(n_loads)
            better = cost < best
            for kept, new in ((best, cost), (gain, slope), (offset, start)):
                kept[better] = new[better]
            first[better], last[better] = i, j
    return first, last, gain, offset


def _mean_error(
    loads: Floats, levels: Floats, i: int, j: int, slope: Floats, start: Floats
) -> Floats:
    """Mean size of the residuals of a line with flat ends before i and after j."""
    fitted = start + slope * loads[:, None]
    if i > 0:
        fitted[:i] = np.median(levels[:i], axis=0)
    if j < len(loads) - 1:
        fitted[j + 1 :] = np.median(levels[j + 1 :], axis=0)
    error: Floats = np.abs(levels - fitted).mean(axis=0)
    return error


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
