"""Recentring: what a session adds, estimated without labels."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.recognition import OTHER_SESSION, ObjectRecogniser, Recentring, adapt

CENTRES = 4 * np.random.default_rng(9).normal(size=(6, 10))


def _day(offset, seed, objects="abcdef", n_each=1):
    rng = np.random.default_rng(seed)
    names = np.tile(list(objects), n_each)
    images = CENTRES[["abcdef".index(o) for o in names]] + offset
    images = images + rng.normal(size=images.shape)
    return Touches(images[:, None], object=names, geometry="none")


@pytest.fixture(scope="module")
def learnt():
    return ObjectRecogniser().fit(_day(0.0, 0, n_each=12))


def test_recentring_touch_by_touch_ends_where_all_touches_at_once_do(learnt):
    there, today = _day(3.0, 1, n_each=4), Recentring(learnt)
    offsets = []
    for k in range(len(there)):
        today.start().update(there[k : k + 1])
        offsets.append(today.recogniser.encoder_.offset)
    assert today.n_touches == len(there)
    at_once = Recentring(learnt)
    at_once.start().update(there)
    assert_allclose(offsets[-1], at_once.recogniser.encoder_.offset, atol=1e-9)
    # Without a jump: of n touches one moves the mean, and what is held back of it, by
    # an n-th.
    features = learnt.evidence(there).features
    steps = np.linalg.norm(np.diff(offsets, axis=0), axis=1)
    widest = np.linalg.norm(features - features.mean(axis=0), axis=1).max()
    assert (steps * np.arange(2, len(there) + 1)).max() < 2 * widest
    # Other touches of the session lie where those of training do, to within a third.
    others, middle = _day(3.0, 2, n_each=5), learnt.learnt().taught.means.mean(axis=0)
    before = learnt.evidence(others).features.mean(axis=0) - middle
    after = today.recogniser.evidence(others).features.mean(axis=0) - middle
    assert np.linalg.norm(after) < np.linalg.norm(before) / 3


def test_a_belief_that_was_begun_moves_with_the_recentring(learnt):
    there = _day(3.0, 1, n_each=6)
    touches_of_a = there[np.flatnonzero(there.object == "a")]
    today = Recentring(learnt)
    for k in range(30):
        today.start().update(there[k : k + 1])
    today.start().update(touches_of_a[:1])
    belief = today.update(touches_of_a[1:3])
    afresh = today.recogniser.start().update(touches_of_a[:3])
    # All three touches of the episode are recentred by what is known after the last.
    assert belief.touches_used == 3
    assert belief.posterior == pytest.approx(afresh.posterior)


@pytest.mark.parametrize("options", [{"strangers": 2}, {"prior": {"a": 1.0}}])
def test_a_wrong_share_is_refused_when_an_episode_begins(learnt, options):
    there, today = _day(3.0, 1), Recentring(learnt)
    today.start().update(there[0])
    with pytest.raises(ValueError, match=f"{next(iter(options))} must"):
        today.start(**options)
    # The episode under way goes on.
    assert today.update(there[0]).touches_used == 2
    assert today.n_touches == 2


def test_the_recogniser_that_was_learnt_stays_as_it_is(learnt):
    there = _day(3.0, 1, n_each=2)
    before = learnt.log_likelihood(there)
    Recentring(learnt).start().update(there)
    assert_allclose(learnt.log_likelihood(there), before, rtol=0, atol=0)


def test_a_session_without_labels_promises_less_in_the_same_words(learnt):
    there = _day(3.0, 1, n_each=4)
    unlabelled = adapt(learnt, there.without("object"))
    two = adapt(learnt, _day(3.0, 1, "ab", n_each=4))
    for belief in (
        unlabelled.start().update(there[:1]),
        two.start().update(there[:1]),
        Recentring(learnt).start().update(there[:1]),
    ):
        assert belief.promise().other_session
        assert str(belief.promise()).endswith(OTHER_SESSION)
        assert sum(OTHER_SESSION in sentence for sentence in belief.why()) == 1
    for recogniser in (learnt, adapt(learnt, there)):  # confirmed touches are left out
        belief = recogniser.start().update(there[:1])
        assert not belief.promise().other_session
        assert not any(OTHER_SESSION in sentence for sentence in belief.why())
    assert two.chosen_["remount"]["confirm"] == list("cdef")
    two.replace_objects(None, forget=[*"cdef"])  # those left are confirmed
    assert two.chosen_["remount"]["confirm"] == []
    assert not two.start().promise().other_session


def test_beliefs_repeat_an_alarm_until_touches_are_confirmed(learnt, tmp_path):
    there = _day(3.0, 1, n_each=4)
    recogniser = adapt(learnt, _day(0.0, 2, n_each=4))
    assert not recogniser.start().promise().other_session
    assert recogniser.check_mounting(there).changed
    episode = recogniser.episode()
    episode.add(there[0])
    for belief in (recogniser.start(), episode.belief):
        assert belief.promise().other_session
        assert sum(OTHER_SESSION in sentence for sentence in belief.why()) == 1
    stored = ObjectRecogniser.load(recogniser.save(tmp_path / "m.palpate"))
    assert not stored.start().promise().other_session  # an alarm is of today
    belief = recogniser.remount(there).start()
    assert not belief.promise().other_session
    assert not any(OTHER_SESSION in sentence for sentence in belief.why())
