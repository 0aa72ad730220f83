"""Unknown scores: what they are made of, and how many known episodes they refuse."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.recognition import Trust, log_posteriors, with_floor
from palpate.recognition._landmarks import Landmarks
from palpate.recognition._unknown import (
    REFUSED,
    fit_unknown_scale,
    refusal_levels,
)

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
    return fit_unknown_scale(touches, novelty, codes, episodes, PRIOR, Trust())


def scores(scale, touches):
    return scale.scores(log_posteriors(touches, PRIOR, Trust()), touches)


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
    beliefs = [log_posteriors(t, PRIOR, Trust())[-1] for t in (few, many)]
    assert beliefs[1][0] >= beliefs[0][0]
    assert scores(learnt, many)[-1] > 5 * scores(learnt, few)[-1]


def test_touches_unlike_all_that_was_learnt_are_noticed(learnt):
    touches = np.log(np.tile([0.7, 0.1, 0.1, 0.1], (LENGTH, 1)))
    beliefs = log_posteriors(touches, PRIOR, Trust())
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


def test_nothing_below_one_in_twenty_is_refused_and_one_in_five_waits(learnt):
    for n_touches in (1, 2, 9):
        strict = learnt.refusal_threshold(n_touches, 0.5)
        assert strict >= 0.5 > learnt.naming_threshold(n_touches) >= 0.17


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
    assert levels[REFUSED.index(0.0)] == 0.0


def test_novelty_is_the_distance_to_the_nearest_landmark_of_another_stretch(rng):
    features = rng.normal(size=(60, 3))
    stretches = np.repeat(np.arange(6), 10)
    nothing = np.zeros(60, dtype=bool)
    nothing[0] = True
    marks = Landmarks.among(features, stretches, nothing)
    assert len(marks.features) == 59
    others = features[1:]
    unit = ((others - others.mean(axis=0)) ** 2).sum(axis=1).mean()
    new = rng.normal(size=(4, 3))
    distance = ((new[:, np.newaxis] - others) ** 2).sum(axis=-1)
    assert_allclose(marks.novelty(new), distance.min(axis=1) / unit)
    assert_allclose(marks.novelty(features[1:]), 0, atol=1e-12)
    own = marks.novelty(features, stretches)
    far = ((features[10] - features[20:]) ** 2).sum(axis=1).min()
    near = ((features[10] - features[1:10]) ** 2).sum(axis=1).min()
    assert own[10] == pytest.approx(min(far, near) / unit)


def test_many_touches_leave_a_thousand_landmarks(rng):
    features = rng.normal(size=(2500, 2))
    stretches = np.zeros(2500, dtype=int)
    marks = Landmarks.among(features, stretches, np.ones(2500, dtype=bool))
    assert len(marks.features) == 1000
    assert_allclose(marks.novelty(features, stretches), 0)
