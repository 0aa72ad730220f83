"""Contact of touches with channels, and on pads side by side in one picture."""

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import ObjectRecogniser, _contact

NAMES = ["block"] * 12 + ["bar"] * 12
PADS = [[0, 0, 9, 9], [0, 11, 9, 9]]


def pressed(shape=(9, 20), seed=0):
    """Two shapes on the left of a quiet picture of taxels."""
    images = np.random.default_rng(seed).integers(0, 4, (24, *shape)).astype(float)
    images[:12, 3:7, 3:6] += 120
    images[12:, 3:5, 1:8] += 60
    return images


def hand_of(images):
    """Two pads with a gap of two columns between them."""
    gapped = images.copy()
    gapped[:, :, 9:11] = np.nan
    return gapped


class AsTheyAre:
    """Leaves images as they are, for a check that looks at them after clean-up."""

    def clean(self, touches):
        return touches.images


@pytest.fixture
def check(monkeypatch):
    """Fit a contact check to touches whose geometry is what they say."""
    monkeypatch.setattr(_contact, "find_geometry", lambda touches: touches.geometry)

    def fit(images, **about):
        touches = Touches(images, object=NAMES, **about)
        return _contact.ContactCheck().fit(touches, AsTheyAre())

    return fit


def flags(check, images, **about):
    touches = Touches(np.asarray(images), **about)
    return check.flags(touches, touches.images)


def test_taxels_outside_every_pad_do_not_count(check):
    images = hand_of(pressed())
    hand = check(images, geometry="array", pads=PADS)
    change = images[:, :, np.r_[:9, 11:20]].reshape(24, -1)
    assert hand.typical_ == pytest.approx(np.median(np.sqrt((change**2).mean(axis=1))))
    dirt = np.zeros((2, 9, 20))
    dirt[0, :, 9:11] = 500
    dirt[1, 3:7, 3:6] = 120
    assert flags(hand, dirt) == ["no contact", ""]


def test_two_fingers_are_no_double_contact(check):
    hand = check(hand_of(pressed()), geometry="array", pads=PADS)
    pinch, double = np.zeros((2, 9, 20))
    pinch[3:6, 3:6] = pinch[3:6, 14:17] = 120
    double[0:3, 0:3] = double[6:9, 6:9] = 120
    assert flags(hand, hand_of(np.stack([pinch, double]))) == ["", "double contact"]
    whole = check(pressed(), geometry="array")
    assert flags(whole, [pinch]) == ["double contact"]


def test_small_pads_are_never_double(check):
    small = check(pressed(), geometry="array", pads=[[0, 0, 9, 7]])
    double = np.zeros((1, 9, 20))
    double[:, 0:3, 0:3] = double[:, 6:9, 4:7] = 120
    assert flags(small, double) == [""]


def test_channels_count_together(check):
    images = np.stack([pressed(), -0.5 * pressed(seed=1)], axis=-1)
    about = {"channels": ["x", "y"], "geometry": "array"}
    both = check(images, **about, no_contact=np.zeros((9, 20, 2)))
    assert both.idle_.shape == (9, 20, 2)
    size = np.sqrt((images**2).mean(axis=(1, 2, 3)))
    assert both.typical_ == pytest.approx(np.median(size))
    faint, one, two = np.zeros((3, 9, 20, 2))
    faint[2, 2] = 2
    one[3:7, 3:6, 1] = 120
    two[1:4, 1:4, 0] = two[5:8, 12:16, 1] = 100
    said = flags(both, np.stack([faint, one, two]), channels=["x", "y"])
    assert said == ["no contact", "", "double contact"]


def test_a_colour_camera_is_compared_with_its_frame_of_no_contact(check):
    rng = np.random.default_rng(2)
    frame = rng.uniform(50, 200, (9, 20, 3))
    dents = frame + rng.normal(scale=60, size=(24, 9, 20, 3))
    about = {"channels": ["r", "g", "b"]}
    camera = check(dents, geometry="plane", no_contact=frame, **about)
    rest = frame * 1.1 + rng.normal(size=frame.shape)
    said = flags(camera, np.stack([rest, dents[0]]), **about)
    assert said == ["no contact", ""]


def test_a_plane_of_pads_is_compared_on_them_alone(check):
    rng = np.random.default_rng(3)
    frame = rng.uniform(50, 60, (9, 20))
    frame[:, 9:11] = 5000  # the same in every picture, and so no sign of anything
    dents = frame + rng.normal(scale=30, size=(24, 9, 20)) * (frame < 5000)
    about = {"geometry": "plane", "no_contact": frame}
    for pads in ({}, {"pads": PADS}):
        learnt = check(dents, **about, **pads)
        assert flags(learnt, dents[:1]) == [""]
        assert flags(learnt, frame[np.newaxis]) == ["no contact"]


def test_models_of_hands_keep_their_pads(tmp_path):
    touches = Touches(hand_of(pressed()), object=NAMES, geometry="array", pads=PADS)
    learnt = ObjectRecogniser().fit(touches)
    again = ObjectRecogniser.load(learnt.save(tmp_path / "hand.palpate"))
    np.testing.assert_array_equal(again.contact_.pads_, PADS)
    pinch = np.zeros((9, 20))
    pinch[3:6, 3:6] = pinch[3:6, 14:17] = 120
    for model in (learnt, again):
        assert model.evidence(Touches(pinch[np.newaxis])).flags == [""]


def test_images_with_channels_must_be_named():
    learnt = ObjectRecogniser().fit(
        Touches(pressed(), object=NAMES, geometry="array"),
    )
    with pytest.raises(ValueError, match=r"shape \(1, 9, 20, 3\). Name its channels"):
        learnt.evidence(np.zeros((1, 9, 20, 3)))
