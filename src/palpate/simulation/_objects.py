"""Objects to touch, built in code, and the sets of them that the papers used.

`HOUSEHOLD` are the ten objects of Corradi 2015 (doi:10.1109/ICRA.2015.7139744). In
`find_objects` knows, too, its five variants never touched in training ("unseen"), the
seven shapes of Corradi 2014 ("shapes"; TAROS, Birmingham), and what resembles none.
Corradi 2015 shows photographs without sizes: these are ordinary objects of each kind,
every size a guess within what shops sell. Sizes are in millimetres, z points up.
Household objects stand on z = 0 about the origin, the way they usually stand or lie;
basic shapes have their feature at the origin, facing up, to be pressed from above.

Surfaces are watertight, outward side out. Bodies that overlap are joined without
cutting (`joined`): a ray from outside meets the same surface either way, only volumes
would be counted twice.
"""

from collections.abc import Iterable
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import ArrayLike

from .._checks import did_you_mean
from .._types import Floats
from ._solids import Mesh, SimObject, trimesh, turned


def find_object(name: str) -> SimObject:
    """Return the built-in object called `name`, such as "mug".

    Raises
    ------
    ValueError
        There is none; the message lists the names.
    """
    things = {thing.name: thing for thing in chain(*_SETS.values())}
    if name in things:
        return things[name]
    raise ValueError(
        f"name must be one of {', '.join(things)}, got {name!r}."
        f"{did_you_mean(name, [*things])} For a mesh file use load_mesh(path)."
    )


def find_objects(
    objects: Iterable[SimObject | str] | SimObject | str | None = None,
) -> list[SimObject]:
    """Return objects, or those of names and of sets, by default the household ones.

    Sets are "household", "unseen", "unlike others" and "shapes". No two objects of one
    name: their touches would be taken for those of one.
    """
    if objects is None:
        objects = "household"
    if isinstance(objects, str) or not isinstance(objects, Iterable):
        objects = [objects]
    requested = list(objects)
    if not requested:
        raise ValueError("objects must name at least one object, got none.")
    things: dict[str, SimObject] = {}
    for item in requested:
        named: tuple[SimObject, ...]
        if isinstance(item, SimObject):
            named = (item,)
        elif isinstance(item, str):
            named = _SETS.get(item) or (find_object(item),)
        else:
            raise TypeError(
                f"objects must be SimObject or names, got {type(item).__name__}. "
                "Read a mesh file with load_mesh(path)."
            )
        for thing in named:
            if thing.name in things:
                raise ValueError(
                    f"objects must have names of their own, got {thing.name!r} twice. "
                    "Leave one out, or give a mesh another name: "
                    "load_mesh(path, name=...)."
                )
            things[thing.name] = thing
    return list(things.values())


def stapler() -> Mesh:
    """Desk stapler, 140 x 32 x 52: base, arm sloping up to its head, anvil."""
    base = rounded_box((140, 32, 7), 2.5)
    anvil = moved(rounded_box((16, 12, 3), 0.8), x=-58, z=6)
    hinge = moved(rounded_box((26, 24, 34), 3), x=52)
    low = [(x, y, z) for x, z in ((-62, 30), (58, 20)) for y in (-9, 9)]
    high = [(x, y, z) for x, z in ((-58, 46), (56, 34)) for y in (-6, 6)]
    arm = rounded_hull(low + high, 4)
    magazine = rounded_hull(
        [(x, y, z) for x, z in ((-66, 24), (50, 15)) for y in (-5, 5)], 3
    )
    return joined(base, anvil, hinge, arm, magazine)


def toothbrush() -> Mesh:
    """Toothbrush lying bristles up, 190 long: waisted handle, neck, 40 tufts."""
    spots = [(-95, 6), (-70, 7), (-35, 5.5), (-5, 7), (25, 6.6), (50, 3.5), (68, 3)]
    balls = [ball_points((x, 0.0, 7.0), radius, 20) for x, radius in spots]
    parts = [hull(np.concatenate(pair)) for pair in pairwise(balls)]
    head = moved(rounded_box((28, 12, 5), 2), x=81, z=5)
    tuft = revolved([(0, 0), (0.85, 0), (0.85, 10), (0.5, 10.6), (0, 10.8)], 12)
    tufts = [
        moved(tuft, x=81 + 2.6 * column, y=2.6 * row, z=9)
        for column in np.arange(10) - 4.5
        for row in np.arange(4) - 1.5
    ]
    return joined(*parts, head, *tufts)


def porridge_pot() -> Mesh:
    """Cardboard porridge pot, 90 wide at its rolled rim, 100 high, lid sunk by 3."""
    rim = _arc(43.5, 98.2, 1.8, -90, 200, 12)
    profile = [(0, 2), (32, 2), (32, 0), (34, 0), (43, 96.4), *rim, (41.5, 97), (0, 97)]
    return revolved(profile)


def mug() -> Mesh:
    """Mug, 82 wide, 95 high, wall 4, with a round handle."""
    return joined(_cup(82, 82, 95, 4), _handle(38.5, 48, 26, 30, 5.5))


def shampoo_bottle() -> Mesh:
    """Shampoo bottle, 74 x 44 x 190: flat oval body, shoulders, snap cap."""
    z = np.array([0, 2, 5, 60, 120, 140, 150, 156, 158], float)
    half_x = np.array([30, 34, 36, 37, 35, 30, 22, 13, 12], float)
    half_y = np.array([16, 19, 21, 22, 21, 18, 15, 12.5, 12], float)
    around = np.arange(96) * (2 * np.pi / 96)
    cos, sin = np.cos(around), np.sin(around)
    x = np.multiply.outer(half_x, np.sign(cos) * np.abs(cos) ** (2 / 2.4))
    y = np.multiply.outer(half_y, np.sign(sin) * np.abs(sin) ** (2 / 2.4))
    body = _stacked(np.stack([x, y], -1), z)
    cap = revolved([(0, 155), (14, 155), (14, 186), (12.5, 189), (10, 190), (0, 190)])
    return joined(body, cap)


def box() -> Mesh:
    """Carton, 160 x 110 x 60, edges rounded by 0.7."""
    return rounded_box((160, 110, 60), 0.7)


def pen() -> Mesh:
    """Ball-point pen lying, 146 long, 9 thick, with point, button and clip."""
    profile = [(0, 0), (0.5, 0), (0.7, 1), (1.2, 3.5), (1.6, 4), (4.2, 18), (4.5, 22)]
    profile += [(4.5, 60), (4.3, 61), (4.5, 62), (4.5, 128), (3.8, 131), (2.2, 132)]
    profile += [(2.2, 143), (1.6, 145), (0, 146)]
    clip = rounded_hull([(5.8, y, z) for y in (-1.2, 1.2) for z in (88, 127)], 0.8)
    bridge = rounded_hull([(x, 0, 127) for x in (3, 5.8)], 1.2)
    return _lying(joined(revolved(profile, 48), clip, bridge), 146, 4.5)


def massage_ball() -> Mesh:
    """Massage ball, 79 across: 60 knobs, 4.4 wide and 6 high, evenly spread."""
    k = np.arange(60) + 0.5
    polar, turn = np.arccos(1 - k / 30), np.pi * (1 + np.sqrt(5)) * k
    x, y = np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar)
    middle = np.array([0.0, 0.0, 40.0])
    knobs = [
        rounded_hull([middle + 34 * out, middle + 38 * out], 2.2, 10)
        for out in np.stack([x, y, np.cos(polar)], axis=1)
    ]
    return joined(hull(ball_points(middle, 34, 32)), *knobs)


def ball() -> Mesh:
    """Ball, 72 across, with a moulding seam 1.2 wide and 0.4 deep round it."""
    angle = np.linspace(-90, 90, 121)
    radius = 36 - 0.4 * np.clip(1 - np.abs(angle) * 36 * np.pi / 180 / 1.2, 0, None)
    r, z = radius * np.cos(np.deg2rad(angle)), radius * np.sin(np.deg2rad(angle))
    r[[0, -1]] = 0
    return revolved(np.column_stack([r, z + 36]))


def textbook() -> Mesh:
    """Hard-back textbook lying, 240 x 170 x 32: boards overhang the pages by 4."""
    board = rounded_box((240, 170, 3), 1)
    pages = moved(rounded_box((232, 164, 27), 0.6), y=1, z=2.5)
    spine = rounded_hull(
        [(x, -83.5, z) for x in (-118.5, 118.5) for z in (1.5, 30.5)], 1.5
    )
    return joined(board, moved(board, z=29), pages, spine)


def water_bottle() -> Mesh:
    """Water bottle, 65 wide, 225 high: five ribs, shoulder, ridged cap."""
    ribs = [(r, 40 + 14 * k + dz) for k in range(5) for r, dz in _RIB]
    body = [(0, 4), (22, 4), (26, 0), (30, 1), (32.5, 6), (32.5, 30), *ribs]
    body += [(32.5, 130), (31, 150), (26, 172), (18, 190), (13.5, 200), (13, 206)]
    body += [(16, 207), (16, 209), (13, 210), (13, 214), (0, 214)]
    angles = np.arange(144) * (2 * np.pi / 144)
    ridge = 14.2 + 0.5 * np.sign(np.sin(36 * angles))
    wheel = np.stack([ridge * np.cos(angles), ridge * np.sin(angles)], -1)
    shrink = np.array([1.0, 1.0, 0.93])[:, None, None]
    cap = _stacked(wheel * shrink, np.array([211.0, 224.0, 225.0]))
    return joined(revolved(body), cap)


def plastic_card() -> Mesh:
    """Bank card lying, 85.6 x 54 x 0.76 with corners of 3.2 (ISO/IEC 7810)."""
    angles = np.deg2rad(np.arange(0, 360, 10) + 5.0)
    corner = 3.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    flat = corner + np.sign(corner) * (42.8 - 3.2, 27 - 3.2)
    levels = [np.column_stack([flat, np.full(len(flat), z)]) for z in (0, 0.76)]
    return hull(np.concatenate(levels))


def other_mug() -> Mesh:
    """Wider mug, 72 to 94 across, 104 high, wall 3.5, with a larger handle."""
    return joined(_cup(72, 94, 104, 3.5), _handle(38.5, 52, 30, 36, 5))


def other_pen() -> Mesh:
    """Six-sided pencil-like pen lying, 138 long, 8.4 across, capped."""
    angles = np.arange(6) * np.pi / 3
    z = np.array([0, 1, 6, 20, 100], float)
    radius = np.array([0.4, 0.8, 1.5, 4.2, 4.2])
    wheel = np.stack([np.cos(angles), np.sin(angles)], -1)
    flat = radius[:, None, None] * wheel
    body = _stacked(flat, z)
    outline = [(0, 92), (4.5, 92), (4.7, 94), (4.4, 134), (3.5, 138), (0, 138)]
    cap = revolved(outline, 48)
    clip = rounded_hull([(5.9, y, z) for y in (-1.5, 1.5) for z in (100, 132)], 1.2)
    return _lying(joined(body, cap, clip), 138, 4.7)


def smaller_ball() -> Mesh:
    """Ball, 46 across, smooth."""
    angle = np.deg2rad(np.linspace(-90, 90, 91))
    r = 23 * np.cos(angle)
    r[[0, -1]] = 0
    return revolved(np.column_stack([r, 23 + 23 * np.sin(angle)]))


def soft_textbook() -> Mesh:
    """Soft-back textbook lying, 234 x 156 x 22, its cover bulging by 1.5."""
    x = 117.0 * np.cos(np.linspace(0, np.pi, 41))
    top = 20.5 + 1.5 * np.cos(np.linspace(-np.pi / 2, np.pi / 2, 41))
    points = [
        (a, y, z)
        for a, high in zip(x, top, strict=True)
        for y, cut in ((-78, 2.0), (-76, 0.0), (78, 0.0))
        for z in (cut, high - cut)
    ]
    return hull(points)


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


def _block(size: tuple[float, float, float], x: float) -> Mesh:
    """Block with a flat top at z = 0, its middle at x."""
    return moved(rounded_box(size, 0.3), x=x, z=-size[2])


def _point() -> Mesh:
    """Cone of 40 degrees, its tip round with a radius of 1 mm."""
    angle = np.deg2rad(np.linspace(20, 90, 8))
    tip = np.column_stack([np.cos(angle), np.sin(angle) - 1])
    tip[-1, 0] = 0
    base = tip[0] + 40 * np.array([np.sin(np.deg2rad(20)), -np.cos(np.deg2rad(20))])
    return revolved([(0, base[1]), base, *tip], 64)


def _top_at_zero(mesh: Mesh, rotation: Floats) -> Mesh:
    """Turn a mesh, put its highest point at z = 0 and its middle on the axis."""
    turn = np.eye(4)
    turn[:3, :3] = rotation
    copy = mesh.copy()
    copy.apply_transform(turn)
    low, high = copy.bounds
    return moved(copy, -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -high[2])


_RIB = ((32.5, 0.0), (31.3, 2.0), (30.9, 4.0), (31.3, 6.0), (32.5, 8.0))


def _arc(
    r: float, z: float, radius: float, start_deg: float, stop_deg: float, n: int
) -> list[tuple[float, float]]:
    """Points of a profile on a circle, from one angle to another."""
    angle = np.deg2rad(np.linspace(start_deg, stop_deg, n))
    x, y = r + radius * np.cos(angle), z + radius * np.sin(angle)
    return list(zip(x, y, strict=True))


def _cup(bottom: float, top: float, height: float, wall: float) -> Mesh:
    """Open cup with a round lip and a foot ring."""
    foot, lip = bottom / 2, top / 2
    rim = _arc(lip - wall / 2, height - wall / 2, wall / 2, 0, 180, 9)
    profile = [(0, 2.5), (foot - 9, 2.5), (foot - 7, 0), (foot - 3, 0), (foot, 3)]
    profile += [*rim, (foot - wall, wall + 6), (foot - wall - 6, wall + 2)]
    return revolved([*profile, (0, wall + 2)])


def _handle(x: float, z: float, out: float, up: float, radius: float) -> Mesh:
    """Half an ellipse of tube, its ends inside the wall at x."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 33)
    path = np.column_stack([x + out * np.cos(angle), 0 * angle, z + up * np.sin(angle)])
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    upward = np.cross(along, side)
    around = np.arange(24) * (2 * np.pi / 24)
    cos, sin = radius * np.cos(around), radius * np.sin(around)
    wheel = cos[:, None] * side + sin[:, None] * upward[:, None]
    return lofted(path[:, None] + wheel)


def _lying(mesh: Mesh, length: float, radius: float) -> Mesh:
    """Lay a body that stands on z = 0 along x, centred, on z = 0."""
    laid = mesh.copy()
    laid.vertices = mesh.vertices[:, [2, 1, 0]]
    laid.apply_translation((-length / 2, 0, radius))
    laid.invert()
    return laid


def joined(*meshes: Mesh) -> Mesh:
    """Put bodies together; they may overlap."""
    return trimesh().util.concatenate(meshes)


def moved(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
    """Return a copy moved by (x, y, z) mm."""
    copy = mesh.copy()
    copy.apply_translation((x, y, z))
    return copy


def hull(points: ArrayLike) -> Mesh:
    return trimesh().PointCloud(np.asarray(points, float)).convex_hull


def ball_points(centre: ArrayLike, radius: float, n: int = 16) -> Floats:
    """Return points on a ball, (n * (n // 2 + 1), 3), for hulls."""
    polar = np.linspace(0, np.pi, n // 2 + 1)[:, None]
    around = np.arange(n) * (2 * np.pi / n)
    x = np.sin(polar) * np.cos(around)
    y = np.sin(polar) * np.sin(around)
    z = np.cos(polar) + 0 * around
    return np.asarray(centre, float) + radius * np.stack([x, y, z], -1).reshape(-1, 3)


def rounded_hull(corners: ArrayLike, radius: float, n: int = 16) -> Mesh:
    """Return the hull of balls at the corners: a convex body with round edges."""
    balls = [ball_points(corner, radius, n) for corner in np.asarray(corners)]
    return hull(np.concatenate(balls))


def rounded_box(size: ArrayLike, radius: float) -> Mesh:
    """Return a box standing on z = 0, its centre above the origin, edges rounded."""
    half = np.asarray(size, float) / 2
    signs = np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T
    return moved(rounded_hull(signs * (half - radius), radius), z=half[2])


def revolved(profile_rz: ArrayLike, n: int = 96) -> Mesh:
    """Turn a profile (r, z), (n_points, 2), about z; it starts and ends at r = 0."""
    r, z = np.asarray(profile_rz, float).T
    around = np.arange(n) * (2 * np.pi / n)
    x, y = r[:, None] * np.cos(around), r[:, None] * np.sin(around)
    return _stacked(np.stack([x, y], -1), z)


def _stacked(outlines: Floats, z: Floats) -> Mesh:
    """Skin outlines (n_rings, n_around, 2) at heights (n_rings,)."""
    heights = np.broadcast_to(z[:, None, None], (*outlines.shape[:2], 1))
    return lofted(np.concatenate([outlines, heights], -1))


def lofted(rings: ArrayLike) -> Mesh:
    """Skin closed rings, (n_rings, n_around, 3), and close both ends with fans."""
    skin = np.asarray(rings, float)
    n_rings, n, _ = skin.shape
    this = np.arange(n_rings * n).reshape(n_rings, n)
    right = np.roll(this, -1, axis=1)
    a, b, c, d = this[:-1], right[:-1], right[1:], this[1:]
    sides = [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    first, last = n_rings * n, n_rings * n + 1
    bottom = np.stack([np.full(n, first), right[0], this[0]], -1)
    top = np.stack([np.full(n, last), this[-1], right[-1]], -1)
    ends = skin[[0, -1]].mean(axis=1)
    vertices = np.concatenate([skin.reshape(-1, 3), ends])
    mesh = trimesh().Trimesh(vertices, np.concatenate([*sides, bottom, top]))
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    if mesh.volume < 0:
        mesh.invert()
    return mesh


_UPSIDE = turned((1, 0, 0), 180.0)
_ON_SIDE = turned((1, 0, 0), 90.0)
_ON_END = turned((0, 1, 0), 90.0)

HOUSEHOLD = (
    SimObject("stapler", "stapler", stapler),
    SimObject("toothbrush", "toothbrush", toothbrush),
    SimObject("porridge pot", "pot", porridge_pot, (_UPSIDE,)),
    SimObject("mug", "mug", mug, (_UPSIDE,)),
    SimObject("shampoo bottle", "bottle", shampoo_bottle, (_UPSIDE,)),
    SimObject("box", "box", box, (_ON_SIDE, _ON_END)),
    SimObject("pen", "pen", pen),
    SimObject("ball", "ball", ball, (_ON_SIDE,)),
    SimObject("textbook", "book", textbook, (_UPSIDE,)),
    SimObject("water bottle", "bottle", water_bottle),
)

# What the papers used, and what resembles none of it, by what the sets are called.
_SETS = {
    "household": HOUSEHOLD,
    "unseen": (
        SimObject("plastic card", "card", plastic_card, (_UPSIDE,)),
        SimObject("other mug", "mug", other_mug, (_UPSIDE,)),
        SimObject("other pen", "pen", other_pen),
        SimObject("smaller ball", "ball", smaller_ball),
        SimObject("soft textbook", "book", soft_textbook),
    ),
    "unlike others": (SimObject("massage ball", "massage ball", massage_ball),),
    "shapes": (
        SimObject("corner", "corner", _corner),
        SimObject("cylinder", "cylinder", _cylinder),
        SimObject("edge", "edge", _edge),
        SimObject("flat-to-edge", "flat-to-edge", partial(_block, (60, 80, 30), 30)),
        SimObject("flat", "flat", partial(_block, (80, 80, 30), 0)),
        SimObject("nothing", "nothing", joined),
        SimObject("point", "point", _point),
    ),
}
