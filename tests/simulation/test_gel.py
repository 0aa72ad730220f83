"""A simulated gel: what its colours say of slopes, and what it is like as a sensor."""

import numpy as np
import pytest

from palpate import ObjectRecogniser, simulate_touches
from palpate.simulation import GelCamera, PlacedObject, SensorPose, find_object


@pytest.fixture(scope="module")
def ball():
    """A picture without noise of a ball that is pressed from straight above."""
    gel = GelCamera()
    thing = find_object("ball")
    top = float(thing.mesh.vertices[:, 2].max())
    press = gel.press(PlacedObject(thing), SensorPose((0.0, 0.0, top + 5), (0, 0, -1)))
    return gel, press, gel.image(press).astype(float) - gel.no_contact()


def test_each_colour_is_brighter_where_the_dent_leans_towards_its_light(ball):
    gel, press, change = ball
    assert press.touched
    assert press.depth_mm <= gel.dome.max_depth_mm + 1e-6
    _, n_cols = gel.image_shape
    red = change[..., 0]
    # Of a round dent one side leans towards the red light, and the other away.
    left, right = red[:, : n_cols // 2], red[:, n_cols // 2 :]
    assert left.mean() * right.mean() < 0
    # The three lights are 120 degrees apart: their changes, as shares, sum to about 0.
    share = change / gel.no_contact().astype(float)
    assert abs(share.sum(axis=2)).max() < 0.15 * abs(share).max()


def test_where_nothing_is_touched_nothing_changes(ball):
    gel, _, change = ball
    assert abs(change).max() > 20
    assert (gel.image() == gel.no_contact()).all()
    noisy = gel.image(rng=np.random.default_rng(0)).astype(float)
    assert (noisy - gel.no_contact()).std() == pytest.approx(gel.dome.noise_sd, rel=0.1)


def test_touches_have_channels_and_are_recognised():
    names = ["ball", "pen", "box"]
    gel = GelCamera(image_shape=(48, 64))
    taught = simulate_touches(names, 20, gel, n_sessions=4, random_state=0)
    asked = simulate_touches(names, 10, gel, n_sessions=2, random_state=1)
    assert taught.images.shape == (60, 48, 64, 3)
    assert [*taught.channels] == ["r", "g", "b"]
    recogniser = ObjectRecogniser().fit(taught)
    best = recogniser.classes_[recogniser.log_likelihood(asked).argmax(axis=1)]
    assert np.mean(best == asked.object) > 0.5  # chance is a third


def test_another_mounting_looks_otherwise_and_the_same_seed_the_same():
    gel = GelCamera()
    first, again = (gel.remounted(np.random.default_rng(3)) for _ in range(2))
    assert first == again
    assert (first.no_contact() != gel.no_contact()).any()
    assert gel.drifted(np.random.default_rng(0)).dome.gain != gel.dome.gain


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"image_shape": (4, 160)}, "image_shape must be at least 8, got 4"),
        ({"width_mm": 0}, "width_mm must be positive"),
        ({"colours": (1, 0, 1)}, "colours must be positive"),
    ],
)
def test_what_is_no_gel_is_refused(how, message):
    with pytest.raises(ValueError, match=message):
        GelCamera(**how)
