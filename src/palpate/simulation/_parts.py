"""Flat parts to press on a pressure array: outlines with holes, in millimetres.

`PARTS` are the twelve metal parts of Liu et al. (2014), Table 1, in its order:
two bars, and hexagons, squares and discs, each with and without a round hole
(discs of one size only). The table leaves the bars' width out; 4 mm is a guess.

Coordinates are (x, y): x along the columns of the image, y along its rows
(downwards), the origin at the middle of the part. A part at angle 0 has a flat
side along x; angles turn x towards y, clockwise as displayed.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_count
from .._types import Array, Floats

BAR_WIDTH_MM = 4.0
_CIRCLE_VERTICES = 96


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid flat part: one outline, any number of holes.

    Parameters
    ----------
    name : str
        What the part is called in touches.
    outline_mm : array-like of shape (n_vertices, 2)
        Corners (x, y) of the outer edge, in order, not closed.
    holes_mm : sequence of array-like of shape (n_vertices, 2), default=()
        Corners of each hole.
    symmetry : int, default=1
        In how many turns of a full circle the part looks the same; 0 when every
        turn does (a disc), so that its angle means nothing.
    category : str, default="part"
        The kind of part.
    number : int, default=0
        Its number in a table; 0 for none.

    Raises
    ------
    ValueError
        When a loop has under three corners, no area, or is not finite, or when a
        hole reaches outside the outline's bounding box.
    """

    name: str
    outline_mm: Floats
    holes_mm: tuple[Floats, ...] = ()
    symmetry: int = 1
    category: str = "part"
    number: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise TypeError(f"name must be a text, got {self.name!r}.")
        check_count("symmetry", self.symmetry, at_least=0)
        check_count("number", self.number, at_least=0)
        outline = _loop("outline_mm", self.outline_mm)
        holes = tuple(_loop("holes_mm", hole) for hole in self.holes_mm)
        low, high = outline.min(axis=0), outline.max(axis=0)
        for hole in holes:
            if (hole < low).any() or (hole > high).any():
                raise ValueError(
                    f"holes_mm must lie inside the outline, from {low} to {high} mm, "
                    f"got a hole from {hole.min(axis=0)} to {hole.max(axis=0)} mm."
                )
        object.__setattr__(self, "outline_mm", outline)
        object.__setattr__(self, "holes_mm", holes)

    @classmethod
    def from_polygon(cls, name: str, polygon: Any, **fields: Any) -> Self:
        """Make a part of any polygon, moved so that its area's centroid is (0, 0).

        Parameters
        ----------
        name : str
            What to call it.
        polygon : array-like of shape (n_vertices, 2), or a polygon
            Corners in mm; or an object with `exterior` and `interiors` as
            shapely's polygons have them, whose holes are kept.
        **fields
            `symmetry`, `category`, `number`, and `holes_mm` with an array.
        """
        holes = fields.pop("holes_mm", ())
        outline = polygon
        if hasattr(polygon, "exterior"):
            outline = polygon.exterior.coords
            holes = [ring.coords for ring in polygon.interiors]
        loops = [_loop("polygon", outline), *(_loop("holes_mm", h) for h in holes)]
        area, moment = 0.0, np.zeros(2)
        for index, loop in enumerate(loops):
            after = np.roll(loop, -1, axis=0)
            cross = loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0]
            sign = np.sign(cross.sum()) * (1 if index == 0 else -1)
            area += sign * cross.sum() / 2
            moment += sign * (cross @ (loop + after)) / 6
        moved = [loop - moment / area for loop in loops]
        return cls(name, moved[0], tuple(moved[1:]), **fields)

    @property
    def hollow(self) -> bool:
        """Whether the part has a hole."""
        return bool(self.holes_mm)

    @property
    def area_mm2(self) -> float:
        """Area of the face, holes taken off, in mm²."""
        holes = sum(abs(_signed_area(hole)) for hole in self.holes_mm)
        return abs(_signed_area(self.outline_mm)) - holes

    @property
    def period_deg(self) -> float:
        """Smallest turn that brings the part onto itself; 0 when every turn does."""
        return 360.0 / self.symmetry if self.symmetry else 0.0

    def placed(self, x_mm: float, y_mm: float, angle_deg: float) -> list[Floats]:
        """Return outline and holes turned about the origin, then moved, in mm."""
        angle = np.deg2rad(angle_deg)
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, sin], [-sin, cos]])
        loops = (self.outline_mm, *self.holes_mm)
        return [loop @ turn + (x_mm, y_mm) for loop in loops]


def find_parts(
    parts: Iterable[Part | str | int] | Part | str | int | None = None,
) -> list[Part]:
    """Return parts, by default the twelve, or those of such names or numbers.

    Raises
    ------
    ValueError
        For a name or number that is not among `PARTS`, for none at all, or for two of
        one name, whose presses would be taken for those of one.
    """
    if parts is None:
        return [*PARTS]
    if isinstance(parts, str) or not isinstance(parts, Iterable):
        parts = [parts]
    requested = list(parts)
    if not requested:
        raise ValueError("parts must name at least one part, got none.")
    resolved = []
    for item in requested:
        matches = [p for p in PARTS if item in (p, p.name, p.number)]
        if not matches and not isinstance(item, Part):
            raise ValueError(
                f"parts must be Part objects, numbers from 1 to {len(PARTS)}, or names "
                f"among {', '.join(part.name for part in PARTS)}, got {item!r}."
            )
        resolved += [item] if isinstance(item, Part) else matches[:1]
    names = [part.name for part in resolved]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(
            f"parts must have names of their own, got {twice[0]!r} twice. Leave one "
            "out, or ask for more presses of each."
        )
    return resolved


def _loop(name: str, corners: ArrayLike) -> Floats:
    loop = np.array(corners, dtype=np.float64)
    if loop.ndim != 2 or loop.shape[1] != 2:
        raise ValueError(
            f"{name} must have shape (n_vertices, 2), got {loop.shape}. "
            "Give one (x, y) in mm per corner."
        )
    if len(loop) > 1 and (loop[0] == loop[-1]).all():
        loop = loop[:-1]
    if len(loop) < 3:
        raise ValueError(f"{name} must have three corners or more, got {len(loop)}.")
    if not np.isfinite(loop).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity.")
    if abs(_signed_area(loop)) == 0:
        raise ValueError(f"{name} must enclose an area, got a line.")
    loop.flags.writeable = False
    return loop


def _signed_area(loop: Floats) -> float:
    x, y = loop.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _rectangle(length_mm: float, width_mm: float) -> Floats:
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(signs * (length_mm / 2, width_mm / 2))


def _on_circle(radius_mm: float, angle: Array) -> Floats:
    return np.asarray(radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _circle(diameter_mm: float) -> Floats:
    """Return the regular polygon of the circle's own area."""
    step = 2 * np.pi / _CIRCLE_VERTICES
    radius = diameter_mm / 2 * np.sqrt(step / np.sin(step))
    return _on_circle(radius, step * np.arange(_CIRCLE_VERTICES))


def _table_1() -> tuple[Part, ...]:
    """Build the twelve parts: (shape, size in mm, hole's diameter in mm)."""
    parts = [
        Part(f"bar{length}", _rectangle(length, BAR_WIDTH_MM), (), 2, "bar", number)
        for number, length in enumerate((10, 35), start=1)
    ]
    rows = [("hexagon", 13, 8), ("hexagon", 10, 6), ("square", 13, 8)]
    rows += [("square", 10, 6), ("disc", 13, 8)]
    for shape, size, hole in rows:
        outline, symmetry = _circle(size), 0  # in how many turns it looks the same
        if shape == "hexagon":
            corner = np.deg2rad(60 * np.arange(6))
            outline, symmetry = _on_circle(size / np.sqrt(3), corner), 6
        elif shape == "square":
            outline, symmetry = _rectangle(size, size), 4
        for suffix, holes in ((f"-hole{hole}", (_circle(hole),)), ("", ())):
            name, number = f"{shape}{size}{suffix}", len(parts) + 1
            parts.append(Part(name, outline, holes, symmetry, shape, number))
    return tuple(parts)


PARTS: tuple[Part, ...] = _table_1()
