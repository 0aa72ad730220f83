"""Fourier descriptors against analytic curves and their invariances."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from palpate.encodings import FourierDescriptors
from palpate.encodings._fourier import _descriptors, _resample, outer_boundary


@pytest.fixture
def hexagon():
    return draw_hexagon(33, 10.0)


def draw_hexagon(size, radius):
    row, col = np.indices((size, size)) - (size - 1) / 2
    flats = [np.cos(a) * col + np.sin(a) * row for a in np.deg2rad([17, 77, 137])]
    return (np.abs(flats).max(axis=0) <= radius * np.sqrt(3) / 2)[np.newaxis]


def test_equations_of_the_paper_with_loops(hexagon):
    x, y = outer_boundary(hexagon[0]).T
    length = len(x)
    m = np.arange(1, length + 1)
    r = []
    for n in range(1, length):
        wave = np.exp(-2j * np.pi * n * m / length)
        a, b = (x * wave).sum() / length, (y * wave).sum() / length
        r.append(np.sqrt(abs(a) ** 2 + abs(b) ** 2))
    encoded = FourierDescriptors(n=length - 1).fit_transform(hexagon)[0]
    assert_allclose(encoded, np.array(r) / r[0], atol=1e-12)


@pytest.mark.parametrize(("a", "b"), [(5, 5), (7, 3), (1, 40)])
def test_an_ellipse_has_two_waves_only(a, b):
    t = 2 * np.pi * np.arange(50) / 50
    s = _descriptors(np.column_stack([9 + a * np.cos(t), 4 - b * np.sin(t + 0.3)]))
    expected = np.zeros(49)
    expected[0] = expected[48] = 1
    assert_allclose(s, expected, atol=1e-12)


def test_descriptors_repeat_backwards(hexagon):
    length = len(outer_boundary(hexagon[0]))
    s = FourierDescriptors(n=length - 1).fit_transform(hexagon)[0]
    assert_allclose(s, s[::-1], atol=1e-12)


def test_the_constant_term_does_not_enter(hexagon):
    length = len(outer_boundary(hexagon[0]))
    s = FourierDescriptors(n=length + 5).fit_transform(hexagon)[0]
    assert_array_equal(s[length - 1 :], 0)
    assert s[length - 2] == pytest.approx(1)  # s[L - 1] = s[1]


# Resampling starts where the walk starts, which shifts the points by a fraction.
@pytest.mark.parametrize(("resample", "tolerance"), [(None, 1e-12), (64, 3e-3)])
def test_place_turn_and_mirror_do_not_matter(resample, tolerance, hexagon):
    encoder = FourierDescriptors(resample=resample).fit(hexagon)
    expected = encoder.transform(hexagon)
    moved = np.roll(hexagon, (3, -4), axis=(1, 2))
    for same in (moved, np.rot90(hexagon, axes=(1, 2)), hexagon[:, ::-1]):
        assert_allclose(encoder.transform(same), expected, atol=tolerance)


def test_resampled_descriptors_are_free_of_scale():
    small, large = draw_hexagon(200, 30.0), draw_hexagon(200, 90.0)
    free = FourierDescriptors(n=20, resample=128).fit(small)
    # What is left is the staircase of the pixels, finer on the large hexagon.
    assert_allclose(free.transform(large), free.transform(small), atol=0.02)


def test_padding_tells_the_length_of_the_outline():
    shapes = np.concatenate([draw_hexagon(33, 4.0), draw_hexagon(33, 6.0)])
    lengths = [len(outer_boundary(shape)) for shape in shapes]
    assert lengths[0] < lengths[1] < 40
    encoded = FourierDescriptors().fit_transform(shapes)
    last = [np.flatnonzero(s > 0.5)[-1] + 1 for s in encoded]
    assert last == [lengths[0] - 1, lengths[1] - 1]  # s[L - 1] = s[1] = 1


def test_resampling_is_even_along_the_outline():
    square = np.array([[0.0, 0], [1, 0], [2, 0], [2, 2], [0, 2]])
    points = _resample(square, 8)
    expected = [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]]
    assert_allclose(points, expected, atol=1e-12)


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
    assert len(outer_boundary(line[0] > 0)) == 8
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


def test_diagonal_neighbours_are_one_component():
    image = np.zeros((9, 9), dtype=bool)
    image[1:4, 1:4] = image[4:7, 4:7] = True
    boundary = outer_boundary(image)
    assert len(np.unique(boundary, axis=0)) == 16
    assert len(boundary) == 18  # the two pixels that touch are passed twice


def test_a_shape_cut_by_the_border_is_closed_there():
    full = outer_boundary(np.ones((6, 8), dtype=bool))
    assert len(full) == 24
    steps = np.abs(np.diff(np.vstack([full, full[:1]]), axis=0))
    assert steps.max() == 1


@pytest.mark.parametrize(
    ("params", "error", "message"),
    [
        ({"n": 0}, ValueError, "n must be at least 1"),
        ({"n": 2.5}, TypeError, "n must be an integer"),
        ({"resample": 2}, ValueError, "resample must be at least 3"),
    ],
)
def test_bad_parameters_are_refused_at_fit(params, error, message, hexagon):
    with pytest.raises(error, match=message):
        FourierDescriptors(**params).fit(hexagon)


def test_keeps_the_rules_of_estimators(hexagon):
    encoder = FourierDescriptors(n=3).fit(hexagon)
    assert list(encoder.get_feature_names_out()) == ["fourier1", "fourier2", "fourier3"]
    again = pickle.loads(pickle.dumps(encoder))
    assert_array_equal(again.transform(hexagon), encoder.transform(hexagon))
    with pytest.raises(NotFittedError):
        clone(encoder).transform(hexagon)
    with pytest.raises(ValueError, match="fitted on 33 x 33"):
        encoder.transform(hexagon[:, :8])
