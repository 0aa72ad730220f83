"""A simulated bench: one object, one dome, what happens between them, what it sees.

The simulated arm moves the dome and reads its force here, the simulated sensor sees
it here. World: millimetres, z up; forces in newtons along the axis of the dome.
"""

from collections.abc import Container
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .._checks import check_number
from .._types import Array, Floats
from ..simulation import DomeCamera, DomePress, PlacedObject, SensorPose
from ._contract import SensorError

_SAME_LINE_MM = 1e-6  # rounding of a pose on the same line
# Forces at which contact is solved; between them it is interpolated in logarithms.
_FORCES_N = 0.03 * 2.5 ** np.arange(7)
_LEAST_MM = 1e-3
_TINY_N = 1e-6
_CLEAR_MM = 5.0


class SimulatedBench:
    """An object and a dome that is moved against it in straight lines.

    Parameters
    ----------
    target : PlacedObject
        What to touch, where it stands at first.
    camera : DomeCamera, optional
        The dome; by default the BathTip with square pictures of 120 pixels.
    shift_share : float, default=0.05
        Contact may shift the object: no point of it ever strays further from its
        place than this share of its largest extent. 0 fixes the object.
    housing_n_mm : float, default=2.0
        Stiffness once the rigid body that holds the dome is met, beyond the camera's
        greatest depth or where its sleeve touches: of the arm, the mount and the
        object together (N/mm). Guess.
    random_state : int, default=0
        Seed of the shifts.

    Attributes
    ----------
    target : PlacedObject
        The object where it is now.
    centre_mm : ndarray of shape (3,)
        Middle of the object where it stood at first.
    pose : SensorPose or None
        Where the tip is; None before the first move.
    force_n : float
        True force on the dome now.
    peak_force_n : float
        Greatest true force so far.

    Notes
    -----
    Once per press, at a force drawn evenly below that of the camera, the object
    slips where that lessens the force: mostly the way it is pushed, on the ground,
    and a little about the vertical. Half of the allowance is for sliding, half for
    turning. Friction, tipping and the ground itself are not simulated: the dome can
    go below z = 0.
    """

    def __init__(
        self,
        target: PlacedObject,
        camera: DomeCamera | None = None,
        *,
        shift_share: float = 0.05,
        housing_n_mm: float = 2.0,
        random_state: int = 0,
    ) -> None:
        self.target = target
        usual: object = DomeCamera(image_shape=(120, 120)) if camera is None else camera
        if not isinstance(usual, DomeCamera):
            raise TypeError(
                f"camera must be a DomeCamera, got {type(usual).__name__}. Other "
                "sensors are simulated by simulate_touches alone."
            )
        self.camera = usual
        self.centre_mm = np.asarray(target.centre_mm)
        self.pose: SensorPose | None = None
        self.force_n = self.peak_force_n = 0.0
        self._housing = check_number("housing_n_mm", housing_n_mm, low=0.0)
        self._rng = np.random.default_rng(random_state)
        extent = np.ptp(target.bounds_mm, axis=0).max()
        share = check_number("shift_share", shift_share, low=0.0, high=1.0)
        self._slide_mm, self._turn_rad = share * extent / 2, share
        self._first, self._slid, self._turned = target, np.zeros(2), 0.0
        self._line: _Line | None = None
        self._slip_at_n = np.inf

    def move_to(self, pose: SensorPose) -> None:
        """Put the tip at a pose; the force there is known afterwards."""
        if self._is_clear(pose):
            self.pose, self._line, self.force_n = pose, None, 0.0
            return
        if self._line is None or not self._line.holds(pose):
            self._line, self._slip_at_n = self._begun(pose)
        self.pose = pose
        self.force_n = self._force(self._line)
        if self.force_n > self._slip_at_n:
            self._slip()
        self.peak_force_n = max(self.peak_force_n, self.force_n)

    def approach(
        self, start: SensorPose, force_n: float, reach_mm: float
    ) -> float | None:
        """Move in along a line until a force, in one go; return the way (mm), or None.

        The contact, and the slip, that moving in by short steps comes to, solved at
        the force where steps pass it: the way is shorter by up to one of them. None,
        and the tip at `reach_mm`, where the force is not met on the way.
        """
        self._line, slip_at_n = self._begun(start)
        if slip_at_n < force_n:
            way_mm, _ = self._line.pressed(slip_at_n, self._housing)
            if way_mm <= reach_mm:
                slid, turned, target, line = self._offered_slip()
                # Where the same force comes later there is less of it here.
                if line.pressed(slip_at_n, self._housing)[0] >= way_mm:
                    self._slid, self._turned = slid, turned
                    self.target, self._line = target, line
        way_mm, press = self._line.pressed(force_n, self._housing)
        if not way_mm <= reach_mm:
            self.pose, self.force_n = start.advanced(reach_mm), 0.0
            return None
        self.pose, self.force_n = start.advanced(way_mm), force_n
        self._line.keep(press)
        self.peak_force_n = max(self.peak_force_n, force_n)
        return way_mm

    def _begun(self, pose: SensorPose) -> tuple["_Line", float]:
        """Return a line from a pose, and the force at which the object slips on it."""
        most_n = self.camera.force_n if self._turn_rad > 0 else np.inf
        slip_at_n = float(self._rng.uniform(0, 1)) * most_n
        return _Line(self.camera, self.target, pose), slip_at_n

    def _is_clear(self, pose: SensorPose) -> bool:
        """Whether nothing of the dome can meet the object, wherever it has slid."""
        low, high = np.asarray(self._first.bounds_mm)
        reach = float(np.linalg.norm(high - low)) / 2 + 2 * self._slide_mm
        camera = self.camera
        radius_mm = float(np.hypot(camera.sleeve_mm, camera.membrane_radius_mm))
        away = np.asarray(pose.position_mm) - (low + high) / 2
        return bool(np.linalg.norm(away) > reach + radius_mm + _CLEAR_MM)

    def frame(self, rng: np.random.Generator | None = None) -> NDArray[np.uint8]:
        """Return what the camera in the dome sees now, with noise if `rng`."""
        press = None
        if self._line is not None and self.pose is not None:
            press = self._line.press(self.pose)
        return self.camera.image(press, rng)

    def _force(self, line: "_Line") -> float:
        """Force of the rubber and, beyond it, of the rigid body."""
        assert self.pose is not None
        travel = line.travel_mm(self.pose)
        return line.force_n(travel) + self._housing * max(travel - line.hard_mm, 0.0)

    def _slip(self) -> None:
        """Let the object give way once in this press, within its allowance."""
        self._slip_at_n = np.inf
        slid, turned, target, line = self._offered_slip()
        force = self._force(line)
        if force <= self.force_n:
            self._slid, self._turned = slid, turned
            self.target, self._line, self.force_n = target, line, force

    def _offered_slip(self) -> tuple[Floats, float, PlacedObject, "_Line"]:
        """Draw where the object might slip to, and the line towards it there."""
        assert self._line is not None
        pushed = np.asarray(self._line.base.direction)[:2]
        way = pushed + 0.5 * self._rng.standard_normal(2)
        way *= self._rng.uniform(0, 0.5) * self._slide_mm / max(np.hypot(*way), 1e-9)
        slid = self._slid + way
        slid *= min(1.0, self._slide_mm / max(np.hypot(*slid), 1e-9))
        turned = self._turned + self._rng.uniform(-0.5, 0.5) * self._turn_rad
        turned = float(np.clip(turned, -self._turn_rad, self._turn_rad))
        target = self._shifted(slid, turned)
        return slid, turned, target, _Line(self.camera, target, self._line.base)

    def _shifted(self, slid_mm: Floats, turned_rad: float) -> PlacedObject:
        """Turn the object about the vertical through its middle, then slide it."""
        first, cos, sin = self._first, np.cos(turned_rad), np.sin(turned_rad)
        arm = np.asarray(first.position_mm) - self.centre_mm
        place = self.centre_mm + arm
        turn = np.array([[cos, -sin], [sin, cos]])
        place[:2] = self.centre_mm[:2] + turn @ arm[:2] + slid_mm
        yaw_rad = first.yaw_rad + turned_rad
        return PlacedObject(first.thing, first.rotation, yaw_rad, place)


class SimulatedSensor:
    """The dome camera of a `SimulatedBench`, as a `TouchSensor`.

    Parameters
    ----------
    bench : SimulatedBench
        Where the dome is and what it touches.
    random_state : int, default=0
        Seed of the noise of the frames.
    missing : container of int, default=()
        Numbers of the frames, counted from 0, that do not arrive.
    """

    geometry = "dome"

    def __init__(
        self,
        bench: SimulatedBench,
        *,
        random_state: int = 0,
        missing: Container[int] = (),
    ) -> None:
        self._bench = bench
        self._rng = np.random.default_rng(random_state)
        self._missing = missing
        self.n_asked = 0

    @property
    def image_shape(self) -> tuple[int, int]:
        """(n_rows, n_cols) of every frame."""
        return self._bench.camera.image_shape

    def read(self) -> Array:
        """Return the frame of this moment, or raise `SensorError`."""
        number, self.n_asked = self.n_asked, self.n_asked + 1
        if number in self._missing:
            raise SensorError(f"Frame {number} did not arrive.")
        return self._bench.frame(self._rng)

    def no_contact(self) -> Array:
        """Return the frame of touching nothing, without noise."""
        return self._bench.camera.no_contact()


class _Line:
    """A line towards an object: touched at `first_mm`, rigid body at `hard_mm`."""

    def __init__(
        self, camera: DomeCamera, target: PlacedObject, base: SensorPose
    ) -> None:
        self.base = base
        self._membrane = camera.membrane
        gap = camera.gap_mm(target, base)
        self.first_mm = float(gap.min())
        self._way_mm = gap - self.first_mm if np.isfinite(self.first_mm) else gap
        sleeve = camera.sleeve_gap_mm(target, base)
        self.hard_mm = min(sleeve, self.first_mm + camera.max_depth_mm)
        # Force against depth, in logarithms, solved as deep as was asked.
        self._log_depth: list[float] = []
        self._log_force: list[float] = []
        self._to_solve = [float(force) for force in _FORCES_N[::-1]]
        self._pressed: tuple[float, DomePress] | None = None

    def holds(self, pose: SensorPose) -> bool:
        same_roll = pose.roll_rad == self.base.roll_rad
        if not (same_roll and np.array_equal(pose.direction, self.base.direction)):
            return False
        way = np.asarray(pose.position_mm) - np.asarray(self.base.position_mm)
        aside = way - (way @ self.base.direction) * np.asarray(self.base.direction)
        return bool(np.linalg.norm(aside) < _SAME_LINE_MM)

    def travel_mm(self, pose: SensorPose) -> float:
        way = np.asarray(pose.position_mm) - np.asarray(self.base.position_mm)
        return float(way @ self.base.direction)

    def force_n(self, travel_mm: float) -> float:
        """Force of the rubber when the tip has come so far."""
        depth = min(travel_mm, self.hard_mm) - self.first_mm
        if not depth > _LEAST_MM:
            return 0.0
        log_depth = float(np.log(depth))
        while self._to_solve and not self._reaches(log_depth):
            force_n = self._to_solve.pop()
            solved = self._solved(force_n).depth_mm
            if solved > 0 and not self._reaches(np.log(solved)):
                self._log_depth.append(float(np.log(solved)))
                self._log_force.append(float(np.log(force_n)))
        if log_depth < self._log_depth[0]:  # Below the least force: as depth^1.5.
            slope = 1.5 * (log_depth - self._log_depth[0])
            return float(np.exp(self._log_force[0] + slope))
        return float(np.exp(np.interp(log_depth, self._log_depth, self._log_force)))

    def pressed(
        self, force_n: float, housing_n_mm: float
    ) -> tuple[float, DomePress | None]:
        """Return the way to a force, rigid body included, and the press there."""
        most_mm = max(self.hard_mm - self.first_mm, 0.0)
        if not np.isfinite(self.first_mm):
            return np.inf, None
        solved = self._solved(max(force_n, _TINY_N), most_mm)
        way_mm = self.first_mm + solved.depth_mm
        left_n = force_n - solved.force_n
        if solved.depth_mm >= most_mm and left_n > 0:
            way_mm += left_n / housing_n_mm if housing_n_mm else np.inf
        return way_mm, self._at(way_mm, force_n, solved)

    def keep(self, press: DomePress | None) -> None:
        """Keep the press that was solved, for its picture."""
        if press is not None:
            self._pressed = press.travel_mm, press

    def _at(self, travel_mm: float, force_n: float, press: DomePress) -> DomePress:
        depth_mm = travel_mm - self.first_mm
        return replace(press, travel_mm=travel_mm, depth_mm=depth_mm, force_n=force_n)

    def _reaches(self, log_depth: float) -> bool:
        return bool(self._log_depth) and self._log_depth[-1] >= log_depth

    def press(self, pose: SensorPose) -> DomePress | None:
        """The state of the dome at a pose, or None where it touches nothing."""
        travel = self.travel_mm(pose)
        if self._pressed is not None and abs(self._pressed[0] - travel) < _SAME_LINE_MM:
            return self._pressed[1]
        force = self.force_n(travel)
        if force == 0:
            return None
        press = self._at(travel, force, self._solved(force))
        self._pressed = travel, press
        return press

    def _solved(self, force_n: float, most_mm: float | None = None) -> DomePress:
        """Press until a force, or a greatest depth, which the rubber alone bears."""
        gap_mm = self._way_mm
        contact = self._membrane.pressed(gap_mm, force_n=force_n, depth_mm=most_mm)
        depth, total, area = contact.depth_mm, contact.force_n, contact.area_mm2
        travel_mm = self.first_mm + depth
        return DomePress("force", travel_mm, depth, total, area, contact, gap_mm)
