"""Zernike polynomials against closed forms and exact arithmetic."""

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.encodings import ZernikeMoments, zernike_degrees, zernike_values


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


@pytest.mark.parametrize("order", [2, 15, 20])
def test_one_taxel_has_the_value_of_the_polynomial_at_its_centre(order):
    # To order 20 values come from sums of Legendre products.
    images = np.eye(81).reshape(-1, 9, 9)
    row, col = np.indices((9, 9)).reshape(2, -1)
    encoder = ZernikeMoments(
        order, method="sample", output="complex", weight="none", radius=6.0
    )
    x, y = (col - 4) / 6, (row - 4) / 6
    values = np.stack(list(zernike_values(order, x, y)), axis=1) / 36
    # Two digits are lost by order 10, three more by order 20.
    atol = 1e-15 if order == 2 else 1e-11
    assert_allclose(encoder.fit_transform(images).conj(), values, rtol=0, atol=atol)


def test_noll_list_is_table_1_of_corradi_2014():
    n = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3]
    m = [0, 1, -1, 0, -2, 2, -1, 1, -3, 3]
    listed = ZernikeMoments(3, output="noll").fit(np.ones((1, 9, 9))).indices_
    assert_array_equal(listed, np.column_stack([n, m]))
