"""Solid objects to touch, and the sets of them that the papers used.

`HOUSEHOLD` are the ten objects of Corradi 2015 (doi:10.1109/ICRA.2015.7139744),
`UNSEEN` its five variants never touched in training, `BASIC_SHAPES` the seven
shapes of Corradi 2014 (TAROS, Birmingham). `STRANGE` is unlike all of these. Sizes
are in millimetres, z points up. Household objects stand on z = 0; basic shapes have
their feature at the origin, facing up, so that they are pressed from above there.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _household as household
from ._shapes import Mesh, moved, revolved, rounded_box, trimesh, turned

_MANY_POSES = 6


@dataclass(frozen=True, eq=False)
class SimObject:
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
    resting: tuple[NDArray[np.float64], ...] = ()

    @cached_property
    def mesh(self) -> Mesh:
        """The surface (trimesh.Trimesh), in mm; without faces for "nothing"."""
        return self.build()

    @property
    def resting_rotations(self) -> NDArray[np.float64]:
        """Poses in which it rests, (n_poses, 3, 3), the usual one first."""
        return np.stack([np.eye(3), *self.resting])

    @property
    def size_mm(self) -> NDArray[np.float64]:
        """Extent along x, y and z, (3,)."""
        if not len(self.mesh.faces):
            return np.zeros(3)
        return np.asarray(self.mesh.extents, dtype=np.float64)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the built surface behind: it is rebuilt on the other side."""
        names = ("name", "category", "build", "resting")
        return {name: getattr(self, name) for name in names}


def find_object(name: str) -> SimObject:
    """Return the built-in object of this name.

    Raises
    ------
    ValueError
        There is none; the message lists the names.
    """
    known = {thing.name: thing for thing in HOUSEHOLD + UNSEEN + STRANGE + BASIC_SHAPES}
    if name not in known:
        listed = ", ".join(known)
        raise ValueError(
            f"name must be one of {listed}, got {name!r}. "
            "For a mesh file use load_mesh(path)."
        )
    return known[name]


def refuse_same_names(things: Iterable[SimObject]) -> None:
    """Refuse objects that share a name: their touches would be taken for those of one.

    Raises
    ------
    ValueError
        Two objects have one name.
    """
    seen: set[str] = set()
    for thing in things:
        if thing.name in seen:
            raise ValueError(
                f"objects must have names of their own, got {thing.name!r} twice. "
                "Leave one out, or give a mesh another name: load_mesh(path, name=...)."
            )
        seen.add(thing.name)


def stable_rotations(
    mesh: Mesh, most: int = _MANY_POSES
) -> tuple[NDArray[np.float64], ...]:
    """Return rotations in which a mesh rests on the ground, largest base first.

    A face of the convex hull is a base when the centre of mass is above its inside;
    of bases within 10 degrees of each other the largest counts.
    """
    hull = mesh.convex_hull
    centre = hull.center_mass
    found: list[NDArray[np.float64]] = []
    for facet in _facets_by_area(hull):
        down = hull.face_normals[facet[0]]
        if any(down @ other > np.cos(np.deg2rad(10)) for other in found):
            continue
        if _is_above(hull, facet, down, centre):
            found.append(down)
        if len(found) == most:
            break
    return tuple(_to_ground(down) for down in found)


def _facets_by_area(hull: Mesh) -> list[NDArray[np.intp]]:
    """Groups of coplanar faces and single faces, largest first."""
    groups = [np.asarray(facet) for facet in hull.facets]
    grouped = np.concatenate(groups) if groups else np.zeros(0, int)
    single = np.setdiff1d(np.arange(len(hull.faces)), grouped)
    groups += [np.array([face]) for face in single]
    return sorted(groups, key=lambda facet: -hull.area_faces[facet].sum())


def _is_above(
    hull: Mesh,
    facet: NDArray[np.intp],
    down: NDArray[np.float64],
    centre: NDArray[np.float64],
) -> bool:
    """Whether the centre, moved along `down` onto the facet, lies in a face of it."""
    corners = hull.triangles[facet]
    onto = centre + down * ((corners[0, 0] - centre) @ down)
    ahead = np.roll(corners, -1, axis=1)
    side = np.cross(ahead - corners, onto - corners) @ down
    return bool((side >= -1e-9 * hull.scale**2).all(axis=1).any())


def _to_ground(down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation that turns the direction `down` into -z."""
    axis = np.cross(down, (0.0, 0.0, -1.0))
    if np.linalg.norm(axis) < 1e-9:
        return np.eye(3) if down[2] < 0 else turned((1, 0, 0), 180)
    return turned(axis, float(np.degrees(np.arccos(np.clip(-down[2], -1, 1)))))


def _corner() -> Mesh:
    """Corner of a cube of 40 mm, pointing up."""
    cube = moved(rounded_box((40, 40, 40), 0.3), z=-20)
    up = turned((1, -1, 0), np.degrees(np.arctan(np.sqrt(2))))
    return _top_at_zero(cube, up.T)


def _cylinder() -> Mesh:
    """Cylinder lying, 12 mm thick, 80 mm long."""
    rod = moved(revolved([(0, 0), (6, 0), (6, 80), (0, 80)]), z=-40)
    return _top_at_zero(rod, turned((0, 1, 0), 90))


def _edge() -> Mesh:
    """Edge of a square bar of 40 mm, pointing up."""
    return _top_at_zero(rounded_box((80, 40, 40), 0.3), turned((1, 0, 0), 45))


def _flat_to_edge() -> Mesh:
    """Block whose flat top ends above the origin."""
    return moved(rounded_box((60, 80, 30), 0.3), x=30, z=-30)


def _flat() -> Mesh:
    """Block with a flat top, 80 mm square."""
    return moved(rounded_box((80, 80, 30), 0.3), z=-30)


def _nothing() -> Mesh:
    return trimesh().Trimesh()


def _point() -> Mesh:
    """Cone of 40 degrees, its tip round with a radius of 1 mm."""
    angle = np.deg2rad(np.linspace(20, 90, 8))
    tip = np.column_stack([np.cos(angle), np.sin(angle) - 1])
    tip[-1, 0] = 0
    base = tip[0] + 40 * np.array([np.sin(np.deg2rad(20)), -np.cos(np.deg2rad(20))])
    return revolved([(0, base[1]), base, *tip], 64)


def _top_at_zero(mesh: Mesh, rotation: NDArray[np.float64]) -> Mesh:
    """Turn a mesh, put its highest point at z = 0 and its middle on the axis."""
    turn = np.eye(4)
    turn[:3, :3] = rotation
    copy = mesh.copy()
    copy.apply_transform(turn)
    low, high = copy.bounds
    return moved(copy, -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -high[2])


def _turns(*about: tuple[tuple[int, int, int], float]) -> tuple[NDArray, ...]:
    return tuple(turned(axis, angle) for axis, angle in about)


_UPSIDE = ((1, 0, 0), 180.0)
_ON_SIDE = ((1, 0, 0), 90.0)
_ON_END = ((0, 1, 0), 90.0)

HOUSEHOLD = (
    SimObject("stapler", "stapler", household.stapler),
    SimObject("toothbrush", "toothbrush", household.toothbrush),
    SimObject("porridge pot", "pot", household.porridge_pot, _turns(_UPSIDE)),
    SimObject("mug", "mug", household.mug, _turns(_UPSIDE)),
    SimObject("shampoo bottle", "bottle", household.shampoo_bottle, _turns(_UPSIDE)),
    SimObject("box", "box", household.box, _turns(_ON_SIDE, _ON_END)),
    SimObject("pen", "pen", household.pen),
    SimObject("ball", "ball", household.ball, _turns(_ON_SIDE)),
    SimObject("textbook", "book", household.textbook, _turns(_UPSIDE)),
    SimObject("water bottle", "bottle", household.water_bottle),
)

STRANGE = (SimObject("massage ball", "massage ball", household.massage_ball),)

UNSEEN = (
    SimObject("plastic card", "card", household.plastic_card, _turns(_UPSIDE)),
    SimObject("other mug", "mug", household.other_mug, _turns(_UPSIDE)),
    SimObject("other pen", "pen", household.other_pen),
    SimObject("smaller ball", "ball", household.smaller_ball),
    SimObject("soft textbook", "book", household.soft_textbook),
)

BASIC_SHAPES = (
    SimObject("corner", "corner", _corner),
    SimObject("cylinder", "cylinder", _cylinder),
    SimObject("edge", "edge", _edge),
    SimObject("flat-to-edge", "flat-to-edge", _flat_to_edge),
    SimObject("flat", "flat", _flat),
    SimObject("nothing", "nothing", _nothing),
    SimObject("point", "point", _point),
)
