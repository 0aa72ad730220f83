"""What left-out training touches say of episodes to come.

How evidence adds up, what unknown scores are made of, and how many known episodes they
refuse.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.recognition import (
    ObjectRecogniser,
    SequenceCalibration,
    log_posteriors,
    with_floor,
)
from palpate.recognition._calibration import draw_episodes, fit_sequence_calibration
from palpate.recognition._memory import blocks_in_order
from palpate.recognition._unknown import (
    REFUSED,
    fit_unknown_scale,
    refusal_levels,
)
from palpate.simulation import DomeCamera, simulate_touches

N_OBJECTS, N_EACH, LENGTH = 4, 400, 5
PRIOR = np.full(N_OBJECTS, -np.log(N_OBJECTS))


def floored(rng, codes, gain=2.0):
    """Draw log-likelihoods of touches that favour the object with their code."""
    evidence = rng.normal(size=(len(codes), N_OBJECTS))
    evidence[np.arange(len(codes)), codes] += gain
    return with_floor(evidence, 0.01)


@pytest.fixture
def learnt(rng):
    codes = np.repeat(np.arange(N_OBJECTS), N_EACH)
    touches = floored(rng, codes)
    rows = np.arange(len(codes)).reshape(-1, LENGTH)
    episodes = {k: rows[:, :k] for k in (1, 3, LENGTH)}
    novelty = rng.exponential(0.3, len(codes))
    return fit_unknown_scale(
        touches, novelty, codes, episodes, PRIOR, SequenceCalibration()
    )


def scores(scale, touches):
    return scale.scores(log_posteriors(touches, PRIOR, SequenceCalibration()), touches)


def episodes_of(rng, gain):
    codes = np.repeat(np.arange(N_OBJECTS), N_EACH)
    return floored(rng, codes, gain).reshape(-1, LENGTH, N_OBJECTS)


def test_limits_are_exceeded_by_the_stated_share(learnt, rng):
    known = scores(learnt, episodes_of(rng, 2.0))
    assert ((known >= 0) & (known <= 1)).all()
    for k in (1, 3, LENGTH):
        above = known[:, k - 1] > learnt.threshold(k, 0.05)
        # 320 new episodes: three standard errors.
        assert above.mean() == pytest.approx(0.05, abs=0.037)


def test_touches_that_fit_no_object_score_higher(learnt, rng):
    known = scores(learnt, episodes_of(rng, 2.0))[:, -1]
    unknown = scores(learnt, episodes_of(rng, 0.5))[:, -1]
    assert np.median(unknown) > np.quantile(known, 0.95)


def test_a_sharp_belief_of_poor_touches_is_noticed(learnt):
    """Doubt alone would call these known: their posterior is as sharp."""
    few = np.log(np.tile([0.700, 0.100, 0.100, 0.100], (2, 1)))
    many = np.log(np.tile([0.424, 0.192, 0.192, 0.192], (LENGTH, 1)))
    beliefs = [log_posteriors(t, PRIOR, SequenceCalibration())[-1] for t in (few, many)]
    assert beliefs[1][0] >= beliefs[0][0]
    assert scores(learnt, many)[-1] > 5 * scores(learnt, few)[-1]


def test_touches_that_the_encoding_cannot_explain_are_noticed(learnt):
    touches = np.log(np.tile([0.7, 0.1, 0.1, 0.1], (LENGTH, 1)))
    beliefs = log_posteriors(touches, PRIOR, SequenceCalibration())
    plain = learnt.scores(beliefs, touches)
    usual, new = np.full(LENGTH, 0.3), np.full(LENGTH, 3.0)
    assert_allclose(learnt.scores(beliefs, touches, usual), plain)
    assert_allclose(learnt.scores(beliefs, touches, np.full(LENGTH, np.nan)), plain)
    assert (learnt.scores(beliefs, touches, new) > 0.9).all()


def test_touches_that_say_nothing_leave_the_score(learnt):
    touch = np.log([[0.7, 0.1, 0.1, 0.1]])
    nothing = np.full((3, N_OBJECTS), -np.log(N_OBJECTS))
    alone = scores(learnt, np.vstack([nothing, touch, nothing]))
    assert_allclose(alone[:3], 0)
    assert_allclose(alone[3:], scores(learnt, touch)[0])


def test_episodes_together_score_as_one_by_one(learnt, rng):
    many = episodes_of(rng, 1.0)
    assert_allclose(scores(learnt, many)[7], scores(learnt, many[7]))


def test_what_is_refused_is_rarer_than_what_waits(learnt):
    for n_touches in (1, 2, 9):
        rare, rarest = (learnt.refusal_threshold(n_touches, e) for e in (0.05, 0.001))
        # One in twenty of normal scores is above 0.5, one in a thousand above 0.947.
        assert 0.5 <= rare <= rarest
        assert rarest >= 0.947
        assert 0.17 <= learnt.naming_threshold(n_touches) < rare


def test_asking_after_every_touch_refuses_no_more_than_allowed():
    rng = np.random.default_rng(0)
    lengths = np.arange(1.0, 11.0)
    never_named = np.ones((4000, 10))
    # Scores that wander independently: ten chances to exceed a limit.
    known = rng.uniform(0.6, 1, (4000, 10))
    limits = np.quantile(known, 1 - np.array(REFUSED), axis=0).T
    levels = refusal_levels(known, never_named, lengths, limits)
    assert (np.diff(levels) >= 0).all()
    new = rng.uniform(0.6, 1, (4000, 10))
    for share in (0.05, 0.1, 0.2):
        level = np.interp(share, REFUSED, levels)
        limit = np.array([np.interp(level, REFUSED, row) for row in limits])
        ever = (new > limit).any(axis=1).mean()
        # The grid of levels has steps of a quarter; 4000 episodes add half a per cent.
        assert 0.7 * share < ever < share + 0.012
        # Without it, ten chances of `share` each would refuse far more.
        plain = np.array([np.interp(share, REFUSED, row) for row in limits])
        assert (new > plain).any(axis=1).mean() > 2.5 * share


def test_an_episode_that_is_named_early_cannot_be_refused_later():
    scores_ = np.tile([0.1, 0.9], (50, 1))
    limits = np.full((2, len(REFUSED)), 0.6)
    lengths = np.array([1.0, 2.0])
    sure = np.tile([0.005, 0.005], (50, 1))
    levels = refusal_levels(scores_, sure, lengths, limits)
    assert levels[REFUSED.index(0.01)] == 0.5
    # Who never names may refuse nothing: only limits above 0.9 keep to that.
    assert levels[REFUSED.index(0.0)] < 0.005


def test_a_thing_unlike_all_that_was_learnt_is_called_unknown():
    """A ball of spikes beside smooth household objects, on a simulated dome."""
    camera = DomeCamera(image_shape=(96, 96), n_nodes=40)
    names = ("ball", "box", "mug", "pen", "stapler", "toothbrush")
    learnt = simulate_touches(names, 40, camera, drift=False, random_state=0)
    recogniser = ObjectRecogniser().fit(learnt)
    again = simulate_touches(
        (*names, "massage ball"), 12, camera, drift=False, random_state=1
    )
    ends = {}
    for name, _, rows in again.episodes():
        belief = recogniser.start()
        for touch in again[rows]:
            if (end := belief.update(touch).decide(0.05)) is not None:
                break
        ends[name] = end
    assert ends.pop("massage ball") == "unknown"
    right = [name == end for name, end in ends.items()]
    assert sum(right) >= 5
    assert "unknown" not in ends.values()


def test_blocks_follow_the_recording():
    objects = np.repeat(["a", "b"], 10)
    order = np.tile(np.arange(10)[::-1], 2)
    group = blocks_in_order(objects, order)
    assert group[:10].tolist() == [4, 4, 3, 3, 2, 2, 1, 1, 0, 0]
    assert not set(group[:10]) & set(group[10:])


def test_an_object_with_few_touches_has_few_blocks():
    assert blocks_in_order(np.array(["a", "a", "b"])).tolist() == [0, 1, 2]


def test_episodes_come_from_one_object_and_few_blocks(rng):
    objects = np.repeat(["a", "b"], [30, 6])
    group = blocks_in_order(objects)
    rows = draw_episodes(objects, group, 6, rng)
    for episode in rows:
        assert len(set(objects[episode])) == 1
        assert len(set(episode)) == 6
    of_a = rows[objects[rows[:, 0]] == "a"]
    assert all(len(set(group[episode])) == 1 for episode in of_a)
    assert len(draw_episodes(objects, group, 7, rng)) == len(of_a)


def test_repeated_touches_weigh_less_than_independent_ones(rng):
    n_objects, n_each = 4, 200
    codes = np.repeat(np.arange(n_objects), n_each)
    noise = rng.normal(size=(len(codes), n_objects))
    blocks = np.repeat(noise[::10], 10, axis=0)

    def calibrated(evidence):
        likelihood = evidence.copy()
        likelihood[np.arange(len(codes)), codes] += 1.0
        episodes = {
            k: np.arange(len(codes)).reshape(-1, 10)[:, :k] for k in (1, 2, 5, 10)
        }
        prior = np.full(n_objects, -np.log(n_objects))
        return fit_sequence_calibration(likelihood, codes, episodes, prior)

    # N(c, 1) evidence with a gap of 1 is a proper likelihood: weight 1.
    independent, repeated = calibrated(noise), calibrated(blocks)
    assert independent.strength == pytest.approx(1, abs=0.25)
    assert independent.correlation < 0.1
    assert repeated.correlation > 0.5
