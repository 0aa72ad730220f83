"""Solid objects: read from mesh files, put somewhere, and how far a sensor is off.

Of mesh files (STL, OBJ, PLY), whose sources are not trusted, only the file itself is
read: materials, textures and anything else it names stay where they are. What cannot
be touched is refused, and the message says how to mend it.

World: millimetres, z up. The sensor has its own axes: z along its approach, x along
the columns of its image (to the right), y along the rows (downwards); its place is
that of its tip, the middle of the dome.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_number, check_option
from .._extras import needed
from .._types import Floats, Indices, Singles

Mesh = Any  # trimesh.Trimesh, whose package is an extra
_MISSED_MM = 1e30
MESH_SUFFIXES = (".stl", ".obj", ".ply")
MAX_MESH_BYTES = 200_000_000
MAX_MESH_FACES = 5_000_000
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4}
LEAST_SIZE_MM, MOST_SIZE_MM = 1.0, 5000.0
_MOST_POSES = 6
# Units to suggest, likeliest first.
_LIKELY = {"m": "metres", "mm": "millimetres", "in": "inches", "cm": "centimetres"}


class MeshError(ValueError):
    """A mesh file that cannot be touched; the message says why and what to do."""


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


def load_mesh(
    path: str | PathLike[str],
    *,
    unit: str = "mm",
    name: str | None = None,
    category: str | None = None,
) -> SimObject:
    """Read a mesh file as an object to touch.

    Parameters
    ----------
    path : path
        An STL, OBJ or PLY file of one closed surface, or of several without a common
        edge.
    unit : {"mm", "cm", "m", "in", "inch"}, default="mm"
        What its numbers are in; the files themselves do not say.
    name, category : str, optional
        By default the name of the file without its suffix.

    Returns
    -------
    SimObject
        Standing on z = 0 about the origin as it stands in the file, with up to six
        further poses in which it rests.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    MeshError
        It is none of these formats, damaged, too large, empty, flat, open, not
        finite, or its size is no object's.
    """
    file = Path(path)
    scale = UNITS_MM[check_option("unit", unit, UNITS_MM)]
    vertices, faces = _read(file)
    mesh = _closed_surface(file, vertices * scale, faces, unit)
    low, high = mesh.bounds
    mesh.apply_translation([*(-(low + high)[:2] / 2), -low[2]])
    label = name or file.stem
    return SimObject(label, category or label, mesh.copy, _stable_rotations(mesh))


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


def _read(file: Path) -> tuple[Floats, NDArray[np.int64]]:
    kind = file.suffix.lower()
    if kind not in MESH_SUFFIXES:
        raise MeshError(
            f"path must end in {', '.join(MESH_SUFFIXES)}, got {file.name!r}. "
            "Export the object to one of these."
        )
    if not file.is_file():
        raise FileNotFoundError(
            f"path must be a mesh file, got no file {str(file)!r}. Check its name and "
            "folder."
        )
    size = file.stat().st_size
    if size > MAX_MESH_BYTES:
        raise MeshError(
            f"{file.name} must be at most {MAX_MESH_BYTES} bytes, got {size}. "
            "Simplify the mesh."
        )
    with file.open("rb") as stream:
        content = stream.read(MAX_MESH_BYTES + 1)
    load = trimesh().load_mesh
    # Nothing else that the file names is read.
    alone = {"resolver": None, "process": False, "skip_materials": True}
    try:
        mesh = load(BytesIO(content), file_type=kind[1:], **alone)
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(getattr(mesh, "faces", ()), np.int64).reshape(-1, 3)
    except Exception as error:
        raise MeshError(
            f"{file.name} cannot be read as {kind[1:].upper()}: "
            f"{type(error).__name__}: {str(error)[:200]}. Export it again."
        ) from error
    return vertices, faces


def _closed_surface(
    file: Path, vertices: Floats, faces: NDArray[np.int64], unit: str
) -> Mesh:
    solid = bool(len(faces) and len(vertices))
    none = "got none: it is empty, cut off, or a cloud of points. Export a surface."
    _demand(file, solid, f"must have triangles, {none}")
    few = f"must have at most {MAX_MESH_FACES} triangles, got {len(faces)}."
    _demand(file, len(faces) <= MAX_MESH_FACES, f"{few} Simplify the mesh.")
    defined = faces.min() >= 0 and faces.max() < len(vertices)
    _demand(file, defined, "has triangles with corners it does not define.")
    finite = bool(np.isfinite(vertices).all())
    _demand(file, finite, "must be finite, got NaN or infinite corners.")
    used = vertices[np.unique(faces)]
    _refuse_size(file, used.max(axis=0) - used.min(axis=0), unit)
    mesh = trimesh().Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(digits_vertex=5)
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    _demand(
        file, len(mesh.faces) > 0, "must be solid, got triangles without area only."
    )
    if not mesh.is_watertight:
        shared = np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1]
        n_open = int((shared != 2).sum())
        raise MeshError(
            f"{file.name} must be watertight, got {n_open} of {len(shared)} edges that "
            "do not join exactly two triangles. In a mesh editor, close its holes, and "
            "make one body of those that meet at an edge or a face."
        )
    filled = abs(mesh.volume) > 1e-9 * float(np.prod(mesh.extents))
    solid = filled or not mesh.is_winding_consistent
    _demand(file, solid, "must be solid, got a body without volume.")
    return mesh


def _demand(file: Path, met: bool, words: str) -> None:
    if not met:
        raise MeshError(f"{file.name} {words}")


def _refuse_size(file: Path, extent_mm: Floats, unit: str) -> None:
    largest = float(extent_mm.max())
    if LEAST_SIZE_MM <= largest <= MOST_SIZE_MM:
        thick = bool(extent_mm.min() > 1e-6 * largest)
        _demand(file, thick, "must be solid, got a flat surface. Give it a thickness.")
        return
    sizes = {word: largest * UNITS_MM[word] / UNITS_MM[unit] for word in _LIKELY}
    likely = [word for word, size_mm in sizes.items() if 10 <= size_mm <= 2000]
    hint = "Scale it first."
    if likely:
        hint = f"Is it in {_LIKELY[likely[0]]}? Pass `unit={likely[0]}`."
    raise MeshError(
        f"{file.name} must be {LEAST_SIZE_MM:g} to {MOST_SIZE_MM:g} mm across, got "
        f"{largest:.4g} mm (read as {unit}). {hint}"
    )


def _stable_rotations(mesh: Mesh) -> tuple[Floats, ...]:
    """Return rotations in which a mesh rests on the ground, largest base first.

    A base has the centre of mass above it; within 10 degrees the largest counts.
    """
    hull = mesh.convex_hull
    # Groups of coplanar faces and single faces, largest first.
    facets = [np.asarray(facet) for facet in hull.facets]
    grouped = np.concatenate(facets) if facets else np.zeros(0, int)
    single = np.setdiff1d(np.arange(len(hull.faces)), grouped)
    facets += [np.array([face]) for face in single]
    bases: list[Floats] = []
    for facet in sorted(facets, key=lambda facet: -hull.area_faces[facet].sum()):
        down = hull.face_normals[facet[0]]
        if any(down @ other > np.cos(np.deg2rad(10)) for other in bases):
            continue
        if _rests_on(hull, facet, down):
            bases.append(down)
        if len(bases) == _MOST_POSES:
            break
    # Each base's rotation turns the direction `down` into -z.
    rotations = []
    for down in bases:
        axis = np.cross(down, (0.0, 0.0, -1.0))
        if np.linalg.norm(axis) < 1e-9:
            rotations.append(np.eye(3) if down[2] < 0 else turned((1, 0, 0), 180))
        else:
            angle = np.arccos(np.clip(-down[2], -1, 1))
            rotations.append(turned(axis, float(np.degrees(angle))))
    return tuple(rotations)


def _rests_on(hull: Mesh, facet: Indices, down: Floats) -> bool:
    """Whether the centre, moved along `down` onto the facet, lies in a face of it."""
    corners, centre = hull.triangles[facet], hull.center_mass
    onto = centre + down * ((corners[0, 0] - centre) @ down)
    ahead = np.roll(corners, -1, axis=1)
    side = np.cross(ahead - corners, onto - corners) @ down
    return bool((side >= -1e-9 * hull.scale**2).all(axis=1).any())
