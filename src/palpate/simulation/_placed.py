"""Where an object stands, where a sensor is, and how far apart they are.

World: millimetres, z up. The sensor has its own axes: z along its approach, x along
the columns of its image (to the right), y along the rows (downwards); its place is
that of its tip, the middle of the dome.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_number
from .._extras import needed
from .._types import Floats, Singles

Mesh = Any  # trimesh.Trimesh, whose package is an extra
_MISSED_MM = 1e30


class _Rebuilt:
    """Pickled without what is worked out from its fields, which is made anew."""

    def __getstate__(self) -> dict[str, Any]:
        names = self.__dataclass_fields__  # type: ignore[attr-defined]
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, eq=False)
class SimObject(_Rebuilt):
    """A rigid object to touch.

    Parameters
    ----------
    name : str
        What it is called in touches.
    category : str
        The kind of thing it is.
    build : callable returning trimesh.Trimesh
        Makes its surface, in mm, z up. Called once, when `mesh` is first read.
    resting : tuple of ndarray of shape (3, 3), default=()
        Rotations that put it into further poses in which it rests; the pose it is
        built in always comes first.

    Examples
    --------
    >>> from palpate.simulation import find_object
    >>> [round(float(side)) for side in find_object("box").size_mm]
    [160, 110, 60]
    """

    name: str
    category: str
    build: Callable[[], Mesh]
    resting: tuple[Floats, ...] = ()

    @cached_property
    def mesh(self) -> Mesh:
        """The surface (trimesh.Trimesh), in mm; without faces for "nothing"."""
        return self.build()

    @property
    def resting_rotations(self) -> Floats:
        """Poses in which it rests, (n_poses, 3, 3), the usual one first."""
        return np.stack([np.eye(3), *self.resting])

    @property
    def size_mm(self) -> Floats:
        """Extent along x, y and z, (3,)."""
        if not len(self.mesh.faces):
            return np.zeros(3)
        return np.asarray(self.mesh.extents, dtype=np.float64)

    @property
    def surface(self) -> str:
        """Area and number of triangles: another mesh may have the same name."""
        return f"{self.mesh.area:.6g} mm2, {len(self.mesh.faces)} triangles"

    def distance_mm(self, origins_mm: ArrayLike, direction: ArrayLike) -> Singles:
        """Distance from each origin, (n_rays, 3), to the surface as it was built.

        Along `direction`; infinity where the ray misses.
        """
        origins = np.ascontiguousarray(origins_mm, dtype=np.float32)
        if self._scene is None:
            return np.full(len(origins), np.inf, np.float32)
        ways = np.repeat(np.asarray(direction, np.float32)[None], len(origins), axis=0)
        if isinstance(self._scene, np.ndarray):
            # What a scene of embreex does, many times slower.
            nearest = np.full(len(origins), np.inf, np.float32)
            for a, b, c in self._scene.astype(float):
                sides = np.stack([b - a, c - a, -ways[0]])
                if np.linalg.det(sides):
                    u, v, t = ((origins - a) @ np.linalg.inv(sides)).T
                    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
                    nearest[hit] = np.minimum(nearest[hit], t[hit])
            return nearest
        distance = self._scene.run(origins, ways, query="DISTANCE")
        return np.where(distance > _MISSED_MM, np.float32(np.inf), distance)

    @cached_property
    def _scene(self) -> Any:
        faces = np.asarray(self.mesh.faces)
        if not len(faces):
            return None
        corners = np.asarray(self.mesh.vertices, float).reshape(-1, 3)
        triangles = corners[faces].astype(np.float32)
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            return triangles
        scene = EmbreeScene()
        TriangleMesh(scene, triangles)
        return scene


@dataclass(frozen=True, eq=False)
class PlacedObject(_Rebuilt):
    """An object put somewhere, ready to be touched.

    Parameters
    ----------
    thing : SimObject
        What it is.
    rotation : array-like of shape (3, 3), optional
        Turns it first; default not at all.
    yaw_rad : float, default=0.0
        Then turns it about the vertical.
    position_mm : array-like of shape (3,), default=(0, 0, 0)
        Then moves its own origin there.

    Raises
    ------
    ValueError
        `rotation` is no rotation, or a value is not finite.
    """

    thing: SimObject
    rotation: ArrayLike | None = None
    yaw_rad: float = 0.0
    position_mm: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        turn = np.eye(3) if self.rotation is None else np.asarray(self.rotation, float)
        square = turn.shape == (3, 3)
        kept = square and np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
        if not kept or np.linalg.det(turn) < 0:  # below 0 it is a mirror
            raise ValueError(
                f"rotation must be a 3 x 3 rotation, got {self.rotation!r}."
            )
        check_number("yaw_rad", self.yaw_rad)
        object.__setattr__(self, "position_mm", vector("position_mm", self.position_mm))

    @classmethod
    def resting(
        cls, thing: SimObject, pose: int = 0, yaw_rad: float = 0.0
    ) -> PlacedObject:
        """Put it in a resting pose on the ground z = 0, its middle above the origin."""
        rotation = thing.resting_rotations[pose]
        low, high = cls(thing, rotation, yaw_rad).bounds_mm
        x, y, _ = (low + high) / 2
        return cls(thing, rotation, yaw_rad, (0 - x, 0 - y, 0 - low[2]))

    @cached_property
    def vertices_mm(self) -> Floats:
        """Corners of the surface where they are now, (n_vertices, 3)."""
        corners = np.asarray(self.thing.mesh.vertices, float).reshape(-1, 3)
        return np.asarray(corners @ self._turn.T + np.asarray(self.position_mm))

    @cached_property
    def _turn(self) -> Floats:
        """The rotation and the yaw together, (3, 3)."""
        turn = turned((0, 0, 1), np.degrees(self.yaw_rad))
        if self.rotation is None:
            return turn
        return np.asarray(turn @ np.asarray(self.rotation, float))

    @cached_property
    def bounds_mm(self) -> Floats:
        """Lowest and highest x, y, z, (2, 3); zeros for "nothing"."""
        corners = self.vertices_mm if len(self.vertices_mm) else np.zeros((1, 3))
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    @property
    def centre_mm(self) -> Floats:
        """Middle of its bounding box, (3,)."""
        return np.asarray(self.bounds_mm.mean(axis=0))

    def distance_mm(self, origins_mm: ArrayLike, direction: ArrayLike) -> Singles:
        """Distance from each origin, (n_rays, 3), to the surface along `direction`.

        Infinity where the ray misses.
        """
        # In the object's own frame: the scene is built once, wherever it stands.
        turn = self._turn
        from_it = np.asarray(origins_mm, float) - np.asarray(self.position_mm)
        return self.thing.distance_mm(from_it @ turn, np.asarray(direction) @ turn)


@dataclass(frozen=True, eq=False)
class SensorPose:
    """Where the tip of a sensor is and which way it looks.

    Parameters
    ----------
    position_mm : array-like of shape (3,)
        Place of the tip.
    direction : array-like of shape (3,)
        Way in which it is pushed, of any length but zero.
    roll_rad : float, default=0.0
        Turn of the sensor about its axis, right-handed. At 0 its x axis is
        horizontal; pushed straight down, it is the x axis of the world.
    """

    position_mm: ArrayLike
    direction: ArrayLike
    roll_rad: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_mm", vector("position_mm", self.position_mm))
        way = vector("direction", self.direction)
        length = np.linalg.norm(way)
        if not length > 0:
            raise ValueError("direction must not be zero. Give the way to push.")
        object.__setattr__(self, "direction", way / length)
        check_number("roll_rad", self.roll_rad)

    @cached_property
    def axes(self) -> Floats:
        """Columns: the sensor's x, y and z axes in the world, (3, 3)."""
        way = np.asarray(self.direction)
        level = np.array([-way[1], way[0], 0.0])
        length = np.linalg.norm(level)
        x = level / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
        y = np.cross(way, x)
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        return np.column_stack([cos * x + sin * y, cos * y - sin * x, way])

    def advanced(self, way_mm: float) -> SensorPose:
        """Return this pose moved along its direction."""
        there = np.asarray(self.position_mm) + way_mm * np.asarray(self.direction)
        return SensorPose(there, self.direction, self.roll_rad)


def distances_ahead(
    placed: PlacedObject, pose: SensorPose, x: Floats, y: Floats, back_mm: float
) -> Singles:
    """Return how far the object is along the sensor's axis from x, y behind its tip."""
    local = np.column_stack([x, y, np.full(x.shape, -back_mm)])
    origins = np.asarray(pose.position_mm) + local @ pose.axes.T
    return placed.distance_mm(origins, pose.direction)


def turned(axis: ArrayLike, angle_deg: float) -> Floats:
    """Return the 3 x 3 rotation by an angle about an axis, right-handed."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(angle_deg)
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return np.asarray(turn)


def vector(name: str, value: ArrayLike) -> Floats:
    """Return `value` as three finite numbers, or explain."""
    array = np.array(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be three finite numbers, got {value!r}.")
    return array


def trimesh() -> Any:
    """Return the package `trimesh`, or say what to install."""
    return needed("trimesh", "sim", "Simulating touches on 3-D objects")
