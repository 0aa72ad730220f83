"""Principal components by share of variance, and what they leave out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.encodings import PrincipalShare


@pytest.fixture
def touches(rng):
    return rng.normal(size=(60, 12)) * np.linspace(3, 0.2, 12)


def test_kept_components_hold_the_share_and_no_fewer(touches):
    kept = PrincipalShare(0.9).fit(touches)
    total = touches.var(axis=0).sum()
    held = kept.transform(touches).var(axis=0).sum()
    assert held >= 0.9 * total
    without_last = kept.transform(touches)[:, :-1].var(axis=0).sum()
    assert without_last < 0.9 * total


def test_what_is_unexplained_is_the_distance_to_the_kept_plane(touches, rng):
    kept = PrincipalShare(0.8).fit(touches)
    new = rng.normal(size=(5, 12))
    scores = kept.transform(new)
    back = scores @ kept.components_ + kept.mean_
    variance = touches.var(axis=0).sum()
    assert_allclose(
        kept.unexplained(new, scores), ((new - back) ** 2).sum(axis=1) / variance
    )


def test_touches_explain_themselves_better_than_when_left_out(rng):
    # Ten touches span at most ten of 40 directions: none is explained by the others.
    few = rng.normal(size=(10, 40))
    kept = PrincipalShare(0.99).fit(few)
    inside = kept.unexplained(few, kept.transform(few))
    left_out = kept.left_out_unexplained(few, np.arange(10))
    assert inside.mean() < 0.05
    assert left_out.mean() > 0.5


def test_groups_are_left_out_whole(rng):
    direction = np.eye(8)
    groups = np.repeat(np.arange(5), 6)
    # Every group has a direction of its own, which the others cannot know.
    own = direction[groups] * rng.choice([-1, 1], size=(30, 1))
    own = own + 0.01 * rng.normal(size=(30, 8))
    kept = PrincipalShare(0.95).fit(own)
    assert kept.unexplained(own, kept.transform(own)).mean() < 0.05
    assert kept.left_out_unexplained(own, groups).min() > 0.7


def test_one_group_alone_is_not_unexplained(touches):
    kept = PrincipalShare().fit(touches)
    assert_allclose(kept.left_out_unexplained(touches, np.zeros(60, int)), 0)


def test_touches_all_alike_have_one_feature_that_is_zero():
    same = np.ones((4, 3))
    kept = PrincipalShare().fit(same)
    assert_allclose(kept.transform(same), np.zeros((4, 1)))
    assert_allclose(kept.unexplained(same, kept.transform(same)), 0)


@pytest.mark.parametrize("share", [0.0, 1.0, 1.5])
def test_a_share_outside_0_to_1_is_refused(touches, share):
    with pytest.raises(ValueError, match="share"):
        PrincipalShare(share).fit(touches)


@pytest.mark.parametrize("size", [2.0**-600, 2.0**500])
@pytest.mark.parametrize("n_touches", [6, 48])
def test_directions_do_not_depend_on_the_size_of_features(n_touches, size):
    features = np.random.default_rng(0).normal(size=(n_touches, 20))
    whole = PrincipalShare(0.9).fit(features).components_
    assert np.array_equal(PrincipalShare(0.9).fit(size * features).components_, whole)
