"""Adapting to another device: what is found again, what is kept, what is refused."""

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import ObjectRecogniser, adapt
from palpate.simulation import DomeCamera, simulate_touches

NAMES = ("ball", "mug", "pen")
CAMERA = DomeCamera(image_shape=(64, 64), n_nodes=24)
OTHER = DomeCamera(
    image_shape=(72, 72),
    n_nodes=24,
    disc_centre=(0.5, 0.5),
    disc_radius=0.45,
    gamma=1.8,
)


@pytest.fixture(scope="module")
def recogniser():
    touches = simulate_touches(NAMES, 16, CAMERA, drift=False, random_state=0)
    return ObjectRecogniser("corradi2015").fit(touches)


@pytest.fixture(scope="module")
def elsewhere():
    return simulate_touches(NAMES, 8, OTHER, drift=False, random_state=1)


def _vectors(offset, n, seed):
    rng = np.random.default_rng(seed)
    names = np.repeat(["a", "b"], n)
    images = rng.normal(size=(2 * n, 1, 6)) + offset
    images[:, 0, 0] += np.where(names == "a", 0.0, 6.0)
    return Touches(images, object=names, geometry="none")


def test_a_camera_that_sees_the_dome_elsewhere_is_found_again(recogniser, elsewhere):
    with pytest.raises(ValueError, match="64 x 64"):
        recogniser.log_likelihood(elsewhere)
    few = elsewhere[np.concatenate([[0, 1], [8, 9], [16, 17]])]
    adapted = adapt(recogniser, few)
    before, after = recogniser.encoder_.clean_up_, adapted.encoder_.clean_up_
    # The disc keeps its share of the rim, and is the rim the other camera shows: of
    # 0.45 heights of 72 pixels, to within the pixel that is the width of its edge.
    assert after.disc_radius_ / after.rim_radius_ == pytest.approx(
        before.disc_radius_ / before.rim_radius_
    )
    assert after.rim_radius_ == pytest.approx(0.45 * 72, abs=1.5)
    assert after.size_ == before.size_
    best = adapted.log_likelihood(elsewhere).argmax(axis=1)
    right = (adapted.classes_[best] == elsewhere.object).mean()
    # Chance is 1/3; three standard errors of 24 touches above it are 0.62.
    assert right > 0.62


def test_the_old_recogniser_stays_as_it_is(recogniser, elsewhere):
    features, shape = (
        recogniser.memory_.features.copy(),
        recogniser.encoder_.image_shape_,
    )
    adapt(recogniser, elsewhere)
    assert np.array_equal(recogniser.memory_.features, features)
    assert recogniser.encoder_.image_shape_ == shape


def test_new_touches_join_the_old_and_are_one_group_of_their_own():
    old, new = _vectors(0.0, 20, 0), _vectors(0.5, 4, 1)
    recogniser = ObjectRecogniser().fit(old)
    adapted = adapt(recogniser, new)
    assert len(adapted.memory_) == 48
    assert adapted.memory_.labels[40:].tolist() == ["a"] * 4 + ["b"] * 4
    group = set(adapted.memory_.blocks[40:])
    assert len(group) == 1
    assert not group & set(adapted.memory_.blocks[:40])


def test_what_a_device_does_to_touches_is_learnt():
    # On the other device everything is 6 larger: an "a" there is a "b" here.
    old, new, test = _vectors(0.0, 20, 0), _vectors(6.0, 10, 1), _vectors(6.0, 50, 2)
    recogniser = ObjectRecogniser().fit(old)

    def right(one):
        best = one.log_likelihood(test).argmax(axis=1)
        return (one.classes_[best] == test.object).mean()

    # Before, all are taken for "b"; after, the few new touches stand against the many
    # old ones, and most are told apart.
    assert right(recogniser) < 0.6
    assert right(adapt(recogniser, new)) > 0.85


def test_a_model_that_was_adapted_is_saved(recogniser, elsewhere, tmp_path):
    adapted = adapt(recogniser, elsewhere)
    loaded = ObjectRecogniser.load(adapted.save(tmp_path / "m.palpate"))
    assert np.array_equal(
        loaded.log_likelihood(elsewhere), adapted.log_likelihood(elsewhere)
    )


def test_an_object_that_was_never_learnt_is_refused(recogniser, elsewhere):
    names = np.where(elsewhere.object == "pen", "spoon", elsewhere.object)
    strange = elsewhere.with_columns(object=names)
    with pytest.raises(ValueError, match="known objects, got 'spoon'"):
        adapt(recogniser, strange)


def test_one_touch_of_one_object_is_enough_to_be_taken_in():
    learnt = ObjectRecogniser().fit(_vectors(0.0, 10, 0))
    there = _vectors(0.3, 1, 1)[:1]
    adapted = adapt(learnt, there)
    assert len(adapted.memory_) == 21
    assert adapted.classes_.tolist() == ["a", "b"]
