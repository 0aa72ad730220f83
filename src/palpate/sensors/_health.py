"""The health of a sensor that nothing touches: what is wrong, and the figures.

Limits are those of `TouchDetector`: what moves rest by less than half of the change at
which a touch begins does no harm. Noise is told from neighbouring frames, so that drift
is none. Crosstalk here is noise that rows or columns share; what a press on one taxel
does to others only a press can tell.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from .._types import Array, Floats
from . import _detector
from ._contract import Frame, SensorError
from ._detector import MOST_TAXELS, ContactError, SensorMemory

_PARTS, _REST, _NAMED, _PAIRS = 12, 10, 5, 400
_HOT, _SHARED, _LATE, _LOST = 6.0, 0.3, 3.0, 0.01


def sensor_health(
    frames: Sequence[Frame], step: float = 0.0, memory: SensorMemory | None = None
) -> dict[str, Any]:
    """Return what frames of touching nothing say of a sensor; drift asks for minutes.

    `step` is the smallest difference that its numbers can show, where it is known;
    `memory` what a model remembers of it. The result has `ok`; `findings`, sentences;
    `figures` (sensor's unit, Hz, ms or shares); `dead`, `hot` and `saturated` taxels of
    arrays, as [row, column]; `levels`, the mean of each twelfth less the first; `rest`
    and `noise`, maps. `SensorError` says that frames are too few.
    """
    if len(frames) < 2 * _PARTS:
        raise SensorError(
            f"A check needs {2 * _PARTS} frames, got {len(frames)}. Watch for longer."
        )
    stack = np.stack([frame.image for frame in frames])
    whole, array = stack.dtype.kind in "iu", stack.ndim == 3
    array = array and stack[0].size <= MOST_TAXELS
    detector, findings = _detector.TouchDetector(), []
    detector.step = max(step, 1.0) if whole else step
    try:
        detector.take_baseline(list(stack[:_REST]))
    except ContactError as error:
        findings.append(str(error))
    n_touched = sum(detector.update(frame) is not None for frame in frames)
    rest = stack.mean(axis=0, dtype=np.float64)
    squares = np.zeros(rest.shape)
    for before, after in pairwise(image.astype(np.float64) for image in stack):
        squares += (after - before) ** 2
    noise = np.sqrt(squares / (len(stack) - 1) / 2)
    typical = float(np.nanmedian(noise))
    parts = np.array_split(stack, _PARTS)
    means = [part.mean(axis=0, dtype=np.float64) for part in parts]
    by_chance = float(np.nanmean(noise**2)) * (1 / len(parts[0]) + 1 / len(parts[-1]))
    moved = float(np.nanmean((means[-1] - means[0]) ** 2)) - by_chance
    drift, limit = max(moved, 0.0) ** 0.5, detector.end
    most = np.iinfo(stack.dtype).max if whole else np.inf
    at_top = np.mean(stack == most, axis=0)
    # Where numbers are coarser than the noise, a taxel that stands still may be well.
    fine = typical >= max(detector.step / 2, 1e-300)
    full, still = at_top > 0.5, (noise == 0) & fine
    loud = (noise > max(_HOT * typical, detector.step)) & (typical > 0)
    saturated = np.argwhere(full & array).tolist()
    dead = np.argwhere((np.isnan(rest) | (still & ~full)) & array).tolist()
    hot = np.argwhere(loud & array).tolist()
    by_row, by_col = _shared(stack[: _PAIRS + 1], noise) if array else (0.0, 0.0)
    gaps_ms = np.diff([frame.time_s for frame in frames]) * 1000
    usual_ms, late_ms = np.percentile(gaps_ms, (50, 99)).tolist()
    lost = 1 - len(frames) / (frames[-1].number - frames[0].number + 1)
    if memory is not None and memory.no_contact.shape == rest.shape:
        findings += filter(None, [_detector.baseline_warning(memory, rest)])
    n_s = frames[-1].time_s - frames[0].time_s
    signs = {
        f"{_named(saturated)} read the most there is, at rest: saturated.": saturated,
        f"{_named(dead)} never change: dead or unplugged.": dead,
        f"{_named(hot)} are over {_HOT:g} times as noisy as others: hot.": hot,
        f"Rest drifted by {drift:.3g} in {n_s:.0f} s; a touch ends at {limit:.3g}. "
        "Let it warm up, or take the baseline often.": drift > limit,
        f"Rows share {by_row:.0%} and columns {by_col:.0%} of their noise: crosstalk, "
        "or an unsteady supply.": max(by_row, by_col) > _SHARED,
        f"One frame in 100 comes {late_ms:.0f} ms after the last, usually "
        f"{usual_ms:.0f}: something holds it up.": late_ms > _LATE * usual_ms,
        f"{lost:.1%} of the frames are lost.": lost > _LOST,
    }
    if n_touched:  # whatever else there is may come of it
        findings.append(
            f"Rest left its baseline {n_touched} times and came back: something "
            "touched it. Leave it alone and check again."
        )
    else:
        findings += [finding for finding, wrong in signs.items() if wrong]
    figures = {
        "frames": len(frames),
        "rate_hz": 1000 / usual_ms if usual_ms else None,
        "interval_99_ms": late_ms,
        "lost": lost,
        "noise": typical,
        "drift": drift,
        "drift_limit": limit,
        "shared_by_rows": by_row,
        "shared_by_columns": by_col,
    }
    levels = [float(np.nanmean(mean - means[0])) for mean in means]
    taxels = {"dead": dead, "hot": hot, "saturated": saturated}
    report = {"ok": not findings, "findings": findings, "figures": figures, **taxels}
    return {**report, "levels": levels, "rest": rest, "noise": noise}


def _named(places: list[list[int]]) -> str:
    return f"{len(places)} taxels ({_detector.taxels_listed(places, _NAMED)})"


def _shared(stack: Array, noise: Floats) -> tuple[float, float]:
    """Return the mean correlation of the noise of taxels in a row, and in a column.

    The variance of a mean of n equal variances is theirs times (1 + (n - 1) rho) / n.
    """
    changes = np.diff(stack.astype(np.float64), axis=0)
    scaled = np.nan_to_num(changes / np.where(noise > 0, noise, np.inf))
    variance = max(float(np.mean(scaled**2)), 1e-300)
    shares = []
    for axis in (2, 1):
        n = scaled.shape[axis]
        ratio = n * float(np.mean(scaled.mean(axis=axis) ** 2)) / variance
        shares.append((ratio - 1) / (n - 1) if n > 1 else 0.0)
    return shares[0], shares[1]
