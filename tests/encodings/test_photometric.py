"""Slopes of a gel from coloured lights: recovered exactly where the model holds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.encodings import ENCODINGS, PhotometricGradients

LIGHTS = np.array([[-1.0, 0.0], [0.5, 0.87], [0.5, -0.87]])


def lit(slopes, gain=1.0):
    """A grey gel of level 100, brighter where it falls towards a light."""
    return 100 + gain * slopes @ LIGHTS.T


@pytest.fixture
def dented(rng):
    return rng.normal(size=(5, 12, 16, 2))


def test_slopes_are_recovered(dented):
    flat = np.full((12, 16, 3), 100.0)
    encoder = PhotometricGradients(LIGHTS, baseline=flat).fit(lit(dented))
    roots = encoder.transform(lit(dented))
    found = (np.sign(roots) * roots**2).reshape(5, 2, 12, 16)
    assert_allclose(np.moveaxis(found, 1, 3), dented, atol=1e-9)


def test_what_all_lights_share_is_no_slope(dented):
    # Equal lights from all around: one level more in every channel tilts nothing.
    even = LIGHTS - LIGHTS.mean(axis=0)
    encoder = PhotometricGradients(even).fit(lit(dented))
    brighter = encoder.transform(lit(dented) + 7.0)
    assert_allclose(brighter, encoder.transform(lit(dented)), atol=1e-5)


def test_untouched_gel_has_no_slopes(dented):
    touches = np.concatenate([np.repeat(lit(0 * dented), 3, axis=0), lit(dented)])
    encoder = PhotometricGradients(LIGHTS).fit(touches)
    assert_allclose(encoder.transform(touches[:1]), 0, atol=1e-6)


@pytest.mark.parametrize(
    "lights", [[[1, 0], [2, 0], [3, 0]], [[1, 0], [0, 1]], [1, 0, 0]]
)
def test_lights_that_tell_no_slopes_are_refused(lights, dented):
    with pytest.raises(ValueError, match=r"a direction \(row, column\) for each of 3"):
        PhotometricGradients(lights).fit(lit(dented))


def test_grey_images_are_refused(dented):
    with pytest.raises(ValueError, match="for each of 1 channels"):
        PhotometricGradients(LIGHTS).fit(dented[..., 0])


def test_it_needs_lights_and_so_has_no_name():
    assert not any(kind is PhotometricGradients for kind, _ in ENCODINGS.values())
