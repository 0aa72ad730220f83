"""Beginning and end of touches in a stream of frames.

A frame is compared with the frame of no contact (the baseline). Its change is the root
mean square of the difference over the taxels that work and their colours, in the
sensor's unit. A touch begins where the change rises above one limit and ends where it
falls below a lower one, so that a change near a limit does not make many touches of
one. Rubber and gels creep: some of a press stays, and decays over seconds. So a touch
also ends below a tenth of its peak, and what is then left counts as rest.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import islice, pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from .._checks import ARRAY_SIDE, check_count, check_option, check_positive, size_text
from .._types import Array, Floats
from ..touches import Touches
from ._contract import PLACE_COLUMNS, Frame, SensorError, as_kind, channels_of

SUMMARIES = ("peak", "mean")
# Limits in units of the noise, and never below so many of the numbers' steps.
_BEGIN_NOISES, _LEAST_STEPS = 6.0, 2.0
_END_SHARE = 0.5
# Of a touch's peak so much may be left for a while, from where the next must rise by
# so much of it and so many times `begin`: what is left is no smooth decay.
_LEFT_SHARE, _LEFT_RISE = 0.1, 2.0
_HOLD_SHARE = 0.8
_LONGEST_HOLD = 64
_LARGEST_SIDE = 160
_IDLE_S, _STUCK_S = 2.0, 20.0
_STEADY_NOISES = 3.0
# An array is pressed where neighbours read so many spreads and steps above the others.
_PRESS_SPREADS, _PRESS_STEPS, _PRESS_TAXELS = 8.0, 8.0, 4
_LEAST_NOISES, _N_LIMITS = 3.0, 60
_MAX_PIXELS = 50_000_000  # of a film
_LEAST_REST = 3  # frames of a baseline
_REST_FRAMES = 10  # of a film, taken for touching nothing
_ROW = "row"  # of a frame among those read as touches
_LEAST_READINGS = 5  # of a device whose driver gives them again
_NOISE_STEPS = 8  # from frame to frame at rest, that tell the noise


class ContactError(ValueError):
    """A baseline that was asked for while something touches the sensor."""


@dataclass(frozen=True, eq=False)
class DetectedTouch:
    """One touch, found in a stream of frames.

    `image` (n_rows, n_cols) stands for it: the frame of greatest change, or the mean
    over the hold. It lasted from `began_s` to `ended_s` on the clock of the frames,
    `n_frames` in all; `change` is its greatest, in the sensor's unit. `device_time_s`
    and `columns` are those of the frame of greatest change, see `Reading`.
    """

    image: Array
    began_s: float
    ended_s: float
    change: float
    n_frames: int
    device_time_s: float | None = None
    columns: Mapping[str, float] = field(default_factory=dict)

    @property
    def touch_columns(self) -> dict[str, Any]:
        """What the device told beside the image, as columns of touches."""
        columns: dict[str, Any] = dict(self.columns)
        for name, parts in PLACE_COLUMNS.items():
            if columns.keys() >= {*parts}:
                columns[name] = tuple(columns.pop(part) for part in parts)
        if self.device_time_s is not None:
            columns["device_time_s"] = self.device_time_s
        return columns


class TouchDetector:
    """Finds touches in frames that come one after the other.

    Parameters
    ----------
    no_contact : ndarray of shape (n_rows, n_cols), optional
        The baseline, where the sensor knows it; else call `take_baseline`. The noise
        is then learnt from the first frames at rest.
    summary : {"peak", "mean"}, default="peak"
        What stands for a touch: the frame of greatest change, or the mean of the
        frames that change by at least 0.8 of the greatest (of the last 64).
    begin, end : float, optional
        Limits of the change (sensor's unit). By default a touch begins at 6 times
        the noise of the frames that the baseline was taken from (at 2 steps at
        least), and ends at half of that, or already at a tenth of its peak; the
        next must then rise by twice `begin`, and by a tenth, above what is left. An
        `end` that is given holds as it is, and is at most `begin`.
    min_frames : int, default=2
        Contact that lasts fewer frames is no touch.

    Attributes
    ----------
    baseline : ndarray of shape (n_rows, n_cols) or None
        The frame of no contact; without one nothing is detected.
    touching : bool
        Whether something touches the sensor now.
    change : float
        Change of the last frame.
    noise : float
        How far a frame at rest is from the baseline (sensor's unit), by chance.
    step : float
        The smallest difference that the sensor's numbers can show, where it is known
        (see `LiveSensor`); 1 for integers, else 0. May be set at any time.
    note : str
        After `touches_in`, which `begin` would have found more touches, or nothing.
    """

    _peak_frame: Frame | None
    _idle_since_s: float
    _left: float

    def __init__(
        self,
        no_contact: Array | None = None,
        *,
        summary: str = "peak",
        begin: float | None = None,
        end: float | None = None,
        min_frames: int = 2,
    ) -> None:
        self.summary = check_option("summary", summary, SUMMARIES)
        self._begin = None if begin is None else check_positive("begin", begin)
        self._end = None if end is None else check_positive("end", end)
        if begin is not None and end is not None and end > begin:
            raise ValueError(
                f"end must be at most begin ({begin:g}), got {end:g}. A touch ends "
                "where the change falls below it."
            )
        self._min_frames = check_count("min_frames", min_frames)
        self.noise = self.step = 0.0
        self.note = ""
        self._recent: deque[tuple[float, Array]] = deque(maxlen=_LONGEST_HOLD)
        self._before: tuple[Array | None, float] = no_contact, 0.0
        self.touching = False
        self._set_baseline(no_contact)

    @property
    def begin(self) -> float:
        """The change at which a touch begins (sensor's unit)."""
        if self._begin is not None:
            return self._begin
        return max(_BEGIN_NOISES * self.noise, self._least(self.baseline))

    @property
    def end(self) -> float:
        """The change at which a touch ends (sensor's unit)."""
        begin = self.begin
        return _END_SHARE * begin if self._end is None else min(self._end, begin)

    def take_baseline(self, frames: Sequence[Array], *, force: bool = False) -> None:
        """Take the frame of no contact: the mean of frames of touching nothing.

        Parameters
        ----------
        frames : sequence of ndarray of shape (n_rows, n_cols)
            At least 3, from now; 10 or more tell the noise well.
        force : bool, default=False
            Take it although something seems to touch: for a sensor that has
            changed so much that rest looks like contact.

        Raises
        ------
        ContactError
            Something touches the sensor, or the frames are not steady; of the first
            baseline of an array, neighbouring taxels read far above all others.
        SensorError
            Fewer than 3 frames hold a number; frames of NaN alone, as of a reading
            that failed, are left out.
        """
        check_count("the number of frames", len(frames), at_least=_LEAST_REST)
        if isinstance(frames[0], Frame):
            raise TypeError(
                "frames must be arrays, as `read` of a sensor returns, got Frame. Pass "
                "the image of each."
            )
        if self.touching and not force:
            raise ContactError(
                "Something touches the sensor. Lift it and take the baseline again; "
                "if nothing touches it, take it anyway (force)."
            )
        stack = np.stack(frames).astype(np.float64)
        stack = stack[~np.isnan(stack.reshape(len(stack), -1)).all(axis=1)]
        if len(stack) < _LEAST_REST:
            raise SensorError(
                f"A baseline must be of {_LEAST_REST} frames with numbers or more, got "
                f"{len(stack)} among {len(frames)}: the others are NaN alone. Look at "
                "the sensor and its cable."
            )
        readings = _readings(stack)
        # One reading again and again: its means may differ from it by rounding.
        alike = len(readings) == 1
        if not force and not alike and _moving(readings, self._least(frames[0])):
            raise ContactError(
                "The frames were still changing, so something may touch the sensor. "
                "Leave it alone for a second and take the baseline again."
            )
        mean = stack[0] if alike else _mean_of_numbers(stack)
        levels = [_rms(frame - mean) for frame in stack]
        noise = float(np.median(levels))
        first = self.baseline is None and not force
        if first and (where := _pressed(mean, max(self._least(frames[0]), noise))):
            raise ContactError(
                f"Something may press the sensor {where}. Lift it and take the "
                "baseline again; if nothing touches it, take it anyway (force)."
            )
        self._before = self.baseline, self.noise
        # That tells no noise: it is learnt from the next ones.
        self.noise = 0.0 if alike else noise
        self._set_baseline(as_kind(mean, np.asarray(frames[0]).dtype))

    def undo_baseline(self) -> None:
        """Go back to the baseline before the last one that was taken, if any."""
        baseline, self.noise = self._before
        self._set_baseline(baseline)

    def update(self, frame: Frame) -> DetectedTouch | None:
        """Take in the next frame; return the touch that ended with it, if any.

        `SensorError` says that the frame is of another size than the baseline.
        """
        if not isinstance(frame, Frame):
            raise TypeError(
                "frame must be a Frame, as `read_next` of a sensor returns, got "
                f"{type(frame).__name__}. A LiveSensor makes frames of arrays."
            )
        if self.baseline is None:
            return None
        if frame.image.shape != self.baseline.shape:
            at_rest, now = map(size_text, (self.baseline.shape, frame.image.shape))
            raise SensorError(
                f"Frames must be of {at_rest} like the frame of no contact, got {now}. "
                "Give one of this sensor, or take the baseline again."
            )
        small = _small(frame.image)
        if np.isnan(small).all():  # a reading that failed, neither rest nor contact
            return None
        self.change = _rms(small - self._small_baseline)
        now_s = frame.time_s
        share = _LEFT_SHARE if self._knows_rest and self._end is None else 0.0
        if not self.touching:
            if self._left and self.change < self.end:  # nothing is left any more
                self._left, self._idle_since_s = 0.0, float("inf")
            self._left = min(self._left, self.change)
            if not _begins(self.change, self._left, self.begin):
                if not self._left:
                    self._rested = True
                    self._learn_noise(frame.image)
                # How far rest is from the baseline, over about half a second.
                if self._idle_since_s > now_s:
                    self._idle_since_s, self._idle_change = now_s, self.change
                self._idle_change += 0.1 * (self.change - self._idle_change)
                return None
            self.touching, self._began_s, self._peak = True, now_s, -1.0
            self._n_frames = 0
            self._recent.clear()
            self._calm_since_s, self._calm_change = now_s, self.change
        elif _ends(self.change, self._left, self._peak, self.end, share):
            self._left = self.change if self.change >= self.end else 0.0
            return self._ended(now_s)
        self._n_frames += 1
        if self.change > self._peak:
            self._peak, self._peak_frame = self.change, frame
        if self.summary == "mean":
            self._recent.append((self.change, frame.image))
        if abs(self.change - self._calm_change) > max(3 * self.noise, self.end):
            self._calm_since_s, self._calm_change = frame.time_s, self.change
        if self._is_rest_after_all(frame.image):
            ended = self._ended(now_s)
            return ended if self._peak > self.begin else None
        return None

    def touches_in(
        self,
        source: Touches | str | PathLike[str],
        *,
        colour: bool = False,
    ) -> Touches:
        """Return the touches in a film, or in frames that were read as touches.

        Parameters
        ----------
        source : path or Touches
            A film that OpenCV decodes, or all frames of a stream, `time_s` if known.
        colour : bool, default=False
            Read a film in red, green and blue.

        If there is no baseline yet, the first ten frames are taken for one.

        Returns
        -------
        Touches
            With `time_s` (the beginning), `duration_s` and the baseline as
            `no_contact`; of frames with what describes them, and the labels of the
            frame of greatest change. A touch that outlasts the stream is one too.

        Raises
        ------
        ContactError
            Something touches, or moves, in the frames of the baseline.
        SensorError
            The film cannot be read to its end, is of another size than the baseline,
            or holds no touch.
        """
        recorded = source if isinstance(source, Touches) else None
        place = Path(str(source))
        frames = _film(place, colour) if recorded is None else _frames_of(recorded)
        if self.baseline is None and recorded is not None:
            self._set_baseline(recorded.no_contact)
        if self.baseline is None:
            first = [frame.image for frame in islice(frames, _REST_FRAMES)]
            try:
                self.take_baseline(first)
            except ContactError as error:
                raise ContactError(
                    f"The first {len(first)} frames must touch nothing, but something "
                    "moves or presses in them. Cut away what is before a rest, or give "
                    "`no_contact`."
                ) from error
        ended: list[DetectedTouch | None] = []
        changes: list[float] = []
        last: Frame | None = None
        for last in frames:
            ended.append(self.update(last))
            changes.append(self.change)
        if last is not None and self.touching:
            ended.append(self._ended(last.time_s))
        touches = [touch for touch in ended if touch is not None]
        self.note = self._better_limit(np.array(changes), len(touches))
        if not touches:
            raise SensorError(
                f"The stream must hold a touch, got {len(changes)} frames without one: "
                f"none changed by {self.begin:.3g} for {self._min_frames} frames. Give "
                f"its frame of no contact, or lower `begin`. {self.note}".strip()
            )
        columns: dict[str, Any] = {}
        whole: dict[str, Any] = {"channels": channels_of(touches[0].image.shape)}
        if recorded is not None:
            rows = [int(touch.columns[_ROW]) for touch in touches]
            columns = {name: column[rows] for name, column in recorded.columns.items()}
            whole = {**recorded.whole}
        columns["time_s"] = np.array([touch.began_s for touch in touches])
        columns["duration_s"] = np.array([t.ended_s - t.began_s for t in touches])
        columns["order"] = np.arange(len(touches))
        whole["no_contact"] = self.baseline
        return Touches(np.stack([touch.image for touch in touches]), **columns, **whole)

    def baseline_offer(self, now_s: float) -> str:
        """Return why the baseline should be taken again, or nothing.

        Parameters
        ----------
        now_s : float
            On the clock of the frames.
        """
        if self.baseline is None:
            return "No baseline yet: leave the sensor alone and take it."
        if self.touching:
            if now_s - self._calm_since_s > _STUCK_S:
                return (
                    "The same contact for over 20 s: if nothing touches the sensor, "
                    "insist on a new baseline."
                )
        elif self._idle_change > self.end and (
            # What is left of a touch may decay.
            now_s - self._idle_since_s > (_STUCK_S if self._left else _IDLE_S)
        ):
            return "The sensor at rest no longer reads its baseline: take it again."
        return ""

    def _better_limit(self, changes: Floats, n_touches: int) -> str:
        """Return which `begin` finds more touches in a stream, or nothing.

        Of the limits that find most it is the middle of the longest run of neighbours,
        and noise is no touch: limits reach down to three noises and to one step.
        """
        least = max(_LEAST_NOISES * self.noise, 0.5 * self._least(self.baseline))
        most = float(changes.max(initial=0.0))
        if most <= least:
            return ""
        limits = np.geomspace(least, most, _N_LIMITS)
        frames = self._min_frames
        counts = [_n_touches(changes, x, frames) for x in limits]
        if max(counts) <= n_touches:
            return ""
        best = np.flatnonzero(np.array(counts) == max(counts))
        runs = np.split(best, np.flatnonzero(np.diff(best) > 1) + 1)
        run = max(runs, key=len)
        rises, n_rises = ndimage.label(changes > least)
        peaks = ndimage.maximum(changes, rises, np.arange(1, n_rises + 1))
        lasted = np.bincount(rises)[1:] >= frames
        below = np.count_nonzero(lasted & (np.asarray(peaks) <= self.begin))
        return (
            f"{n_touches} touches begin at a change of {self.begin:.3g}, "
            f"{max(counts)} would at {limits[run[len(run) // 2]]:.3g} "
            f"({limits[run[0]]:.3g} to {limits[run[-1]]:.3g}); {below} changes lay "
            "below the limit."
        )

    def _set_baseline(self, baseline: Array | None) -> None:
        self.baseline = None if baseline is None else np.array(baseline)
        self._small_baseline = np.empty(0) if baseline is None else _small(baseline)
        self.touching, self.change = False, 0.0
        self._n_frames, self._peak, self._began_s = 0, -1.0, 0.0
        self._left = 0.0  # of touches that ended: the lowest change since
        self._peak_frame = None
        self._recent.clear()
        self._idle_since_s, self._idle_change = float("inf"), 0.0
        self._calm_since_s, self._calm_change = 0.0, 0.0
        self._still: Floats | None = None
        self._steps: list[float] = []
        self._rested = False
        self._changes: list[float] = []

    def _learn_noise(self, image: Array) -> None:
        """Learn the noise from frames at rest, of a baseline that came without it.

        Two frames differ by chance by the square root of two times their noise.
        """
        if self.noise or len(self._steps) >= _NOISE_STEPS:
            return
        still = _small(image)
        if self._still is not None:
            # A driver that is asked too often gives a reading again: no noise in it.
            if np.array_equal(self._still, still, equal_nan=True):
                return
            self._steps.append(_rms(still - self._still) / np.sqrt(2))
        self._still = still
        if len(self._steps) == _NOISE_STEPS:
            self.noise = float(np.median(self._steps))

    def _is_rest_after_all(self, image: Array) -> bool:
        """Tell whether the latest frames are noise of rest, which is then learnt.

        Of a baseline that came without its noise, noise beyond the steps of the
        sensor's numbers would be a touch that never ends.
        """
        if self._knows_rest:
            return False
        self._changes.append(self.change)
        self._learn_noise(image)
        if len(self._steps) < _NOISE_STEPS:
            return False
        self._rested = max(self._changes) <= self.begin
        if not self._rested:
            self.noise, self._steps, self._changes = 0.0, [], []
        return self._rested

    @property
    def _knows_rest(self) -> bool:
        """Whether rest is told from noise."""
        return self._rested or self.noise > 0 or self._begin is not None

    def _least(self, image: Array | None) -> float:
        whole = image is not None and image.dtype.kind in "iu"
        step = max(self.step, 1.0) if whole else self.step
        return max(_LEAST_STEPS * step, float(np.finfo(np.float32).tiny))

    def _ended(self, now_s: float) -> DetectedTouch | None:
        self.touching = False
        self._idle_since_s, self._idle_change = now_s, self.change
        frame, recent = self._peak_frame, list(self._recent)
        self._peak_frame = None
        self._recent.clear()
        if self._n_frames < self._min_frames or frame is None:
            return None
        image = frame.image
        if self.summary == "mean":
            held = [i for change, i in recent if change >= _HOLD_SHARE * self._peak]
            stack = np.stack(held or [image])
            mean = np.mean(stack, axis=0, dtype=np.float64)
            image = as_kind(np.asarray(mean), image.dtype)
        lasted = self._began_s, now_s, self._peak, self._n_frames
        return DetectedTouch(image, *lasted, frame.device_time_s, frame.columns)


def _begins(change: float, left: float, begin: float) -> bool:
    """Tell whether a touch begins where `left` is left of those before."""
    rise = max(_LEFT_RISE * begin, _LEFT_SHARE * left) if left else begin
    return change > left + rise


def _ends(change: float, left: float, peak: float, end: float, share: float) -> bool:
    """Tell whether a touch of this peak, which began above `left`, ends."""
    return change < left + max(end, share * (peak - left))


def _n_touches(changes: Floats, begin: float, least: int) -> int:
    """Return how many touches of `least` frames begin at `begin`, as in a detector."""
    end = _END_SHARE * begin
    count = length = 0
    left = peak = 0.0
    for change in [*changes.tolist(), 0.0]:
        if not length:
            left = min(left, change) if change >= end else 0.0
            length, peak = int(_begins(change, left, begin)), change
        elif _ends(change, left, peak, end, _LEFT_SHARE):
            count += length >= least
            length, left = 0, change if change >= end else 0.0
        else:
            length, peak = length + 1, max(peak, change)
    return count


def _film(place: Path, colour: bool) -> Iterator[Frame]:
    """Yield the frames of a film one by one, in grey or in red, green and blue."""
    import cv2

    capture = cv2.VideoCapture(str(place) if place.is_file() else "")
    try:
        n_cols, n_rows, rate_hz, counted = map(capture.get, (3, 4, 5, 7))
        opened = 0 < n_cols * n_rows <= _MAX_PIXELS and capture.grab()
        if not opened and place.is_file() and find_spec("av"):
            yield from _av_film(place, colour)
            return
        if not opened:
            raise SensorError(
                f"{place} must be a film that OpenCV decodes, got "
                f"{'another file' if place.is_file() else 'no file there'}. Convert it "
                "(AV1 needs av: pip install av), for example to FFV1 in .mkv, which "
                "keeps levels."
            )
        to = cv2.COLOR_BGR2RGB if colour else cv2.COLOR_BGR2GRAY
        number, more = 0, True
        while more and (arrived := capture.retrieve())[0]:
            picture = cv2.cvtColor(arrived[1], to)
            yield Frame(picture, number / (rate_hz or 25.0), number)
            number, more = number + 1, capture.grab()
        if number < counted - 2:  # some kinds of file only estimate their count
            raise SensorError(
                f"{place} must hold {counted:.0f} frames, got {number}: it ends early. "
                "Copy or record it again."
            )
    finally:
        capture.release()


def _av_film(place: Path, colour: bool) -> Iterator[Frame]:
    """Yield the frames of a film that OpenCV does not decode, such as AV1."""
    import av
    import cv2

    try:
        with av.open(str(place)) as film:
            stream = film.streams.video[0]
            if stream.width * stream.height > _MAX_PIXELS:
                raise ValueError(f"{stream.width} x {stream.height} pixels")
            number = 0
            for number, picture in enumerate(film.decode(stream), 1):
                levels: Array = picture.to_ndarray(format="rgb24")
                if not colour:
                    levels = np.asarray(cv2.cvtColor(levels, cv2.COLOR_RGB2GRAY))
                yield Frame(levels, float(picture.time or 0.0), number - 1)
            if number < stream.frames - 2:
                raise ValueError(f"{number} of {stream.frames} frames")
    except (av.FFmpegError, IndexError, ValueError) as error:
        raise SensorError(
            f"{place} must be a film that OpenCV or FFmpeg decodes to its end, got: "
            f"{error}. Copy or record it again."
        ) from error


def _frames_of(touches: Touches) -> Iterator[Frame]:
    times = touches.columns.get("time_s", range(len(touches)))
    for number, (image, time_s) in enumerate(zip(touches.images, times, strict=True)):
        yield Frame(image, float(time_s), number, columns={_ROW: number})


def _readings(frames: Floats) -> Floats:
    """Return what a device measured, of a driver that gives all of it several times.

    Those are frames that differ from the one before. Where any but the first and the
    last, which may be cut, comes once, or few are different, these are all frames.
    """
    same = (np.array_equal(a, b, equal_nan=True) for a, b in pairwise(frames))
    first = np.flatnonzero([True, *(not again for again in same)])
    few = 1 < len(first) < _LEAST_READINGS
    return frames if few or (np.diff(first)[1:] == 1).any() else frames[first]


def _moving(stack: Floats, least: float) -> bool:
    """Tell whether readings go somewhere, by more than their noise."""
    # Second differences show noise (of noise alone their variance is six times that of
    # a frame), so that a steady way down is no noise.
    bends = stack[2:] - 2 * stack[1:-1] + stack[:-2]
    noise = float(np.median([_rms(bend) for bend in bends])) / np.sqrt(6)
    first, second = np.array_split(stack, 2)
    moved = _rms(second.mean(axis=0) - first.mean(axis=0))
    return bool(moved > max(_STEADY_NOISES * noise, least))


def _mean_of_numbers(stack: Floats) -> Floats:
    """Return the mean frame, of each taxel over its numbers; NaN where it has none."""
    with np.errstate(invalid="ignore"):
        mean: Floats = np.nansum(stack, axis=0) / np.sum(~np.isnan(stack), axis=0)
    return mean


def _pressed(image: Floats, least: float) -> str:
    """Return where neighbouring taxels of an array stand out, or nothing.

    Offsets of single taxels do not, nor does a slope over the array.
    """
    if image.ndim == 3 or max(image.shape) > ARRAY_SIDE or np.isnan(image).all():
        return ""
    low, rest = np.nanpercentile(image, (5, 25))  # of noise these are a spread apart
    above = np.nan_to_num(image - rest)
    limit = max(_PRESS_SPREADS * (rest - low), _PRESS_STEPS / _LEAST_STEPS * least)
    parts, _ = ndimage.label(above > limit)
    n_taxels = np.bincount(parts.ravel())[1:]
    if not n_taxels.size or n_taxels.max() < _PRESS_TAXELS:
        return ""
    row, col = ndimage.center_of_mass(parts == n_taxels.argmax() + 1)
    return (
        f"around row {row:.0f} column {col:.0f}, where {n_taxels.max()} neighbouring "
        "taxels read far above the others"
    )


def _small(image: Array) -> Floats:
    """Return an image at most some 160 taxels a side: every second, third, ... one."""
    step = max(1, -(-max(image.shape) // _LARGEST_SIDE))
    return image[::step, ::step].astype(np.float64)


def _rms(difference: Floats) -> float:
    """Root mean square over taxels that are not NaN; 0 where all are."""
    alive = difference[~np.isnan(difference)]
    return float(np.sqrt(np.mean(np.square(alive)))) if alive.size else 0.0
