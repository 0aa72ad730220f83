"""Zernike magnitudes of turned touches at 300 taxels, drawn and recorded."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import affine_transform

from palpate.encodings import RingQuantiles, encoder_named
from palpate.images import DomeCrop

SIZE = 300


def change(straight, around):
    """Relative change of each vector of magnitudes."""
    return np.linalg.norm(around - straight, axis=1) / np.linalg.norm(straight, axis=1)


def test_turned_drawings_keep_their_magnitudes(rng):
    axis = (np.arange(SIZE) - (SIZE - 1) / 2) / (SIZE / 2)
    x, y = np.meshgrid(axis, axis)
    images = []
    for angle in (0, *rng.uniform(0, 2 * np.pi, 8)):
        u, v = (
            x * np.cos(angle) + y * np.sin(angle),
            y * np.cos(angle) - x * np.sin(angle),
        )
        wide = np.exp(-((u - 0.3) ** 2) / 0.08 - (v + 0.2) ** 2 / 0.03)
        images.append(
            wide + 0.6 * np.exp(-((u + 0.4) ** 2) / 0.02 - (v - 0.3) ** 2 / 0.1)
        )
    magnitudes = encoder_named("zernike").fit_transform(np.stack(images))
    # The goal is 5e-4; smooth drawings that fade before the rim do far better.
    assert (change(magnitudes[:1], magnitudes[1:]) < 1e-5).all()


@pytest.mark.realdata
def test_turned_pictures_keep_their_magnitudes_after_cropping(data_folder, rng):
    cv2 = pytest.importorskip("cv2")
    paths = sorted((data_folder / "bathtip" / "originals").glob("*/*/*.jpg"))
    chosen = [str(paths[i]) for i in rng.choice(len(paths), 6, replace=False)]
    images = np.stack([cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in chosen])
    crop = DomeCrop(SIZE).fit(images)
    rims = crop.rims(images)
    turned = []
    for image, rim, angle in zip(images, rims, rng.uniform(0, 6.28, 6), strict=True):
        turn = np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )
        centre = np.array([rim.row, rim.col])
        offset = centre - turn @ centre
        turned.append(affine_transform(image.astype(float), turn, offset))
    crop.disc_radius_ = 195  # pixels; that stays in the frame whatever the angle
    straight, around = (crop.cut(shown, rims) for shown in (images, np.stack(turned)))
    # Cropping keeps or drops whole cells: one cell less, and the rim cuts kept ones.
    encoder = encoder_named("zernike", radius=SIZE / 2 - 1).fit(straight)
    moved = change(encoder.transform(straight), encoder.transform(around))
    # The goal is 2e-3: what resampling pictures costs at worst.
    assert (moved < 1e-3).all()


def test_gradients_of_levels_that_single_precision_cannot_hold_are_refused(rng):
    images = rng.random((6, 24, 24))
    gradients = encoder_named("polar-gradients")
    for scale in (1e38, 1e200):
        with pytest.raises(
            ValueError, match=r"at most 1e\+37 in size, got .* in touch"
        ):
            gradients.fit(scale * images)
    with pytest.raises(ValueError, match="Divide all images by one number"):
        gradients.fit(images).transform(1e38 * images)
    assert np.isfinite(gradients.fit(9e36 * images).transform(9e36 * images)).all()


@pytest.mark.parametrize(
    "name", ["edge-histograms", "polar-gradients", "ring-patterns", "ring-quantiles"]
)
def test_where_images_lie_in_memory_changes_nothing(rng, name):
    images = rng.random((3, 40, 40))
    encoder = encoder_named(name).fit(images)
    expected, kept = encoder.transform(images), []
    for size in rng.integers(500, 10_000, 40):
        kept.append(np.empty(size, np.uint8))  # what comes next lies elsewhere
        assert_array_equal(encoder.transform(images), expected)


def test_gradients_of_levels_whose_squares_vanish_count_like_others(rng):
    images = rng.random((2, 40, 40))
    quantiles = RingQuantiles()
    expected = quantiles.fit(images).transform(images)
    small = quantiles.transform(1e-25 * images)
    assert_allclose(small, 1e-25 * expected, rtol=1e-5, atol=0)
