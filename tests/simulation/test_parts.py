"""The twelve parts of Liu et al. (2014), Table 1, against their drawings."""

from math import pi, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shapely.geometry import Polygon

from palpate.simulation import Part, find_parts

PARTS = find_parts()

SQUARE = [(0, 0), (2, 0), (2, 2), (0, 2)]
HEXAGON_10 = sqrt(3) / 2 * 10**2  # area of a hexagon 10 mm across flats
HEXAGON_13 = sqrt(3) / 2 * 13**2

# (area in mm², widest along x, along y, hollow, symmetry)
TABLE_1 = [
    (40, 10, 4, False, 2),
    (140, 35, 4, False, 2),
    (HEXAGON_13 - 16 * pi, 26 / sqrt(3), 13, True, 6),
    (HEXAGON_13, 26 / sqrt(3), 13, False, 6),
    (HEXAGON_10 - 9 * pi, 20 / sqrt(3), 10, True, 6),
    (HEXAGON_10, 20 / sqrt(3), 10, False, 6),
    (169 - 16 * pi, 13, 13, True, 4),
    (169, 13, 13, False, 4),
    (100 - 9 * pi, 10, 10, True, 4),
    (100, 10, 10, False, 4),
    (pi * 6.5**2 - 16 * pi, 13, 13, True, 0),
    (pi * 6.5**2, 13, 13, False, 0),
]


@pytest.mark.parametrize(("number", "row"), list(enumerate(TABLE_1, 1)))
def test_part_is_as_the_table_says(number, row):
    part = PARTS[number - 1]
    area, along_x, along_y, hollow, symmetry = row
    assert part.number == number
    assert (part.hollow, part.symmetry) == (hollow, symmetry)
    # Circles are polygons of 96 corners with the circle's area.
    assert_allclose(part.area_mm2, area, rtol=1e-9)
    extent = np.ptp(part.outline_mm, axis=0)
    # Such a polygon is wider than its circle by a thousandth.
    assert_allclose(extent, (along_x, along_y), rtol=1e-3)


def test_there_are_twelve_parts_of_twelve_names():
    assert len({part.name for part in PARTS}) == len(PARTS) == 12


@pytest.mark.parametrize(
    "part", [part for part in PARTS if part.symmetry], ids=lambda part: part.name
)
def test_a_period_brings_the_outline_onto_itself_and_half_does_not(part):
    def overlap(angle_deg):
        turned = Polygon(part.placed(0, 0, angle_deg)[0])
        still = Polygon(part.outline_mm)
        return still.intersection(turned).area / still.area

    assert overlap(part.period_deg) == pytest.approx(1, abs=1e-12)
    assert overlap(part.period_deg / 2) < 0.98


def test_a_disc_has_no_period():
    assert find_parts("disc13")[0].period_deg == 0


def test_placing_turns_x_towards_y_then_moves():
    part = Part("triangle", [(1, 0), (0, 0), (0, 3)])
    (outline,) = part.placed(10, 20, 90)
    assert_allclose(outline, [(10, 21), (10, 20), (7, 20)], atol=1e-14)


def test_from_polygon_centres_the_face_without_its_hole():
    hole = [(2.0, 0.5), (3.0, 0.5), (3.0, 1.5), (2.0, 1.5)]
    face = Polygon([(0, 0), (4, 0), (4, 2), (0, 2)], [hole])
    part = Part.from_polygon("plate", face, symmetry=1)
    polygon = Polygon(part.outline_mm, part.holes_mm)
    assert_allclose(polygon.centroid.coords[0], (0, 0), atol=1e-14)
    assert part.area_mm2 == pytest.approx(7)
    assert part.hollow


def test_from_polygon_takes_corners_in_either_order_closed_or_not():
    closed = [*SQUARE, SQUARE[0]]
    for corners in (SQUARE, SQUARE[::-1], closed):
        part = Part.from_polygon("square", corners)
        assert len(part.outline_mm) == 4
        assert_allclose(np.abs(part.outline_mm), 1)


def test_parts_are_found_by_name_number_or_themselves():
    assert find_parts("bar35") == [PARTS[1]]
    assert find_parts([12, "bar10", PARTS[3]]) == [PARTS[11], PARTS[0], PARTS[3]]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ("bolt", "among bar10, bar35, hexagon13-hole8.*got 'bolt'"),
        (13, "numbers from 1 to 12"),
        (1.5, "numbers from 1 to 12.*got 1.5"),
        ([], "at least one part, got none"),
        (["bar10", 1, "bar10"], "names of their own, got 'bar10' twice"),
    ],
)
def test_unknown_parts_are_refused(wanted, message):
    with pytest.raises(ValueError, match=message):
        find_parts(wanted)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"outline_mm": [(0, 0), (1, 1)]}, "three corners or more, got 2"),
        ({"outline_mm": [(0, 0), (1, 1), (2, 2)]}, "enclose an area"),
        ({"outline_mm": [0, 1, 2]}, r"shape \(n_vertices, 2\), got \(3,\)"),
        ({"outline_mm": [(0, 0), (1, 0), (0, np.nan)]}, "finite"),
        ({"holes_mm": [[(1, 1), (3, 1), (1, 3)]]}, "inside the outline"),
        ({"symmetry": -1}, "symmetry must be at least 0"),
    ],
)
def test_bad_outlines_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        Part("bad", **{"outline_mm": SQUARE, **fields})


def test_a_part_needs_a_name():
    with pytest.raises(TypeError, match="name must be a text"):
        Part("", SQUARE)
