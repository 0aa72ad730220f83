"""The health of a sensor: at rest, and beside what is remembered of it.

`SensorMemory` is its frame of no contact, how much touches change it, and, for arrays,
how strongly each taxel answers. All of it can be kept in a model file. Of a sensor that
nothing touches, `sensor_health` tells what is wrong, and the figures: limits are
those of `TouchDetector`: what moves rest by less than half of the change at which a
touch begins does no harm. Noise is told from neighbouring frames, so that drift is
none. Crosstalk here is noise that rows or columns share; what a press on one taxel does
to others only a press can tell.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self
from warnings import catch_warnings, filterwarnings

import numpy as np

from .._checks import listed, size_text
from .._types import Array, Floats
from ._contract import Frame, SensorError
from ._detector import ContactError, TouchDetector

# Parts of the frames whose means show drift, frames and seconds of a baseline, taxels
# named of each kind, and pairs of frames for crosstalk.
_PARTS, _REST, _REST_S, _NAMED, _PAIRS = 12, 10, 0.2, 5, 400
# Bad is noise so many times the typical one, this share of noise in common, a frame in
# a hundred so many times as late as usual (told over so many frames), this share of
# frames, or of the readings of a taxel, lost.
_HOT, _SHARED, _LATE, _BURST, _LOST = 6.0, 0.3, 3.0, 8, 0.01
# With more, a sensor is a camera: single taxels are nothing to name.
MOST_TAXELS = 4096
# Rest that is off by more than this share of a touch's change spoils touches.
_BASELINE_TOLERANCE = 0.25
# A taxel is named where its share differs by this factor, and by so many standard
# errors: of 4,096 taxels a normal chance would name one in four checks.
_GAIN_TOLERANCE, _SURE_SD = 2.0, 4.0
_ENOUGH_TOUCHES, _NAMED_AFTER = 10, 3


@dataclass(frozen=True, eq=False)
class SensorMemory:
    """Figures of a sensor, from touches that it made.

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
        response = spread = np.empty((0, 0))
        if shares:
            is_read = ~np.isnan(shares)  # of a taxel not those where its reading failed
            with np.errstate(invalid="ignore"):
                response = np.nansum(shares, axis=0) / is_read.sum(axis=0)
                squares = np.nansum((np.array(shares) - response) ** 2, axis=0)
                spread = squares / is_read.sum(axis=0) ** 2
        return cls(baseline, float(np.median(changes)), response, spread, len(changes))

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Self:
        """Return what `to_dict` gave."""
        names = ("no_contact", "response", "response_var")
        arrays = {name: np.asarray(stored[name], np.float64) for name in names}
        change, n_touches = float(stored["touch_change"]), int(stored["n_touches"])
        return cls(**arrays, touch_change=change, n_touches=n_touches)

    def to_dict(self) -> dict[str, Any]:
        """Return arrays and plain values, for a model file."""
        return dict(vars(self))

    def baseline_warning(self, no_contact: Array) -> str:
        """Return a sentence if rest is off by over a quarter of a touch, or nothing."""
        if self.no_contact.shape != no_contact.shape:
            learnt, present = map(size_text, (self.no_contact.shape, no_contact.shape))
            what = f"The model learnt from a sensor of {learnt}, this one has {present}"
            return f"{what}. Learn again with this sensor."
        off = float(np.sqrt(np.nanmean((no_contact - self.no_contact) ** 2)))
        # NaN where no taxel works.
        if not off > _BASELINE_TOLERANCE * self.touch_change:
            return ""
        share = f"{100 * off / self.touch_change:.0f} %" if self.touch_change else "all"
        return (
            f"At rest the sensor differs from when the model learnt by {share} of what "
            "a touch changes. Check how it is mounted and lit, or learn again."
        )

    def gain_warning(self, images: Iterable[Array], no_contact: Array) -> str:
        """Return a sentence if taxels answer otherwise than they did, else nothing.

        Asks for 10 touches learnt and 10 recent ones, `images`. A taxel is named whose
        share in touches differs by a factor of 2, up or down, and by 4 standard errors.
        """
        if self.n_touches < _ENOUGH_TOUCHES or not self.response.size:
            return ""
        now = self.of(images, no_contact)
        if now.n_touches < _ENOUGH_TOUCHES or self.response.shape != now.response.shape:
            return ""
        before, after = np.nan_to_num(self.response), np.nan_to_num(now.response)
        error = np.sqrt(np.nan_to_num(self.response_var + now.response_var))
        sure = np.abs(after - before) > _SURE_SD * error
        far = (after > _GAIN_TOLERANCE * before) | (after < before / _GAIN_TOLERANCE)
        taxels = np.argwhere(sure & far)
        if not len(taxels):
            return ""
        return (
            "Taxels answer otherwise than when the model learnt: "
            f"{taxels_listed(taxels.tolist(), _NAMED_AFTER)}. "
            "They may be damaged or loose; calibrate, or learn again."
        )


def taxels_listed(places: Sequence[Sequence[int]], most: int) -> str:
    """Return where taxels lie, the first few of them."""
    return listed([f"row {row} column {col}" for row, col in places], most)


@contextmanager
def _where_nothing_works() -> Iterator[None]:
    """Let means over taxels of which none works be NaN without a warning."""
    with catch_warnings():
        filterwarnings("ignore", "Mean of empty slice|All-NaN slice", RuntimeWarning)
        yield


@_where_nothing_works()
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
    is_array = stack.ndim == 3 and stack[0].size <= MOST_TAXELS
    detector = TouchDetector()
    findings: list[str] = []
    is_empty = np.isnan(stack.reshape(len(stack), -1)).all(axis=1)
    if is_empty.any() and (~is_empty).sum() >= 2 * _PARTS:
        findings.append(
            f"{is_empty.sum()} of {len(stack)} frames are NaN alone: readings that "
            "failed. Look at its cable and its driver."
        )
        stack = stack[~is_empty]
    detector.step = max(step, 1.0) if stack.dtype.kind in "iu" else step
    # Over ten periods of the mains, as where touches are taken.
    n_first = sum(frame.time_s < frames[0].time_s + _REST_S for frame in frames)
    try:
        detector.take_baseline(list(stack[: max(_REST, n_first)]))
    except ContactError as error:
        findings.append(str(error))
    except SensorError:  # nothing but NaN: all taxels are named below
        pass
    n_touched = sum(detector.update(frame) is not None for frame in frames)
    rest = np.asarray(np.nanmean(stack, axis=0, dtype=np.float64))
    noise = _noise(stack)
    parts = np.array_split(stack, _PARTS)
    # From the first frame on: a mean of equal numbers may differ from them by rounding.
    first = np.nan_to_num(stack[0].astype(np.float64))
    means = [first + np.nanmean(part - first, axis=0) for part in parts]
    figures = {
        **_times(frames),
        "noise": float(np.nanmedian(noise)),
        "drift": _drift(parts, means, noise),
        "drift_limit": detector.end,
        **_shared(stack[: _PAIRS + 1] if is_array else stack[:0], noise),
    }
    taxels: dict[str, list[list[int]]] = {"dead": [], "hot": [], "saturated": []}
    if is_array:
        taxels = _bad_taxels(stack, rest, noise, detector.step)
    if memory is not None:
        findings += filter(None, [memory.baseline_warning(rest)])
    if n_touched:  # whatever else there is may come of it
        findings.append(
            f"Rest left its baseline {n_touched} times and came back: something "
            "touched it. Leave it alone and check again."
        )
    else:
        findings += _findings(figures, taxels, frames[-1].time_s - frames[0].time_s)
    levels = [float(np.nanmean(mean - means[0])) for mean in means]
    report = {"ok": not findings, "findings": findings, "figures": figures, **taxels}
    return {**report, "levels": levels, "rest": rest, "noise": noise}


def _findings(
    figures: dict[str, Any], taxels: dict[str, list[list[int]]], duration_s: float
) -> list[str]:
    """Return a sentence for all that is beyond its limit."""
    dead, hot, saturated = taxels["dead"], taxels["hot"], taxels["saturated"]
    drift, limit = figures["drift"], figures["drift_limit"]
    by_row, by_col = figures["shared_by_rows"], figures["shared_by_columns"]
    late_ms, usual_ms = figures["interval_99_ms"], 1000 / (figures["rate_hz"] or np.inf)
    signs = [
        (
            saturated,
            f"{_named(saturated)} read the most there is, at rest: saturated.",
        ),
        (
            dead,
            f"{_named(dead)} never change or lack readings: dead, loose or unplugged.",
        ),
        (hot, f"{_named(hot)} are over {_HOT:g} times as noisy as others: hot."),
        (
            drift > limit,
            (
                f"Rest drifted by {drift:.3g} in {duration_s:.0f} s; a touch ends at "
                f"{limit:.3g}. Let it warm up, or take the baseline often."
            ),
        ),
        (
            max(by_row, by_col) > _SHARED,
            (
                f"Rows share {100 * by_row:.0f} % and columns {100 * by_col:.0f} % of "
                "their noise: crosstalk, or an unsteady supply."
            ),
        ),
        (
            late_ms > _LATE * usual_ms,
            (
                f"One frame in 100 comes {late_ms:.0f} ms after the last, usually "
                f"{usual_ms:.0f}: something holds it up."
            ),
        ),
        (
            figures["lost"] > _LOST,
            f"{100 * figures['lost']:.1f} % of the frames are lost.",
        ),
    ]
    return [finding for is_wrong, finding in signs if is_wrong]


def _times(frames: Sequence[Frame]) -> dict[str, Any]:
    times_ms = np.array([frame.time_s for frame in frames]) * 1000
    late_ms = float(np.percentile(np.diff(times_ms), 99))
    # Over several frames: a serial port hands on some at once, then none for a while.
    usual_ms = float(np.median(times_ms[_BURST:] - times_ms[:-_BURST])) / _BURST
    return {
        "frames": len(frames),
        "rate_hz": 1000 / usual_ms if usual_ms else None,
        "interval_99_ms": late_ms,
        "lost": 1 - len(frames) / (frames[-1].number - frames[0].number + 1),
    }


def _noise(stack: Array) -> Floats:
    """Return the noise of each taxel, from neighbouring frames."""
    squares, n_pairs = np.zeros(stack.shape[1:]), np.zeros(stack.shape[1:])
    for before, after in pairwise(image.astype(np.float64) for image in stack):
        change = after - before
        squares += np.nan_to_num(change) ** 2
        n_pairs += ~np.isnan(change)
    return np.asarray(np.sqrt(squares / np.where(n_pairs, n_pairs, np.nan) / 2))


def _drift(parts: list[Array], means: list[Floats], noise: Floats) -> float:
    """Return how far rest moved from the first part to the last, beyond noise."""
    by_chance = float(np.nanmean(noise**2)) * (1 / len(parts[0]) + 1 / len(parts[-1]))
    moved = float(np.nanmean((means[-1] - means[0]) ** 2)) - by_chance
    return float(max(moved, 0.0) ** 0.5)


def _bad_taxels(
    stack: Array, rest: Floats, noise: Floats, step: float
) -> dict[str, list[list[int]]]:
    """Return (row, column) of taxels of an array that are dead, hot or saturated."""
    typical = float(np.nanmedian(noise))
    most = np.iinfo(stack.dtype).max if stack.dtype.kind in "iu" else np.inf
    is_full = np.mean(stack == most, axis=0) > 0.5
    # Where numbers are coarser than the noise, a taxel that stands still may be well.
    is_still = (noise == 0) & (typical >= max(step / 2, 1e-300))
    is_loud = (noise > max(_HOT * typical, step)) & (typical > 0)
    masks = {
        "dead": (np.isnan(stack).mean(axis=0) > _LOST) | (is_still & ~is_full),
        "hot": is_loud,
        "saturated": is_full,
    }
    return {name: np.argwhere(mask).tolist() for name, mask in masks.items()}


def _named(places: list[list[int]]) -> str:
    return f"{len(places)} taxels ({taxels_listed(places, _NAMED)})"


def _shared(stack: Array, noise: Floats) -> dict[str, float]:
    """Return the mean correlation of the noise of taxels in a row, and in a column.

    The variance of a mean of n equal variances is theirs times (1 + (n - 1) rho) / n.
    """
    shares = {"shared_by_rows": 0.0, "shared_by_columns": 0.0}
    if not len(stack):
        return shares
    changes = np.diff(stack.astype(np.float64), axis=0)
    scaled = np.nan_to_num(changes / np.where(noise > 0, noise, np.inf))
    variance = max(float(np.mean(scaled**2)), 1e-300)
    for axis, name in zip((2, 1), shares, strict=True):
        n = scaled.shape[axis]
        ratio = n * float(np.mean(scaled.mean(axis=axis) ** 2)) / variance
        shares[name] = (ratio - 1) / (n - 1) if n > 1 else 0.0
    return shares
