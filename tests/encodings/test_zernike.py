"""Zernike moments against facts known without the code."""

from fractions import Fraction
from functools import cache, partial
from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import dblquad
from scipy.ndimage import affine_transform
from scipy.special import eval_jacobi

from palpate.encodings import ZernikeMoments

METHODS = pytest.mark.parametrize("method", ["exact", "sample"])


def coordinates(size, row=None, col=None, radius=None):
    """x, y of taxel centres in radii of the disc, inscribed by default."""
    middle, radius = (size - 1) / 2, radius or size / 2
    x = (np.arange(size) - (middle if col is None else col)) / radius
    y = (np.arange(size) - (middle if row is None else row)) / radius
    return np.broadcast_to(x, (size, size)), np.broadcast_to(y[:, None], (size, size))


def smooth(x, y, angle=0.0):
    """A sum of broad bumps, turned by `angle` from x towards y."""
    rng = np.random.default_rng(3)
    along = np.cos(angle) * x + np.sin(angle) * y
    across = np.cos(angle) * y - np.sin(angle) * x
    bumps = zip(
        rng.uniform(-1, 1, 8),
        rng.uniform(-0.6, 0.6, (8, 2)),
        rng.uniform(0.2, 0.4, 8),
        strict=True,
    )
    return sum(
        a * np.exp(-((along - u) ** 2 + (across - v) ** 2) / (2 * w**2))
        for a, (u, v), w in bumps
    )


def moments(image, order=8, **options):
    """The complex moments of one image as {(n, m): moment}."""
    encoder = ZernikeMoments(order, output="complex", **options)
    values = encoder.fit_transform(image[np.newaxis])[0]
    return dict(zip(map(tuple, encoder.indices_.tolist()), values, strict=True))


def polynomial(n, m, x, y):
    """V(n, m) as a Jacobi polynomial, by way of the radius and the angle."""
    r, k = np.hypot(x, y), (n - abs(m)) // 2
    radial = (-1) ** k * r ** abs(m) * eval_jacobi(k, abs(m), 0, 1 - 2 * r**2)
    return radial * np.exp(1j * m * np.arctan2(y, x))


def values_at(order, x, y, radius):
    """{(n, m): V at places x, y}, which are taxels: of one alone it is the moment."""
    encoder = ZernikeMoments(
        order, method="sample", output="complex", weight="none", radius=radius
    )
    side = 2 * radius + 1
    images = np.zeros((len(x), side, side))
    col, row = np.rint(radius * np.stack([x, y]) + radius).astype(int)
    images[np.arange(len(x)), row, col] = radius**2
    values = encoder.fit_transform(images).conj().T
    return dict(zip(map(tuple, encoder.indices_.tolist()), values, strict=True))


# Closed forms: (image as a function of x and y, its non-zero moments to order 4).
CLOSED_FORMS = [
    pytest.param(lambda x, y: 1 + 0 * x, {(0, 0): 1}, id="1"),
    pytest.param(
        lambda x, y: x**2, {(0, 0): 1 / 4, (2, 0): 1 / 4, (2, 2): 1 / 4}, id="x^2"
    ),
    pytest.param(
        lambda x, y: x**4,
        {
            (0, 0): 1 / 8,
            (2, 0): 3 / 16,
            (2, 2): 3 / 16,
            (4, 0): 1 / 16,
            (4, 2): 1 / 16,
            (4, 4): 1 / 16,
        },
        id="x^4",
    ),
    pytest.param(
        lambda x, y: x * y**2,
        {(1, 1): 1 / 12, (3, 1): 1 / 24, (3, 3): -1 / 8},
        id="x y^2",
    ),
    pytest.param(
        lambda x, y: x**3 * y,
        {(2, 2): -3j / 32, (4, 2): -1j / 32, (4, 4): -1j / 16},
        id="x^3 y",
    ),
]


@pytest.mark.parametrize(
    ("size", "tolerance"),
    # Each taxel counts as constant: second order in its side. Figures as measured
    # beforehand on another implementation.
    [(33, 1.4e-3), (300, 1.8e-5)],
)
@pytest.mark.parametrize(("image", "expected"), CLOSED_FORMS)
def test_moments_have_their_closed_forms(image, expected, size, tolerance):
    encoded = moments(image(*coordinates(size)), order=4)
    assert len(encoded) == 9
    for degree, value in encoded.items():
        assert abs(value - expected.get(degree, 0)) < tolerance, degree


def test_a_smaller_disc_has_its_closed_form():
    # Each taxel holds its mean over 10 x 10 points of the disc r <= 1/2.
    x, y = coordinates(3000)
    fine = x[:1] ** 2 + y[:, :1] ** 2 <= 0.25
    image = fine.reshape(300, 10, 300, 10).mean(axis=(1, 3))
    encoded = moments(image)
    expected = [1 / 4, -9 / 16, 15 / 32, -21 / 256, -135 / 512]
    # The edge is blurred over one taxel, 1/75 of the smaller disc's diameter.
    assert_allclose([encoded[n, 0] for n in range(0, 9, 2)], expected, atol=2e-4)
    assert max(abs(v) for (n, m), v in encoded.items() if m % 4) < 1e-12


@pytest.mark.parametrize(
    ("j", "closed_form"),
    [
        pytest.param(1, lambda r, t: np.ones_like(r), id="piston"),
        pytest.param(2, lambda r, t: 2 * r * np.cos(t), id="tilt-x"),
        pytest.param(3, lambda r, t: 2 * r * np.sin(t), id="tilt-y"),
        pytest.param(4, lambda r, t: np.sqrt(3) * (2 * r**2 - 1), id="defocus"),
        pytest.param(5, lambda r, t: np.sqrt(6) * r**2 * np.sin(2 * t), id="astig"),
        pytest.param(6, lambda r, t: np.sqrt(6) * r**2 * np.cos(2 * t), id="astig-x"),
        pytest.param(
            7, lambda r, t: np.sqrt(8) * (3 * r**3 - 2 * r) * np.sin(t), id="coma-y"
        ),
        pytest.param(
            8, lambda r, t: np.sqrt(8) * (3 * r**3 - 2 * r) * np.cos(t), id="coma-x"
        ),
        pytest.param(
            11,
            lambda r, t: np.sqrt(5) * (6 * r**4 - 6 * r**2 + 1),
            id="spherical",
        ),
        pytest.param(14, lambda r, t: np.sqrt(10) * r**4 * np.cos(4 * t), id="quad"),
        pytest.param(15, lambda r, t: np.sqrt(10) * r**4 * np.sin(4 * t), id="quad-y"),
    ],
)
def test_noll_moments_are_orthonormal(j, closed_form):
    x, y = coordinates(300)
    image = closed_form(np.hypot(x, y), np.arctan2(y, x))
    encoder = ZernikeMoments(4, output="noll", weight="noll")
    encoded = encoder.fit_transform(image[np.newaxis])[0]
    # Second order in the taxel's side, times the polynomial's steep rim.
    assert_allclose(encoded, np.arange(1, 16) == j, atol=2e-4)


@pytest.mark.parametrize("order", range(41))
def test_every_order_agrees_with_a_direct_sum(order, rng):
    image = rng.normal(size=(13, 16))
    encoder = ZernikeMoments(
        order,
        method="sample",
        output="complex",
        centre=(5.8, 7.1),
        radius=6.7,
        repeat_negative=True,
    )
    encoded = encoder.fit_transform(image[np.newaxis])[0]
    row, col = np.mgrid[:13, :16]
    x, y = (col - 7.1) / 6.7, (row - 5.8) / 6.7
    inside = np.hypot(x, y) <= 1
    for (n, m), value in zip(encoder.indices_, encoded, strict=True):
        waves = polynomial(n, m, x, y).conj()
        direct = (image * waves)[inside].sum() * (n + 1) / np.pi / 6.7**2
        # Legendre products lose up to 3e-11 at order 20; the basis above does not.
        assert abs(value - direct) < 1e-10, (n, m)


@pytest.mark.slow
@pytest.mark.parametrize(
    "cells",
    [
        pytest.param([(4, 4)], id="middle"),
        pytest.param([(0, 4), (8, 4), (4, 0)], id="top, bottom, left"),
        pytest.param([(1, 1), (7, 7), (1, 7)], id="corners"),
    ],
)
@pytest.mark.parametrize("order", [6, 22])
def test_exact_moments_of_one_taxel_are_its_part_of_the_disc(cells, order):
    row, col, radius = 4.2, 3.7, 4.4
    for i, j in cells:
        image = np.zeros((9, 9))
        image[i, j] = 1
        encoded = moments(image, order, centre=(row, col), radius=radius, weight="none")
        low, high = np.clip((np.array([i - 0.5, i + 0.5]) - row) / radius, -1, 1)
        left, right = (np.array([j - 0.5, j + 0.5]) - col) / radius
        for n, m in [(0, 0), (3, 1), (6, 4)]:
            # Quadratures of both parts use much the same places.
            value = cache(partial(polynomial, n, m))
            for part in ("real", "imag"):
                integral, _ = dblquad(
                    lambda x, y, value=value, part=part: getattr(
                        value(x, y).conj(), part
                    ),
                    low,
                    high,
                    lambda y, a=left: max(a, -np.sqrt(1 - y * y)),
                    lambda y, a=left, b=right: max(
                        min(b, np.sqrt(1 - y * y)), a, -np.sqrt(1 - y * y)
                    ),
                    epsabs=1e-9,
                )
                # What the adaptive quadrature promises at kinks of the limits.
                assert abs(getattr(encoded[n, m], part) - integral) < 1e-7, (n, m)


@pytest.mark.parametrize("order", [15, 25])
def test_exact_mode_sees_an_image_of_constant_taxels(order, rng):
    # Cutting each taxel into four equal ones leaves that image as it was.
    image = rng.normal(size=(12, 10))
    place = {"centre": (5.1, 4.8), "radius": 5.3}
    finer = {"centre": (2 * 5.1 + 0.5, 2 * 4.8 + 0.5), "radius": 2 * 5.3}
    fine = np.kron(image, np.ones((2, 2)))
    coarse = moments(image, order, **place)
    for degree, value in moments(fine, order, **finer).items():
        # Rounding in the separable method (3e-13), quadrature in the dense one.
        assert abs(value - coarse[degree]) < 1e-11, degree


@METHODS
@pytest.mark.parametrize("order", [0, 1, 8, 15])
def test_separable_method_agrees_with_the_dense_basis(method, order, rng):
    images = rng.normal(size=(3, 40, 33))
    for centre, radius in [((19.5, 16), 16.5), ((20.3, 14.2), 21.9)]:
        place = {"centre": centre, "radius": radius, "method": method}
        options = {"output": "complex", "weight": "none", **place}
        separable = ZernikeMoments(order, **options).fit_transform(images)
        # Above order 20 the basis itself is used, and lists the lower orders first.
        dense = ZernikeMoments(23, **options).fit_transform(images)
        # Noll's digits: 3e-13 are lost at order 15.
        assert_allclose(separable, dense[:, : separable.shape[1]], rtol=0, atol=1e-11)


def test_agrees_with_mahotas(rng):
    features = pytest.importorskip("mahotas.features", reason="mahotas not installed")
    image = rng.uniform(0.1, 1, size=(50, 60))  # mahotas drops what is not positive
    encoder = ZernikeMoments(method="sample", centre=(24.3, 30.6), radius=21.7)
    ours = encoder.fit_transform(image[np.newaxis])[0]
    theirs = features.zernike_moments(image, 21.7, 15, cm=(24.3, 30.6))
    row, col = np.mgrid[:50, :60]
    inside = np.hypot(row - 24.3, col - 30.6) <= 21.7
    # mahotas divides by the sum of the image, we measure areas in squared radii.
    # Its factorial sums lose 5e-12 at order 15.
    assert_allclose(ours, theirs * image[inside].sum() / 21.7**2, atol=1e-10)


def test_agrees_with_centrosome(rng):
    peer = pytest.importorskip("centrosome.zernike", reason="centrosome not installed")
    image = rng.normal(size=(51, 51))
    x, y = coordinates(51)
    degrees = ZernikeMoments(15).fit(image[np.newaxis]).indices_
    # centrosome measures the angle from the y axis, so the axes change places.
    values = peer.construct_zernike_polynomials(y.copy(), x.copy(), degrees)
    factor = (degrees[:, 0] + 1) / np.pi * (2 / 51) ** 2
    theirs = (image[..., None] * values.conj()).sum(axis=(0, 1)) * factor
    ours = moments(image, 15, method="sample")
    assert_allclose(list(ours.values()), theirs, atol=1e-10)


@pytest.mark.parametrize("size", [7, 33, 100, 300])
@pytest.mark.parametrize("order", [15, 20])
def test_a_constant_image_has_no_other_moment(size, order):
    encoded = ZernikeMoments(order).fit_transform(np.full((1, size, size), 200.0))[0]
    assert_allclose(encoded[0], 200, rtol=1e-12)
    # 1e-6 of the level is promised, 3e-11 of it the separable method's digits.
    assert encoded[1:].max() < 200 * 1e-9


@METHODS
@pytest.mark.parametrize("order", [15, 23])
def test_quarter_turns_change_phases_alone(method, order, rng):
    images = rng.normal(size=(2, 41, 41))
    encoder = ZernikeMoments(order, method=method, output="complex").fit(images)
    straight = encoder.transform(images)
    # rot90 turns rows into columns: from y (down) towards x, by minus 90 degrees.
    turned = encoder.transform(np.rot90(images, axes=(1, 2)))
    phase = np.exp(-1j * encoder.indices_[:, 1] * -np.pi / 2)
    # The digits of the separable method.
    assert_allclose(turned, straight * phase, rtol=0, atol=1e-11)


def test_any_turn_keeps_the_magnitudes(rng):
    x, y = coordinates(300)
    angles = rng.uniform(0, 2 * np.pi, 10)
    images = np.stack([smooth(x, y), *(smooth(x, y, a) for a in angles)])
    encoder = ZernikeMoments(output="complex").fit(images)
    straight, *turned = encoder.transform(images)
    size = np.linalg.norm(straight)
    for angle, encoded in zip(angles, turned, strict=True):
        phase = np.exp(-1j * encoder.indices_[:, 1] * angle)
        # Taxels are squares: 1e-5 to 5e-5 at this size.
        assert np.linalg.norm(encoded - straight * phase) < 5e-4 * size


def test_magnitudes_forgive_a_turn_only_about_the_right_disc():
    # Relative change of the encoding under a turn: the order of these errors is
    # what makes sub-pixel centres, D/2 and exact rims worth having.
    x, y = coordinates(300)
    images = np.stack([smooth(x, y), smooth(x, y, 0.5)])

    def change(**options):
        straight, turned = ZernikeMoments(**options).fit_transform(images)
        return np.linalg.norm(straight - turned) / np.linalg.norm(straight)

    right = change()
    assert right < 1e-4
    assert change(method="sample") > 5 * right
    assert change(centre=(149.5, 150.0)) > 50 * right
    assert change(disc="circumscribed") > 500 * right
    assert change(output="noll_abs") > 1000 * right


def test_the_disc_is_placed_to_a_part_of_a_taxel():
    centre, radius = (20.25, 23.7), 15.6
    x, y = coordinates(45, *centre, radius)
    encoded = moments(x**2 + 0 * y, 4, centre=centre, radius=radius)
    # The tolerance is that of the closed forms at 33 taxels.
    assert_allclose(encoded[0, 0], 1 / 4, atol=1.4e-3)
    assert_allclose(encoded[2, 2], 1 / 4, atol=1.4e-3)
    off = moments(x**2 + 0 * y, 4, centre=(20.25, 24.2), radius=radius)
    # (x + d)^2 holds the tilt 2 d x, whose moment is d: here half a taxel.
    assert_allclose(off[1, 1], 0.5 / radius, rtol=0.02)


def test_beyond_the_frame_an_image_counts_as_zero(rng):
    image = rng.normal(size=(9, 9))
    framed = np.zeros((19, 19))
    framed[5:14, 5:14] = image
    small = moments(image, 15, centre=(3.2, 4.0), radius=6.0)
    large = moments(framed, 15, centre=(8.2, 9.0), radius=6.0)
    assert_allclose(list(small.values()), list(large.values()), atol=1e-11)


@pytest.mark.realdata
def test_a_turned_real_touch_keeps_its_encoding(data_folder, rng):
    archive = np.load(data_folder / "bathtip" / "bathtip50.npz")
    images, rims = archive["images"], archive["rim_circle_row_col_radius_px"]
    for i in rng.choice(len(images), 12, replace=False):
        centre, angle = rims[i, :2], rng.uniform(0, 2 * np.pi)
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        image = images[i].astype(float)
        turned = affine_transform(image, turn, offset=centre - turn @ centre)
        encoder = ZernikeMoments(centre=tuple(centre), radius=44, drop_constant=True)
        straight, around = encoder.fit_transform(np.stack([image, turned]))
        # Resampling alone changes up to 1.8e-3.
        assert np.linalg.norm(around - straight) < 2e-3 * np.linalg.norm(straight)


@METHODS
@pytest.mark.parametrize("shape", [(16, 16), (17, 17), (16, 21), (15, 12)])
def test_folding_the_image_changes_nothing(shape, method):
    n_rows, n_cols = shape
    images = np.random.default_rng(0).normal(size=(3, *shape))
    options = {"method": method, "output": "complex", "weight": "none"}
    folding = ZernikeMoments(23, **options).fit(images)
    # In a frame that reaches further on two sides the disc is not in the middle.
    wide = np.pad(images, [(0, 0), (3, 0), (0, 2)])
    centre = (n_rows - 1) / 2 + 3, (n_cols - 1) / 2
    dense = ZernikeMoments(23, centre=centre, radius=min(shape) / 2, **options)
    # Sums of some 200 products in another order.
    assert_allclose(folding.transform(images), dense.fit_transform(wide), atol=1e-13)
    images[1, 0, 0] = wide[1, 0, 0] = np.nan
    for encoder, spoilt in ((folding, images), (dense, wide)):
        with pytest.raises(ValueError, match=r"NaN or infinity in touch 1 \(1 of 3"):
            encoder.transform(spoilt)


def test_polynomials_of_high_order_stay_within_the_unit_circle():
    x, y = np.meshgrid(np.arange(-10, 11), np.arange(-10, 11))
    inside = np.hypot(x, y) <= 10
    x, y = x[inside] / 10, y[inside] / 10
    on_rim = np.hypot(x, y) == 1
    assert on_rim.sum() == 12  # (10, 0), (8, 6) and the like
    for (n, m), value in values_at(100, x, y, 10).items():
        # R(n, m) is 1 at r = 1 for every n and m, and |R| <= 1 inside.
        assert np.abs(np.abs(value[on_rim]) - 1).max() < 1e-12, (n, m)
        assert np.abs(value).max() < 1 + 1e-12, (n, m)


@pytest.mark.parametrize("m", [0, 2, 20, 48, 98, 100])
def test_polynomials_of_high_order_keep_their_digits(m):
    r = Fraction(15, 16)
    radial = sum(
        Fraction((-1) ** k * factorial(100 - k), factorial(k))
        / (factorial((100 + m) // 2 - k) * factorial((100 - m) // 2 - k))
        * r ** (100 - 2 * k)
        for k in range((100 - m) // 2 + 1)
    )
    values = values_at(100, np.array([float(r)]), np.zeros(1), 16)
    # A hundred steps of the recurrence on numbers of order 1.
    assert abs(values[100, m][0] - float(radial)) < 1e-13


@pytest.mark.parametrize("order", [4, 15, 20])
def test_one_taxel_has_the_value_of_the_polynomial_at_its_centre(order):
    # To order 20 values come from sums of Legendre products.
    images = np.eye(81).reshape(-1, 9, 9)
    row, col = np.indices((9, 9)).reshape(2, -1)
    encoder = ZernikeMoments(
        order, method="sample", output="complex", weight="none", radius=6.0
    )
    encoded = encoder.fit_transform(images).conj()
    x, y = (col - 4) / 6, (row - 4) / 6
    values = [polynomial(n, m, x, y) / 36 for n, m in encoder.indices_.tolist()]
    # Two digits are lost by order 10, three more by order 20.
    atol = 1e-15 if order == 4 else 1e-11
    assert_allclose(encoded, np.stack(values, axis=1), rtol=0, atol=atol)


def test_noll_list_is_table_1_of_corradi_2014():
    n = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3]
    m = [0, 1, -1, 0, -2, 2, -1, 1, -3, 3]
    listed = ZernikeMoments(3, output="noll").fit(np.ones((1, 9, 9))).indices_
    assert_array_equal(listed, np.column_stack([n, m]))
