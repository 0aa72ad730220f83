"""Mesh files (STL, OBJ, PLY) as objects to touch, from sources not trusted.

Only the file itself is read: materials, textures and anything else it names stay
where they are. What cannot be touched is refused, and the message says how to mend
it.
"""

from io import BytesIO
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._checks import check_option
from .._types import Floats, Indices
from ._placed import Mesh, SimObject, trimesh, turned

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
