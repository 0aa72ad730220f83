"""Area and edge variance against closed forms and a slow reference."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.encodings import ShapeGeometry


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
    expected = [slow_reference(shape) for shape in shapes]
    assert_allclose(ShapeGeometry().fit_transform(shapes), expected)


def test_a_square_of_three_pixels_in_closed_form():
    image = np.zeros((1, 9, 9))
    image[0, 2:5, 4:7] = 255
    # Four edge points at distance 1 and four at sqrt(2).
    expected = [9, ((np.sqrt(2) - 1) / 2) ** 2]
    assert_allclose(ShapeGeometry().fit_transform(image), [expected])


def test_the_inner_edge_of_a_ring_is_what_varies():
    hollow = ring(10.7, 6.6)  # a disc of 13 mm with a hole of 8 mm, 33 pixels on 20 mm
    all_edges = ShapeGeometry().fit_transform(hollow)[0, 1]
    outer = ShapeGeometry(edges="outer").fit_transform(hollow)[0, 1]
    # Rings of pixels at 10.3 and 7.0 in shares of 0.6 and 0.4: 0.24 x 3.3^2 = 2.6.
    assert outer < 0.2
    assert 2 < all_edges < 3


@pytest.mark.parametrize("edges", ["all", "outer"])
def test_without_holes_all_edges_are_outer(edges):
    disc = ring(9.3, -1)
    assert_array_equal(
        ShapeGeometry(edges).fit_transform(disc), ShapeGeometry().fit_transform(disc)
    )


def test_outer_edge_ignores_what_the_hole_contains():
    hollow = ring(12, 6)
    island = hollow | ring(2, -1)
    rim = ShapeGeometry(edges="outer")
    assert rim.fit_transform(island)[0, 1] == rim.fit_transform(hollow)[0, 1]


@pytest.mark.parametrize("edges", ["all", "outer"])
def test_place_and_quarter_turns_do_not_matter(edges, shapes):
    encoder = ShapeGeometry(edges).fit(shapes)
    expected = encoder.transform(shapes)
    moved = np.roll(shapes, (2, -3), axis=(1, 2))
    for same in (moved, np.rot90(shapes, axes=(1, 2)), shapes[:, ::-1]):
        assert_allclose(encoder.transform(same), expected, atol=1e-12)


def test_empty_and_full_images_are_defined():
    images = np.stack([np.zeros((5, 5)), np.ones((5, 5))])
    features = ShapeGeometry().fit_transform(images)
    assert_array_equal(features[0], [0, 0])
    assert features[1, 0] == 25
    assert features[1, 1] == pytest.approx(slow_reference(images[1])[1])


def test_one_touch_does_not_change_another(shapes):
    encoder = ShapeGeometry(edges="outer").fit(shapes)
    alone = np.vstack([encoder.transform(shape[np.newaxis]) for shape in shapes])
    assert_array_equal(alone, encoder.transform(shapes))


def test_columns_have_names_and_options_are_listed(shapes):
    encoder = ShapeGeometry().fit(shapes)
    assert list(encoder.get_feature_names_out()) == ["area", "edge_variance"]
    with pytest.raises(ValueError, match="edges must be one of 'all', 'outer'"):
        ShapeGeometry(edges="inner").fit(shapes)
