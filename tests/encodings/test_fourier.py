"""Fourier descriptors, area and edge variance: analytic curves, invariances."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.encodings import FourierDescriptors, ShapeGeometry


@pytest.fixture
def hexagon():
    return draw_hexagon(33, 10.0)


def draw_hexagon(size, radius):
    row, col = np.indices((size, size)) - (size - 1) / 2
    flats = [np.cos(a) * col + np.sin(a) * row for a in np.deg2rad([17, 77, 137])]
    return (np.abs(flats).max(axis=0) <= radius * np.sqrt(3) / 2)[np.newaxis]


def draw_ellipse(size, across, down):
    row, col = np.indices((size, size)) - (size - 1) / 2
    return ((row / down) ** 2 + (col / across) ** 2 <= 1)[np.newaxis]


def walk(image):
    """(column, row) of the outer boundary, by OpenCV."""
    contours = cv2.findContours(
        image.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    (outline,) = contours[0]
    return outline[:, 0].astype(float)


def length(image):
    """Points along the outline: s[L - 1] = s[1] is the last that is not 0."""
    (s,) = FourierDescriptors(n=image.size).fit_transform(image[np.newaxis])
    return int(np.flatnonzero(s > 0.5)[-1]) + 2


def with_loops(outline):
    """s[1] to s[L - 1], as the paper writes them."""
    x, y = np.asarray(outline, float).T
    m = np.arange(1, len(x) + 1)
    r = []
    for n in range(1, len(x)):
        wave = np.exp(-2j * np.pi * n * m / len(x))
        a, b = (x * wave).sum() / len(x), (y * wave).sum() / len(x)
        r.append(np.sqrt(abs(a) ** 2 + abs(b) ** 2))
    return np.array(r) / r[0]


@pytest.mark.parametrize(
    "image",
    [draw_hexagon(33, 10.0), draw_ellipse(41, 18, 7), draw_ellipse(85, 2, 40)],
    ids=["hexagon", "ellipse", "narrow"],
)
def test_descriptors_are_the_equations_of_the_paper(image):
    outline = walk(image[0])
    encoded = FourierDescriptors(n=len(outline) - 1).fit_transform(image)[0]
    assert_allclose(encoded, with_loops(outline), atol=1e-12)


def test_the_constant_term_does_not_enter(hexagon):
    n_points = len(walk(hexagon[0]))
    s = FourierDescriptors(n=n_points + 5).fit_transform(hexagon)[0]
    assert_array_equal(s[n_points - 1 :], 0)
    assert s[n_points - 2] == pytest.approx(1)  # s[L - 1] = s[1]


@pytest.mark.parametrize(
    ("encoder", "tolerance"),
    [
        (FourierDescriptors(), 1e-12),
        # Resampling starts where the walk starts, which shifts points by a fraction.
        (FourierDescriptors(resample=64), 3e-3),
        (ShapeGeometry(), 1e-12),
        (ShapeGeometry("outer"), 1e-12),
    ],
    ids=repr,
)
def test_place_turn_and_mirror_do_not_matter(encoder, tolerance, hexagon):
    hexagon[0, 14:19, 14:18] = False
    expected = encoder.fit_transform(hexagon)
    moved = np.roll(hexagon, (3, -4), axis=(1, 2))
    for same in (moved, np.rot90(hexagon, axes=(1, 2)), hexagon[:, ::-1]):
        assert_allclose(encoder.transform(same), expected, atol=tolerance)


def test_resampled_descriptors_are_free_of_scale():
    small, large = draw_hexagon(200, 30.0), draw_hexagon(200, 90.0)
    free = FourierDescriptors(n=20, resample=128).fit(small)
    # What is left is the staircase of the pixels, finer on the large hexagon.
    assert_allclose(free.transform(large), free.transform(small), atol=0.02)


def evenly(outline, n_points):
    """Points one by one, each so far along the closed outline."""
    ends = [*outline[1:], outline[0]]
    sides = [np.hypot(*(end - start)) for start, end in zip(outline, ends, strict=True)]
    points = []
    for k in range(n_points):
        remaining, side = k * sum(sides) / n_points, 0
        while remaining > sides[side]:
            remaining, side = remaining - sides[side], side + 1
        share = remaining / sides[side]
        points.append((1 - share) * outline[side] + share * ends[side])
    return np.array(points)


@pytest.mark.parametrize(
    ("image", "n_points"),
    [
        # Steps of 1 along two sides, of the root of 2 along the third.
        pytest.param(np.tri(5), 8, id="triangle"),
        pytest.param(np.tri(5), 11, id="triangle of 11"),
        pytest.param(np.pad(np.ones((3, 3)), 1), 8, id="pixels that are even"),
    ],
)
def test_resampling_is_even_along_the_outline(image, n_points):
    encoder = FourierDescriptors(n=n_points - 1, resample=n_points)
    (s,) = encoder.fit_transform(image[np.newaxis])
    assert_allclose(s, with_loops(evenly(walk(image), n_points)), atol=1e-12)


@pytest.mark.parametrize("resample", [None, 32])
@pytest.mark.parametrize("pixels", [[], [(4, 4)], [(4, 4), (4, 5)], [(4, 4), (5, 5)]])
def test_dots_and_nothing_are_zeros(pixels, resample):
    image = np.zeros((1, 9, 9))
    for pixel in pixels:
        image[(0, *pixel)] = 1
    assert_array_equal(
        FourierDescriptors(n=7, resample=resample).fit_transform(image),
        np.zeros((1, 7)),
    )


def test_a_line_is_walked_there_and_back():
    line = np.zeros((1, 9, 9))
    line[0, 4, 2:7] = 1
    assert length(line[0]) == 8
    s = FourierDescriptors(n=8).fit_transform(line)
    assert np.isfinite(s).all()
    assert s[0, 0] == 1


def test_holes_and_fragments_do_not_count(hexagon):
    hollow, fragmented = hexagon.copy(), hexagon.copy()
    hollow[0, 14:19, 14:19] = False
    fragmented[0, :3, :3] = True
    inside = hollow.copy()
    inside[0, 16, 16] = True
    encoder = FourierDescriptors().fit(hexagon)
    for same in (hollow, fragmented, inside):
        assert_array_equal(encoder.transform(same), encoder.transform(hexagon))


@pytest.mark.parametrize("down", range(4))
def test_of_equal_fragments_the_first_row_by_row_counts(down):
    """Wherever they lie: OpenCV numbers fragments by blocks of two rows."""
    line, corner = np.zeros((2, 12, 12), dtype=bool)
    line[down + 2, 1:4] = True
    corner[down + 1, 7:9] = corner[down + 2, 8] = True
    outline = FourierDescriptors.outline(line | corner)
    assert_array_equal(outline, FourierDescriptors.outline(corner))


def test_diagonal_neighbours_are_one_component():
    image = np.zeros((9, 9), dtype=bool)
    image[1:4, 1:4] = image[4:7, 4:7] = True
    assert length(image) == 18  # the two pixels that touch are passed twice


def test_a_shape_cut_by_the_border_is_closed_there():
    top = [(col, 0) for col in range(7)]
    right = [(7, row) for row in range(5)]
    bottom = [(col, 5) for col in range(7, 0, -1)]
    left = [(0, row) for row in range(5, 0, -1)]
    (s,) = FourierDescriptors(n=23).fit_transform(np.ones((1, 6, 8)))
    assert length(np.ones((6, 8))) == 24
    assert_allclose(s, with_loops(top + right + bottom + left), atol=1e-12)


@pytest.fixture
def shapes(rng):
    """Random blobs with holes and fragments, away from the border of the image."""
    noise = rng.random((8, 21, 21)) > 0.4
    noise[:, :3] = noise[:, -3:] = noise[:, :, :3] = noise[:, :, -3:] = False
    return noise


def ring(outer_px, inner_px, size=33):
    row, col = np.indices((size, size)) - (size - 1) / 2
    radius = np.hypot(row, col)
    return ((radius <= outer_px) & (radius > inner_px))[np.newaxis]


def slow_reference(shape):
    """Area and variance with loops, straight from the words of the definition."""
    rows, cols = np.nonzero(shape)
    if not len(rows):
        return 0, 0
    padded = np.pad(shape, 1)
    distances = []
    for row, col in zip(rows, cols, strict=True):
        around = [
            (row, col + 1),
            (row + 2, col + 1),
            (row + 1, col),
            (row + 1, col + 2),
        ]
        if not all(padded[place] for place in around):
            distances.append(np.hypot(row - rows.mean(), col - cols.mean()))
    return len(rows), np.var(distances)


def test_agrees_with_the_slow_reference(shapes):
    shapes[:2] = np.reshape([False, True], (2, 1, 1))  # empty and full
    expected = [slow_reference(shape) for shape in shapes]
    assert_allclose(ShapeGeometry().fit_transform(shapes), expected)


def test_the_inner_edge_of_a_ring_is_what_varies():
    hollow = ring(10.7, 6.6)  # a disc of 13 mm with a hole of 8 mm, 33 pixels on 20 mm
    all_edges = ShapeGeometry().fit_transform(hollow)[0, 1]
    outer = ShapeGeometry(edges="outer").fit_transform(hollow)[0, 1]
    # Rings of pixels at 10.3 and 7.0 in shares of 0.6 and 0.4: 0.24 x 3.3^2 = 2.6.
    assert outer < 0.2
    assert 2 < all_edges < 3


def test_without_holes_all_edges_are_outer():
    disc = ring(9.3, -1)
    outer = ShapeGeometry("outer").fit_transform(disc)
    assert_array_equal(outer, ShapeGeometry().fit_transform(disc))


def test_outer_edge_ignores_what_the_hole_contains():
    hollow = ring(12, 6)
    island = hollow | ring(2, -1)
    rim = ShapeGeometry(edges="outer")
    assert rim.fit_transform(island)[0, 1] == rim.fit_transform(hollow)[0, 1]


def test_columns_have_names(shapes):
    descriptors = FourierDescriptors(n=2).fit(shapes)
    assert list(descriptors.get_feature_names_out()) == ["fourier1", "fourier2"]
    encoder = ShapeGeometry().fit(shapes)
    assert list(encoder.get_feature_names_out()) == ["area", "edge_variance"]
