"""Episodes: choose a place, touch it, keep what happened, and know when to stop."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import check_count, size_text
from ..sensors import TouchSensor
from ..simulation import SensorPose
from ._guarded import Clock, Guard, Toucher, check_parts
from ._place_belief import PlaceBelief
from ._record import EpisodeError, EpisodeLog, History, TouchRecord, as_touches
from ._robot import Robot, RobotError
from ._strategies import Hemisphere, Strategy
from ._surface_map import SurfaceMap
from ._ways import ON_THE_WAY, come_out, touch_from_hemisphere

if TYPE_CHECKING:
    from ..recognition import Belief, ObjectRecogniser
    from ._touch_map import TouchMap


MAX_FAULTS = 3
# What of an attempt stands beside the belief after it.
_KEPT = ("outcome", "message", "position_mm", "direction", "force_n", "retracted")


@dataclass(frozen=True, eq=False)
class Exploration:
    """An episode that has come to an end.

    Attributes
    ----------
    decision : str or None
        The object, "unknown", or None.
    ended_by : {"decision", "unknown", "budget", "faults"}
        Why it ended. After "faults" someone must look at the robot.
    reason : str
        One sentence.
    belief : Belief, PlacedBelief or PlaceBelief
        What the touches say; the last is of a `SurfaceMap`.
    history : list of TouchRecord
        All attempts.
    """

    decision: str | None
    ended_by: str
    reason: str
    belief: Belief
    history: list[TouchRecord]

    @property
    def n_touches(self) -> int:
        """Number of attempts that were touches."""
        return _n_touched(self.history)

    def to_dict(
        self,
        recogniser: ObjectRecogniser | TouchMap | SurfaceMap,
        hemisphere: Hemisphere,
    ) -> dict[str, Any]:
        """Return plain values, with the belief after every attempt.

        That is worked out once more, with what the episode was made with.
        """
        belief = _begun(recogniser, hemisphere, self.belief.strangers)
        attempts: list[dict[str, Any]] = []
        for record in self.history:
            _taken_in(belief, record)
            plain = record.to_dict()
            attempts.append(
                {
                    **{name: plain[name] for name in _KEPT},
                    "flag": belief.flags[-1] if record.touched else None,
                    "posterior": belief.posterior,
                    "unknown": belief.unknown,
                }
            )
        touched = [n for n, record in enumerate(self.history) if record.touched]
        return {
            "decision": self.decision,
            "ended_by": self.ended_by,
            "reasons": [self.reason],
            "explanation": [
                {**moved, "attempt": touched[moved["touch"] - 1]}
                for moved in belief.explain()
            ],
            "touches_used": self.n_touches,
            "n_attempts": len(self.history),
            "pose": asdict(belief.pose()) if isinstance(belief, PlaceBelief) else None,
            "attempts": attempts,
        }


def explore(
    robot: Robot,
    sensor: TouchSensor,
    recogniser: ObjectRecogniser | TouchMap | SurfaceMap,
    strategy: Strategy,
    folder: str | Path | None = None,
    *,
    guard: Guard | None = None,
    max_attempts: int = 30,
    error: float = 0.01,
    refusal: float | None = None,
    strangers: float | None = None,
    max_faults: int = MAX_FAULTS,
    clock: Clock = time.monotonic,
    on_attempt: Callable[[TouchRecord, Belief], None] | None = None,
) -> Exploration:
    """Touch an object until it is recognised.

    Parameters
    ----------
    robot, sensor : Robot, TouchSensor
        The arm, and the tactile sensor that it carries.
    recogniser : ObjectRecogniser, TouchMap or SurfaceMap
        Knows the objects; made for this sensor. A `TouchMap` also uses from where
        each touch was made, a `SurfaceMap` also where it met something, or nothing.
    strategy : Strategy
        Where to touch.
    folder : path, optional
        Where to keep the attempts. A folder in which an episode was begun with the
        same strategy goes on, whatever ended it; a frame in it that `recogniser`
        cannot take counts as "no frame".
    guard : Guard, optional
        How far and how hard each touch may go.
    max_attempts : int, default=30
        Budget, touches and attempts that found nothing or failed alike.
    error : float, default=0.01
        Accepted share of wrong names, see `Belief.decide`.
    refusal : float, optional
        As for `Belief.decide`; `error` unless given.
    strangers : float, optional
        The share of episodes with something never learnt, see
        `ObjectRecogniser.start`; its default unless given.
    max_faults : int, default=3
        Give up after so many faults in a row.
    clock : callable, default=time.monotonic
        Seconds, for time-outs.
    on_attempt : callable, optional
        Called with each new attempt and the belief after it.

    Returns
    -------
    Exploration
        The arm is back on the hemisphere, unless the last record says otherwise.

    Raises
    ------
    EpisodeError
        `folder` holds another episode, or is damaged.
    RobotError
        The arm stands inside the hemisphere and cannot be brought out of it: it does
        not look at the object, its way out does not lead outward, or it did not move.
    TypeError, ValueError
        Something is no arm, sensor, strategy or guard, or `strategy` chose what is no
        pose on its hemisphere, and the arm was not moved.
    """
    check_count("max_attempts", max_attempts)
    check_count("max_faults", max_faults)
    toucher = Toucher(robot, sensor, guard or Guard(), clock)
    check_parts("recogniser", recogniser, "start")
    check_parts("strategy", strategy, "hemisphere", "next_pose")
    hemisphere = strategy.hemisphere
    accepted: dict[str, Any] = {"error": error, "refusal": refusal}
    belief = _begun(recogniser, hemisphere, strangers)
    belief.decide(**accepted)  # what it refuses begins no folder
    with EpisodeLog(folder, _settings(strategy)) as log:
        n_before = len(log.history)
        log.history = [_taken_in(belief, record) for record in log.history]

        def ended(gave_up: str) -> tuple[str | None, str, str] | None:
            """Return decision, what ended the episode and why, or None to go on."""
            decision = belief.decide(**accepted)
            if decision is not None:
                ended_by = "unknown" if decision == "unknown" else "decision"
                return decision, ended_by, belief.reason(**accepted)
            if gave_up:
                return None, "faults", gave_up
            if len(log.history) >= max_attempts:
                why = belief.reason(**accepted)
                return None, "budget", f"{len(log.history)} attempts made. {why}"
            return None

        end = ended("")
        if end is None:
            come_out(robot, hemisphere, toucher.guard)
        while end is None:
            pose = strategy.next_pose(belief, log.history)
            record = touch_from_hemisphere(toucher, hemisphere, pose)
            try:
                record = _taken_in(belief, record)
            finally:  # It is recorded even if the program is interrupted.
                log.append(record)
            if on_attempt is not None:
                on_attempt(record, belief)
            attempts = log.history[n_before:]
            end = ended(_gave_up(attempts, max_faults, hemisphere))
        return Exploration(*end, belief, list(log.history))


def gather(
    robot: Robot,
    sensor: TouchSensor,
    strategy: Strategy,
    folder: str | Path | None = None,
    *,
    n_touches: int = 60,
    guard: Guard | None = None,
    max_faults: int = MAX_FAULTS,
    clock: Clock = time.monotonic,
) -> list[TouchRecord]:
    """Touch an object `n_touches` times, to learn it: as `explore`, without a belief.

    A folder that was begun goes on; of one that holds more, the attempts up to that
    touch are returned. Raises `EpisodeError` as `explore` does or where its touches are
    of another size, `RobotError` after `max_faults` faults in a row or where five
    attempts for each touch wanted were not enough; what was recorded stays.
    """
    check_count("n_touches", n_touches)
    check_count("max_faults", max_faults)
    toucher = Toucher(robot, sensor, guard or Guard(), clock)
    check_parts("strategy", strategy, "hemisphere", "next_pose")
    touch = partial(touch_from_hemisphere, toucher, strategy.hemisphere)
    with EpisodeLog(folder, _settings(strategy)) as log:
        _refuse_other_size(log, sensor)
        if _n_touched(log.history) < n_touches:
            come_out(robot, strategy.hemisphere, toucher.guard)
        return gather_by(touch, strategy, log, n_touches, max_faults)


def gather_by(
    touch: Callable[[SensorPose], TouchRecord],
    strategy: Strategy,
    log: EpisodeLog,
    n_touches: int,
    max_faults: int = MAX_FAULTS,
) -> list[TouchRecord]:
    """Touch so often, as `gather` does, with what touches from a pose."""
    n_before, n_wanted = len(log.history), n_touches - _n_touched(log.history)
    while _n_touched(log.history) < n_touches:
        log.append(touch(strategy.next_pose(None, log.history)))
        attempts = log.history[n_before:]
        n_made = _n_touched(attempts)
        gave_up = _gave_up(attempts, max_faults, strategy.hemisphere)
        if gave_up or (len(attempts) >= 5 * n_wanted and n_made < n_wanted):
            why = "Is the object where the hemisphere has its centre?"
            raise RobotError(
                f"Only {n_made} of {n_wanted} touches came of "
                f"{len(attempts)} attempts. {gave_up or why}"
            )
    counts = np.cumsum([record.touched for record in log.history])
    return log.history[: int(np.searchsorted(counts, n_touches)) + 1]


def _settings(strategy: Strategy) -> dict[str, str]:
    """Return what the folder of an episode is begun with, the same in every run."""
    return {"strategy": re.sub(r" at 0x[0-9a-fA-F]+", "", repr(strategy))}


def _begun(
    recogniser: ObjectRecogniser | TouchMap | SurfaceMap,
    hemisphere: Hemisphere,
    strangers: float | None,
) -> Belief:
    """Return the belief before the first touch of an episode."""
    start: Callable[..., Belief] = recogniser.start
    if isinstance(recogniser, SurfaceMap):
        start = partial(recogniser.start_before, hemisphere)
    return start() if strangers is None else start(strangers=strangers)


def _take_in(belief: Belief, record: TouchRecord) -> None:
    if isinstance(belief, PlaceBelief):
        belief.update_from_record(record)
    elif record.touched:
        belief.update(as_touches([record]))


def _taken_in(belief: Belief, record: TouchRecord) -> TouchRecord:
    """Update the belief; a touch that it cannot take comes back as a fault."""
    try:
        _take_in(belief, record)
    except Exception as error:
        why = f"The recogniser cannot take this frame: {type(error).__name__}: {error}"
        message = record.message
        if why not in message:  # as it was read again
            message = f"{message} {why}".strip()
        refused = replace(record, outcome="no frame", message=message)
        if record.touched:
            # Its contact counts, as it does when the episode goes on another day.
            with suppress(Exception):
                _take_in(belief, refused)
        return refused
    return record


def _gave_up(attempts: History, max_faults: int, hemisphere: Hemisphere) -> str:
    """Return why to touch no more, or nothing while it is safe to go on."""
    if not attempts:
        return ""
    last = attempts[-1]
    if not last.retracted:
        return f"The arm would not retract: {last.message}"
    recent = attempts[-max_faults:]
    if len(recent) < max_faults or not all(record.faulty for record in recent):
        return ""
    if all(record.message.startswith(ON_THE_WAY) for record in recent):
        centre = ", ".join(f"{v:.0f}" for v in hemisphere.centre_mm)
        return (
            f"The arm reached none of the last {max_faults} places of the hemisphere "
            f"of {hemisphere.radius_mm:g} mm about ({centre}) mm: take a smaller "
            f"radius_mm, a higher lowest_rad, or move the object. {last.message}"
        )
    faults = f"{max_faults} faults in a row, the last: {last.outcome}."
    return f"{faults} {last.message}"


def _refuse_other_size(log: EpisodeLog, sensor: TouchSensor) -> None:
    """Gather no touches beside those of another sensor."""
    shape = tuple(sensor.image_shape)
    for number, record in enumerate(log.history):
        image_shape = np.asarray(record.image).shape
        if record.touched and image_shape != shape:
            raise EpisodeError(
                f"{log.folder} must hold touches of {size_text(shape)}, "
                f"as the sensor makes, got {image_shape} in attempt {number}. "
                "Use that sensor, or another folder."
            )


def _n_touched(history: History) -> int:
    return sum(record.touched for record in history)
