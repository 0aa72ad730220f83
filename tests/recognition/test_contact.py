"""Touches without contact say nothing; others that are spoilt are marked."""

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import ObjectRecogniser


def pictures(seed, n_touches, side=40, frequency=2):
    """Stripes through noise on a common shading: a plane sensor with no rim."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 2 * np.pi, side)
    shading = np.add.outer(np.cos(x / 2), np.cos(x / 2))
    stripes = np.cos(frequency * x)[np.newaxis, np.newaxis]
    strength = rng.uniform(0.4, 0.8, (n_touches, 1, 1))
    noise = 0.05 * rng.normal(size=(n_touches, side, side))
    return shading + strength * stripes + noise, shading


@pytest.fixture(scope="module")
def camera():
    coarse, shading = pictures(0, 12, frequency=2)
    fine, _ = pictures(1, 12, frequency=5)
    images = np.concatenate([coarse, fine])
    names = ["coarse"] * 12 + ["fine"] * 12
    touches = Touches(images, object=names, no_contact=shading, geometry="plane")
    return ObjectRecogniser().fit(touches), touches


def idle(touches, seed=3, noise=0.05):
    """Return the no-contact frame with fresh noise and another exposure."""
    frame = touches.no_contact
    rng = np.random.default_rng(seed)
    return 1.2 * frame + noise * rng.normal(size=frame.shape)


def test_no_contact_leaves_the_belief_and_counts_as_a_touch(camera):
    recogniser, touches = camera
    belief = recogniser.start().update(touches[:2])
    before = dict(belief.posterior)
    belief.update(idle(touches))
    assert belief.posterior == before
    assert belief.touches_used == 3
    assert belief.flags == ["", "", "no contact"]


def test_only_no_contact_leaves_the_prior(camera):
    recogniser, touches = camera
    belief = recogniser.start(strangers=0).update(idle(touches))
    belief.update(idle(touches, seed=4))
    assert list(belief.posterior.values()) == pytest.approx([0.5, 0.5])
    assert belief.decide() is None


def test_order_of_silent_touches_does_not_matter(camera):
    recogniser, touches = camera
    early = recogniser.start().update(idle(touches)).update(touches[:2])
    late = recogniser.start().update(touches[:2]).update(idle(touches))
    assert early.posterior == late.posterior


def test_touches_in_contact_are_heard(camera):
    recogniser, touches = camera
    assert recogniser.evidence(touches).flags == [""] * len(touches)
    assert (np.ptp(recogniser.log_likelihood(touches), axis=1) > 0).all()


def test_a_label_of_such_touches_is_learnt(camera):
    _, touches = camera
    frames = np.stack([idle(touches, seed) for seed in range(12)])
    more = Touches(
        np.concatenate([touches.images, frames]),
        object=[*touches.object, *["nothing"] * 12],
        no_contact=touches.no_contact,
        geometry="plane",
    )
    recogniser = ObjectRecogniser().fit(more)
    assert recogniser.start().update(idle(touches, seed=99)).best == "nothing"


def test_the_paper_hears_everything(camera):
    _, touches = camera
    recogniser = ObjectRecogniser("corradi2015").fit(touches)
    row = recogniser.log_likelihood(Touches(idle(touches)[np.newaxis]))
    assert np.ptp(row) > 0


@pytest.mark.realdata
@pytest.mark.slow
def test_the_recorded_frame_moves_nothing(data_folder):
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    some = np.unique(touches.object)[[0, 12, 24]]
    touches = touches[np.isin(touches.object, some)][::2]
    recogniser = ObjectRecogniser().fit(touches)
    frame = touches.no_contact
    # Other exposure, and the camera moved by two pixels.
    moved = np.roll((0.9 * frame.astype(float)).astype(np.uint8), 2, axis=1)
    for image in (frame, moved):
        assert recogniser.evidence(Touches(image[np.newaxis])).flags == ["no contact"]
    assert np.mean([flag == "" for flag in recogniser.evidence(touches).flags]) > 0.8
