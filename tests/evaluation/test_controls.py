"""What a recogniser is compared with: nuisance values, and simple recognisers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn import config_context
from sklearn.base import clone
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import Touches
from palpate.evaluation import (
    brightness,
    control_log_likelihood,
    named_alone,
    without_contact,
)
from palpate.evaluation._comparisons import SIMPLE, disc_centres, sorted_pixels


@pytest.fixture
def colour(rng):
    images = rng.uniform(0, 9, (5, 20, 30, 3))
    about = {"channels": ["r", "g", "b"], "no_contact": images[2]}
    return Touches(images, geometry="plane", **about)


@pytest.fixture
def disc():
    """A bright disc about row 52, column 61 of a dark picture."""
    row, col = np.mgrid[:100, :120]
    return np.where(np.hypot(row - 52, col - 61) < 40, 150.0, 10.0)


def test_sorted_pixels_leave_gaps_out():
    image = np.full((1, 2, 3), np.nan)
    image[:, :, ::2] = [[3.0, 1.0], [0.0, 4.0]]
    hand = Touches(image, pads=[[0, 0, 2, 1], [0, 2, 2, 1]])
    assert np.isfinite(sorted_pixels(hand)).all()


def test_touches_like_the_frame_of_no_contact_are_found(colour):
    assert without_contact(colour).tolist() == [False, False, True, False, False]


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_touches_that_are_an_even_frame_are_without_contact(rng, level):
    images = rng.random((5, 4, 4))
    images[1] = level
    frame = np.full((4, 4), level)
    touches = Touches(images, geometry="array", no_contact=frame)
    assert without_contact(touches).tolist() == [False, True, False, False, False]


def test_rims_are_found_in_the_mean_over_channels(monkeypatch, disc):
    grey = Touches(np.stack([disc] * 3), geometry="dome")
    beside = np.roll(disc, 20, axis=1)[..., np.newaxis] * [-1, 0, 1]  # of mean 0
    names = {"channels": ["r", "g", "b"], "geometry": "dome"}
    colour = Touches(grey.images[..., np.newaxis] + beside, **names)
    module = "palpate.evaluation._comparisons.find_geometry"
    monkeypatch.setattr(module, lambda touches: touches.geometry)
    assert_allclose(disc_centres(colour), disc_centres(grey))


def test_rims_are_found_beside_a_frame_of_no_contact(disc):
    touches = Touches(np.stack([disc] * 3), geometry="dome", no_contact=disc)
    assert_allclose(disc_centres(touches), [[52, 61]] * 3, atol=1)


def test_sorted_pixels_are_shares_of_the_mean_level():
    """Levels rise; each is over the total, times the number of taxels."""
    touches = Touches(np.array([[[6.0, 1.0], [3.0, 2.0]], [[0.0, 0.0], [0.0, 0.0]]]))
    assert_allclose(sorted_pixels(touches), [[1 / 3, 2 / 3, 1, 2], [0, 0, 0, 0]])


def test_sorted_pixels_of_many_touches_are_those_of_each(rng):
    """Touches are taken by 256, and above 64 a side every second row and column."""
    images = rng.uniform(1, 9, (259, 5, 5))
    values = sorted_pixels(Touches(images))
    expected = np.sort(images.reshape(259, 25), axis=1)
    expected = expected / expected.mean(axis=1, keepdims=True)
    assert_allclose(values, expected)
    large = rng.uniform(1, 9, (2, 65, 20))
    assert_allclose(
        sorted_pixels(Touches(large)), sorted_pixels(Touches(large[:, ::2, ::2]))
    )
    whole = rng.uniform(1, 9, (1, 64, 2))
    assert sorted_pixels(Touches(whole))[0, 0] == pytest.approx(
        whole.min() / whole.mean()
    )


def test_brightness_is_mean_and_spread_over_all_channels(colour):
    images = colour.images.copy()
    images[1, 0, 0] = np.nan
    values = brightness(Touches(images, channels=colour.channels))
    flat = images.reshape(5, -1)
    assert_allclose(values, np.c_[np.nanmean(flat, axis=1), np.nanstd(flat, axis=1)])


def test_the_share_that_brightness_alone_names_is_given(rng):
    """Images are noise alone; one object is brighter by far."""
    images = rng.normal(size=(48, 4, 4)) + np.repeat([0, 50], 24)[:, None, None]
    shares = named_alone(Touches(images, object=np.repeat(["a", "b"], 24)))
    assert shares["brightness"] == {"right": 1.0, "chance": 0.5}
    assert named_alone(Touches(images)) == {}


@pytest.mark.parametrize(
    ("shares", "alike"),
    [
        ([1.0, 0.99, 0.981, 0.979, 0.9, 0.8, 0.5, 0.0, -1.0], 3),
        # Behind a gel much of a picture never changes, and touches are nearly alike.
        ([1.0, 0.998, 0.99, 0.985, 0.984, 0.98, 0.97], 2),
    ],
)
def test_only_a_correlation_above_098_is_like_no_contact(shares, alike):
    """An image is a share of the frame and an orthogonal part, of known correlation.

    And far less unlike it than a middling touch is.
    """
    frame, beside = np.array([1.0, -1, 0, 0]), np.array([0.0, 0, 1, -1])
    shares = np.array(shares)
    images = shares[:, None] * frame + np.sqrt(1 - shares**2)[:, None] * beside
    touches = Touches(
        images.reshape(-1, 2, 2), no_contact=frame.reshape(2, 2), geometry="none"
    )
    assert without_contact(touches).tolist() == [n < alike for n in range(len(shares))]
    assert without_contact(Touches(images.reshape(-1, 2, 2))) is None


def test_sorted_pixels_end_with_the_least_and_the_most(colour):
    """Of 1,800 levels 64 are kept, with the least and the most."""
    values, flat = sorted_pixels(colour), colour.images.reshape(5, -1)
    assert values.shape == (5, 64)
    assert (np.diff(values, axis=1) >= 0).all()
    assert_allclose(values[:, 0], flat.min(axis=1) / flat.mean(axis=1))
    assert_allclose(values[:, -1], flat.max(axis=1) / flat.mean(axis=1))
    signed = Touches(np.array([[[-1.0, 3.0]]]))
    assert_allclose(sorted_pixels(signed), [[-1 / 4 * 2, 3 / 4 * 2]])


def test_a_control_is_learnt_without_regard_to_units(rng):
    """Values are standardised; two clouds far apart are told apart."""
    labels = np.repeat(["a", "b"], 20)
    train = rng.normal(size=(40, 2)) + 9 * (labels == "b")[:, None]
    test = np.array([[0.0, 0.0], [9.0, 9.0]])
    plain = control_log_likelihood(train, labels, None, test)
    assert plain.argmax(axis=1).tolist() == [0, 1]
    units = np.array([1e-3, 1e3])
    assert_allclose(
        control_log_likelihood(train * units, labels, None, test * units), plain
    )


@pytest.mark.parametrize(("n_touches", "counts"), [(3, False), (4, True)])
def test_four_touches_of_two_objects_are_split(n_touches, counts, rng):
    names = ["a"] * n_touches + ["b"] * 12
    images = rng.normal(size=(len(names), 4, 4))
    images[:n_touches] += 50
    shares = named_alone(Touches(images, object=names))
    assert bool(shares) is counts
    assert "disc centre" not in shares


@pytest.mark.parametrize("channels", [(), (3,)], ids=["grey", "colour"])
def test_simple_recognisers_are_what_scikit_learn_does(channels):
    pytest.importorskip("pandas")
    rng = np.random.default_rng(0)
    shape = (45, 40, 45, *channels)
    centres = rng.normal(size=(3, *shape[1:]))
    images = np.repeat(centres, 15, axis=0) * 20 + 60 * rng.normal(size=shape)
    images[0, :3] = np.nan
    flat = images[:, ::5, ::5] if channels else images
    flat = np.nan_to_num(flat).reshape(45, -1)
    labels, train = np.repeat([0, 1, 2], 15), np.arange(45) % 3 > 0
    direct = {
        "taxels SVM": (flat, make_pipeline(StandardScaler(), SVC(C=10))),
        "roots SVM": (np.sign(flat) * np.sqrt(np.abs(flat)), SVC(C=10)),
        "3-NN": (flat, KNeighborsClassifier(3)),
    }
    for name, (X, classifier) in direct.items():
        encode, ours = SIMPLE[name]
        values = encode(images)
        expected = classifier.fit(X[train], labels[train])
        ours.fit(values[train], labels[train])
        # Channels lie side by side, in another order than taxel by taxel.
        assert sorted(values[1]) == sorted(X[1])
        assert (ours.predict(values[~train]) == expected.predict(X[~train])).all()
        with config_context(transform_output="pandas"):
            in_frames = clone(ours).fit(values[train], labels[train])
            assert (in_frames.predict(values) == ours.predict(values)).all()
        if name != "3-NN":
            # The kernel is summed by another routine: rounding.
            decided = ours.decision_function(values), expected.decision_function(X)
            assert_allclose(*decided, atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "n_features"),
    # Blocks of 2 x 2 cells of 8 pixels, 4 histograms of 9 each.
    [((10, 10), 3 * 3 * 36), ((64, 32), 7 * 3 * 36), ((160, 120, 3), 3 * 8 * 36)],
    ids=["enlarged", "as it is", "colour"],
)
def test_hog_has_a_histogram_for_each_cell(shape, n_features):
    pytest.importorskip("skimage", reason='needs the extra "bench"')
    images = np.random.default_rng(0).random((2, *shape))
    features = SIMPLE["HOG SVM"][0](images)
    assert features.shape == (2, n_features)
    # Each picture is divided by its maximum.
    assert_allclose(SIMPLE["HOG SVM"][0](7 * images), features, atol=1e-9)


@pytest.mark.parametrize(
    ("images", "expected"),
    [
        (np.full((2, 128, 64), 7, np.uint8), np.full((2, 1, 64, 32), 7.0)),
        (np.full((2, 3, 8), np.nan), np.zeros((2, 1, 24, 64))),
        (
            np.ones((2, 16, 16, 3)) * [1, 2, 3],
            np.ones((3, 64, 64)) * [[[[1]], [[2]], [[3]]]],
        ),
    ],
    ids=["averaged", "dead", "colour"],
)
def test_a_cnn_sees_pictures_of_at_most_64_pixels_a_side(images, expected):
    pictures = SIMPLE["small CNN"][0](images)
    assert pictures.dtype == np.float32
    np.testing.assert_array_equal(pictures, np.broadcast_to(expected, pictures.shape))


def test_a_cnn_learns_the_same_each_time_and_leaves_random_numbers_alone(rng):
    torch = pytest.importorskip("torch", reason='needs the extra "cnn"')
    images, names = rng.random((60, 16, 16)), np.repeat(["a", "b", "c"], 20)
    images[names == "b", :8] += 1
    encode, learner = SIMPLE["small CNN"]
    pictures, train = encode(images), np.arange(60) % 5 == 0
    state, n_threads = torch.get_rng_state(), torch.get_num_threads()
    first, second = (
        clone(learner).fit(pictures[train], names[train]) for _ in range(2)
    )
    assert (torch.get_rng_state() == state).all()
    assert torch.get_num_threads() == n_threads
    parameters = zip(first.net_.parameters(), second.net_.parameters(), strict=True)
    assert all(bool((a == b).all()) for a, b in parameters)
    assert (first.predict(pictures[~train]) == second.predict(pictures[~train])).all()
