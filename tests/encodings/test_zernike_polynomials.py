"""Zernike polynomials against closed forms and exact arithmetic."""

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.encodings import ZernikeMoments, zernike_degrees, zernike_values
from palpate.encodings._zernike_polynomials import legendre_weights


@pytest.mark.parametrize(
    ("n", "m", "closed_form"),
    [
        pytest.param(0, 0, lambda x, y: 1 + 0j * x, id="piston"),
        pytest.param(1, 1, lambda x, y: x + 1j * y, id="tilt"),
        pytest.param(2, 0, lambda x, y: 2 * (x**2 + y**2) - 1 + 0j, id="defocus"),
        pytest.param(2, 2, lambda x, y: (x + 1j * y) ** 2, id="astigmatism"),
        pytest.param(
            3, 1, lambda x, y: (3 * (x**2 + y**2) - 2) * (x + 1j * y), id="coma"
        ),
        pytest.param(
            4,
            0,
            lambda x, y: 6 * (x**2 + y**2) ** 2 - 6 * (x**2 + y**2) + 1 + 0j,
            id="spherical",
        ),
    ],
)
def test_polynomials_of_low_order(n, m, closed_form):
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    values = dict(zip(zernike_degrees(4), zernike_values(4, x, y), strict=True))
    # A few operations on numbers of order 1.
    assert_allclose(values[n, m], closed_form(x, y), atol=1e-14)


def test_polynomials_of_high_order_stay_within_the_unit_circle():
    angle, r = np.linspace(0, 6, 50), np.linspace(0, 1, 50)
    x, y = r * np.cos(angle), r * np.sin(angle)
    for (n, m), value in zip(
        zernike_degrees(100), zernike_values(100, x, y), strict=True
    ):
        # R(n, m) is 1 at r = 1 for every n and m, and |R| <= 1 inside.
        assert abs(abs(value[-1]) - 1) < 1e-12, (n, m)
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
    values = list(zernike_values(100, np.array([float(r)]), np.zeros(1)))
    # A hundred steps of the recurrence on numbers of order 1.
    found = values[zernike_degrees(100).index((100, m))][0]
    assert abs(found - float(radial)) < 1e-13


def test_legendre_weights_are_exact():
    # x^2 + y^2 has degree 2: V(2, 0) = 2 r^2 - 1 = (4 P2(x) + 4 P2(y) + 1) / 3.
    weights = legendre_weights(2)[zernike_degrees(2).index((2, 0))]
    assert_array_equal(weights.real, [[1 / 3, 0, 4 / 3], [0, 0, 0], [4 / 3, 0, 0]])
    assert_array_equal(weights.imag, np.zeros((3, 3)))


def test_noll_list_is_table_1_of_corradi_2014():
    n = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3]
    m = [0, 1, -1, 0, -2, 2, -1, 1, -3, 3]
    listed = ZernikeMoments(3, output="noll").fit(np.ones((1, 9, 9))).indices_
    assert_array_equal(listed, np.column_stack([n, m]))
