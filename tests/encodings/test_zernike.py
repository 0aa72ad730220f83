"""Zernike moments against facts known without the code, and as an estimator."""

import pickle
import tracemalloc
from fractions import Fraction
from functools import cache, partial
from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import dblquad
from scipy.special import eval_jacobi
from sklearn.base import clone

from palpate.encodings import ZernikeMoments, encoder_named
from palpate.images import DomeCrop

from .conftest import turned

METHODS = pytest.mark.parametrize("method", ["exact", "sample"])


def coordinates(size):
    """x, y of taxel centres in radii of the inscribed disc."""
    x = (2 * np.arange(size) - (size - 1)) / size
    return np.meshgrid(x, x)


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


# Table 1 of Corradi et al. 2014, and on to 15.
NOLL = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3)]
NOLL += [(3, 3), (4, 0), (4, 2), (4, -2), (4, 4), (4, -4)]


def test_noll_moments_are_orthonormal():
    def pattern(n, m):
        wave = polynomial(n, abs(m), *coordinates(300))
        return np.sqrt((n + 1) * (2 if m else 1)) * (wave.imag if m < 0 else wave.real)

    images = np.stack([pattern(*degree) for degree in NOLL])
    encoder = ZernikeMoments(4, output="noll", weight="noll").fit(images)
    assert_array_equal(encoder.indices_, NOLL)
    # Second order in the taxel's side, times the polynomial's steep rim.
    assert_allclose(encoder.transform(images), np.eye(15), atol=2e-4)


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


def test_beyond_the_frame_an_image_counts_as_zero(rng):
    image = rng.normal(size=(9, 9))
    framed = np.zeros((19, 19))
    framed[5:14, 5:14] = image
    small = moments(image, 15, centre=(3.2, 4.0), radius=6.0)
    large = moments(framed, 15, centre=(8.2, 9.0), radius=6.0)
    assert_allclose(list(small.values()), list(large.values()), atol=1e-11)


@pytest.mark.realdata
def test_turned_pictures_keep_their_magnitudes_after_cropping(data_folder, rng):
    cv2 = pytest.importorskip("cv2")
    paths = sorted((data_folder / "bathtip" / "originals").glob("*/*/*.jpg"))
    chosen = [str(paths[i]) for i in rng.choice(len(paths), 6, replace=False)]
    images = np.stack([cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in chosen])
    crop = DomeCrop(300).fit(images)
    rims = crop.rims(images)
    around = [
        turned(image, rng.uniform(0, 360), np.array([rim.row, rim.col]))
        for image, rim in zip(images, rims, strict=True)
    ]
    crop.disc_radius_ = 195  # pixels; that stays in the frame whatever the angle
    discs = [crop.cut(shown, rims) for shown in (images, np.stack(around))]
    # Cropping keeps or drops whole cells: one cell less, and the rim cuts kept ones.
    encoder = encoder_named("zernike", radius=149).fit(discs[0])
    straight, moved = (encoder.transform(disc) for disc in discs)
    change = np.linalg.norm(moved - straight, axis=1)
    # The goal is 2e-3: what resampling pictures costs at worst.
    assert (change < 1e-3 * np.linalg.norm(straight, axis=1)).all()


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


@METHODS
def test_all_outputs_and_weights_come_from_one_set_of_moments(method, touches):
    def encode(**options):
        return ZernikeMoments(7, method=method, **options).fit_transform(touches)

    values, plain = encode(output="complex"), encode(output="complex", weight="none")
    half = ZernikeMoments(7).fit(touches).indices_.tolist()
    n, m = np.array(half).T
    # Rounding of sums of a hundred numbers of order 1.
    close = {"rtol": 0, "atol": 1e-14}
    assert_allclose(values, plain * (n + 1) / np.pi, **close)
    assert_allclose(encode(), np.abs(values), **close)
    degrees = ZernikeMoments(7, output="noll").fit(touches).indices_.tolist()
    pairs = [half.index([n, abs(m)]) for n, m in degrees]
    sine = np.array([m < 0 for _, m in degrees])
    noll = np.where(sine, -values.imag[:, pairs], values.real[:, pairs])
    assert_allclose(encode(output="noll"), noll, **close)
    assert_allclose(encode(output="noll_abs"), np.abs(noll), **close)
    factor = np.sqrt((n + 1) * np.where(m > 0, 2, 1)) / np.pi
    assert_allclose(
        encode(output="complex", weight="noll"), plain * factor, rtol=0, atol=1e-14
    )


def test_columns_are_named_and_counted(touches):
    half = ZernikeMoments().fit(touches)
    both = ZernikeMoments(repeat_negative=True).fit(touches)
    assert half.transform(touches).shape == (12, 72)
    assert both.transform(touches).shape == (12, 136)
    assert ZernikeMoments(output="noll").fit_transform(touches).shape == (12, 136)
    assert half.indices_[:4].tolist() == [[0, 0], [1, 1], [2, 0], [2, 2]]
    assert both.indices_[:4].tolist() == [[0, 0], [1, -1], [1, 1], [2, -2]]
    assert half.get_feature_names_out()[3] == "zernike2,2"
    dropped = ZernikeMoments(drop_constant=True).fit(touches)
    assert_array_equal(dropped.indices_, half.indices_[1:])
    assert_array_equal(dropped.transform(touches), half.transform(touches)[:, 1:])


@pytest.mark.parametrize("shape", [(24, 24), (24, 31)])
def test_single_precision_is_close(shape, rng):
    images = rng.normal(size=(70, *shape))
    double = ZernikeMoments(23).fit_transform(images)
    single = ZernikeMoments(23, precision="single").fit_transform(images)
    assert_allclose(single, double, rtol=0, atol=2e-6 * double.max())
    assert not np.array_equal(single, double)


def test_negative_m_repeat_magnitudes_and_conjugate_moments(touches):
    encoder = ZernikeMoments(6, repeat_negative=True)
    sizes = encoder.fit_transform(touches)
    values = clone(encoder).set_params(output="complex").fit_transform(touches)
    mirror = [encoder.indices_.tolist().index([n, -m]) for n, m in encoder.indices_]
    assert_array_equal(sizes, sizes[:, mirror])
    assert_array_equal(values, values[:, mirror].conj())
    assert_allclose(sizes, np.abs(values), rtol=1e-14)  # one more rounding


def test_the_default_disc_is_inscribed_to_the_outer_edge(touches):
    wide = np.concatenate([touches, touches], axis=2)
    default = ZernikeMoments().fit(wide)
    assert default.centre_ == (4.5, 9.5)
    assert default.radius_ == 5
    explicit = ZernikeMoments(centre=(4.5, 9.5), radius=5).fit_transform(wide)
    assert_array_equal(default.transform(wide), explicit)
    around = ZernikeMoments(disc="circumscribed").fit(wide)
    assert_allclose(around.radius_, np.hypot(5, 10))


@METHODS
@pytest.mark.parametrize("order", [15, 21])
def test_a_touch_is_encoded_alone(method, order, rng):
    images = rng.normal(size=(70, 20, 20))
    encoder = ZernikeMoments(order, method=method).fit(images)
    alone = np.vstack([encoder.transform(image[np.newaxis]) for image in images])
    # The order of sums in products of different sizes.
    assert_allclose(alone, encoder.transform(images), rtol=1e-12, atol=1e-12)


def test_views_of_any_stride_are_encoded(rng):
    images = rng.normal(size=(4, 24, 24))
    encoder = ZernikeMoments().fit(images)
    for view in (images[:, ::-1], images.transpose(0, 2, 1), images[::2]):
        assert_array_equal(
            encoder.transform(view), encoder.transform(np.ascontiguousarray(view))
        )


def test_a_large_batch_is_converted_in_blocks(rng):
    images = rng.integers(0, 256, size=(600, 150, 150), dtype=np.uint8)
    encoder = ZernikeMoments().fit(images)
    encoder.transform(images[:1])
    tracemalloc.start()
    encoder.transform(images)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < images.nbytes  # as float64 the images alone are eight times that


@pytest.mark.parametrize("order", [15, 21])
def test_pickle_keeps_the_encoding_and_stays_small(order, touches):
    fitted = ZernikeMoments(order, centre=(4.2, 4.9)).fit(touches)
    stored = pickle.dumps(fitted)
    assert len(stored) < 10_000  # tables are rebuilt, not stored
    assert_array_equal(
        pickle.loads(stored).transform(touches), fitted.transform(touches)
    )


def test_an_empty_press_is_encoded_by_zeros():
    assert_array_equal(ZernikeMoments().fit_transform(np.zeros((2, 8, 8))), 0)


@pytest.mark.parametrize("level", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(6, 5), (0, 0)], ids=["inside", "outside the disc"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("order", [15, 21])
def test_nan_and_infinity_are_refused(level, place, dtype, order, touches):
    encoder = ZernikeMoments(order).fit(touches)
    broken = touches.astype(dtype)
    broken[(3, *place)] = level
    with pytest.raises(ValueError, match=r"NaN or infinity in touch 3 \(1 of 12"):
        encoder.transform(broken)
    with pytest.raises(ValueError, match=r"NaN or infinity in touch 3 \(1 of 12"):
        encoder.fit(broken)


def test_sums_beyond_float64_are_refused():
    with pytest.raises(ValueError, match="Divide them by a constant"):
        ZernikeMoments().fit_transform(np.full((1, 10, 10), 1e308))
