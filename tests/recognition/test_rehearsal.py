"""Rehearsed sessions: what is drawn, what is not, how far it counts."""

import json
from copy import copy
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.classifiers import EncodingPool
from palpate.recognition import ObjectRecogniser, sessions_message
from palpate.recognition._rehearsal import (
    Drawn,
    Ranges,
    _and_confirmed,
    _replays,
    _trust_in_one,
    at_rest,
    in_another_session,
)
from palpate.recognition._sessions import (
    Parts,
    Taught,
    session_effects,
    shift_by_labels,
)

SIDE = 14


def _presses(n_each, seed, change=lambda images: images, **columns):
    """Four shapes on an array, pressed at nearly the same place."""
    rng = np.random.default_rng(seed)
    rows, cols = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    shapes = [
        np.exp(-(rows**2) / 4 - cols**2 / 20),
        np.exp(-(rows**2) / 20 - cols**2 / 4),
        np.exp(-(rows**2 + cols**2) / 12),
        np.exp(-((np.hypot(rows, cols) - 4) ** 2) / 3),
    ]
    images = np.repeat(shapes, n_each, axis=0)
    images = images * rng.uniform(0.6, 1.4, (len(images), 1, 1))
    images = 100 * np.maximum(images + rng.normal(0, 0.1, images.shape), 0) + 20
    names = np.repeat(["bar", "pole", "spot", "ring"], n_each)
    return Touches(change(images), object=names, geometry="array", **columns)


@pytest.fixture(scope="module")
def both():
    touches = _presses(12, 0)
    return [ObjectRecogniser(rehearse=r).fit(touches) for r in (False, True)]


def test_rehearsal_is_the_default_and_reports_what_was_drawn(both):
    plain, rehearsed = both
    assert "rehearsal" not in plain.chosen_
    record = rehearsed.chosen_["rehearsal"]
    assert 0 <= record["share"] <= 1
    assert record["told_by"] == "rehearsed sessions"
    assert set(record["drawn"]) == {"gain", "taxels", "zero", "shift"}
    assert any(
        "rehearsed sessions" in sentence for sentence in rehearsed.chosen_["found"]
    )
    kinds = {type(m) for m in rehearsed.classifier_.machines_.values()}
    assert (kinds == {EncodingPool.MACHINES[2]}) == (record["share"] > 0)


def test_rehearsal_leaves_encoding_and_memory_as_they_are(both):
    plain, rehearsed = both
    assert_array_equal(plain.memory_.features, rehearsed.memory_.features)
    assert list(plain.classifier_.weights_) == list(rehearsed.classifier_.weights_)


def test_another_baseline_costs_less_where_it_was_rehearsed(both):
    rng = np.random.default_rng(5)
    slope = np.linspace(-1, 1, SIDE)
    lost = []
    for recogniser in both:
        shares = []
        for _ in range(8):
            field = 25 * (rng.normal() * slope + rng.normal() * slope[:, None])
            there = _presses(10, 7, lambda i, f=field: np.maximum(i + f, 1))
            shares.append(recogniser.score(there))
        lost.append(1 - np.mean(shares))
    assert lost[1] <= lost[0] + 0.03  # three standard errors of 320 touches


def test_a_rehearsed_recogniser_is_saved_and_taught_more(both, tmp_path):
    rehearsed = both[1]
    there = _presses(3, 9)
    again = ObjectRecogniser.load(rehearsed.save(tmp_path / "m.palpate"))
    assert_array_equal(again.log_likelihood(there), rehearsed.log_likelihood(there))
    again.extend_object("bar", there[:3])
    again.forget_object("spot")
    assert again.classes_.tolist() == ["bar", "pole", "ring"]
    assert again.log_likelihood(there).shape == (12, 3)


def test_the_same_seed_gives_the_same_to_the_bit(both):
    again = ObjectRecogniser().fit(_presses(12, 0))
    there = _presses(3, 9)
    assert_array_equal(again.log_likelihood(there), both[1].log_likelihood(there))
    assert again.chosen_ == both[1].chosen_
    assert again.sequence_calibration_ == both[1].sequence_calibration_
    strangers = again.strangers_, both[1].strangers_
    assert_array_equal(*(model.exceeded for model in strangers))


def test_labels_of_nearly_one_group_each_leave_nothing_to_be_asked():
    """Of the one touch that is of a group of its own none is drawn."""
    touches = _presses(6, 0)
    groups = np.where(np.arange(len(touches)) == 1, "the last", touches.object)
    learnt = ObjectRecogniser().fit(touches, groups=groups)
    json.dumps(learnt.summary(), allow_nan=False)
    assert learnt.chosen_["rehearsal"].keys() == {"share", "told_by", "drawn", "trust"}
    assert "expect less than today" in sessions_message(learnt.across_sessions())


def test_vectors_are_not_rehearsed():
    rng = np.random.default_rng(0)
    names = np.repeat(["a", "b"], 10)
    images = rng.normal(size=(20, 1, 6))
    recogniser = ObjectRecogniser().fit(Touches(images, object=names, geometry="none"))
    record = recogniser.chosen_["rehearsal"]
    assert record["share"] == 0
    assert "vectors" in record["why"]
    assert isinstance(recogniser.classifier_, EncodingPool)


def test_sessions_or_persons_left_out_give_the_share_of_rehearsal():
    days = [
        _presses(6, k, session=[f"day {k}"] * 24, order=np.arange(24)) for k in range(3)
    ]
    touches = Touches.concatenate(days)
    recogniser = ObjectRecogniser().fit(touches)
    assert recogniser.chosen_["rehearsal"]["told_by"] == "sessions left out"
    # Two persons, who come again and again, are left out whole instead.
    of_persons = touches.with_columns(subject=np.resize(["ann", "bob"], len(touches)))
    chosen = ObjectRecogniser().fit(of_persons).chosen_
    assert chosen["rehearsal"]["told_by"] == "persons left out"
    assert "as tests on persons left out showed" in chosen["found"][-1]


@pytest.mark.parametrize(
    ("presentation", "changes", "drawn"),
    [
        ("shifted", {"shifts"}, ["gain", "taxels", "zero"]),
        ("any", {"shifts", "gain"}, ["taxels", "zero"]),
    ],
)
def test_nothing_is_drawn_that_all_encodings_are_blind_to(presentation, changes, drawn):
    recogniser = ObjectRecogniser(presentation=presentation).fit(_presses(6, 0))
    blind = [recogniser.encoder_.blind_to(n) for n in recogniser.encoder_.encodings]
    assert frozenset.intersection(*blind) >= changes
    record = recogniser.chosen_["rehearsal"]
    assert record["drawn"] == drawn
    assert "expected" in record


def another(touches, rng, **ranges):
    return in_another_session(touches, Ranges(**ranges), rng, at_rest(touches))


def test_a_drawn_session_changes_all_touches_alike():
    touches = _presses(3, 0)
    rng = np.random.default_rng(1)
    images = another(touches, rng, gain=0.3, taxels=0.2)
    gains = images / touches.images
    # One gain a taxel, whatever the touch.
    assert np.ptp(gains, axis=0).max() < 1e-9
    assert gains[0].std() > 0.05


def test_nothing_is_added_where_rest_is_zero_and_types_are_kept():
    levels = np.zeros((6, SIDE, SIDE), dtype=np.uint8)
    levels[:, 3:6, 3:6] = 200
    touches = Touches(levels, geometry="array")
    rng = np.random.default_rng(2)
    images = another(touches, rng, zero=0.3, gain=1.0)
    assert images.dtype == np.uint8
    away = np.ones((SIDE, SIDE), dtype=bool)
    away[3:6, 3:6] = False
    assert not images[:, away].any()


def test_pads_are_moved_one_by_one_and_gaps_stay():
    images = np.full((2, 8, 17), np.nan)
    images[:, :, :8] = 0.0
    images[:, :, 9:] = 0.0
    images[:, 2:5, 5:8] = 1.0
    pads = [[0, 0, 8, 8], [0, 9, 8, 8]]
    touches = Touches(images, geometry="array", pads=pads)
    rng = np.random.default_rng(3)
    moved = another(touches, rng, shift=0.3)
    assert_array_equal(np.isnan(moved), np.isnan(images))
    assert not moved[:, :, 9:].any()  # what left the first pad is not on the other


def test_the_accuracy_to_expect_of_another_day_is_reported(both):
    plain, rehearsed = both
    across = rehearsed.across_sessions()
    for expected in (across["rehearsed"], across["confirmed"]):
        low, high = expected
        assert 0 <= low <= high <= 1
    there = copy(rehearsed).remount(_presses(1, 4)[:3])
    assert there.chosen_["remount"]["confirm"] == ["ring"]
    assert there.chosen_["remount"]["expected"] == across["confirmed"]
    # Nothing was rehearsed: nothing is promised.
    assert not {"rehearsed", "confirmed"} & set(plain.across_sessions())


def _memory_of(features, labels):
    classes, blocks = np.unique(labels), np.arange(len(labels))
    return SimpleNamespace(
        features=features, labels=labels, classes=classes, blocks=blocks
    )


def test_one_confirmed_touch_of_each_moves_a_rehearsed_session_back(rng):
    labels = np.repeat(list("abcde"), 6)
    features = np.repeat(9.0 * rng.normal(size=(5, 4)), 6, axis=0)
    features += 0.1 * rng.normal(size=features.shape)
    memory = _memory_of(features, labels)
    rows = np.arange(0, 30, 3)
    drawn = Drawn(np.stack([features[rows], features[rows] + 5.0]), rows)
    more = _and_confirmed(drawn, memory, Parts(np.array([0, 4])))
    assert (len(more.features), more.n_weighing) == (3, 1)
    assert_array_equal(more.features[:2], drawn.features)
    # Noise of 0.1 in each value, a mean of five touches: six standard deviations.
    assert np.abs(more.features[2] - drawn.features[0]).max() < 0.3


def _rehearsed_by(moves, rng):
    """Return the pool, memory, draws and parts of four objects in a row, so moved.

    `moves` (n_sessions, 4, 1) is how far along the row, of each object in a session.
    """
    labels = np.repeat(list("abcd"), 12)
    features = rng.normal(0, 0.5, (48, 2))
    features[:, 0] += 4.0 * np.repeat(np.arange(4), 12)
    memory = _memory_of(features, labels)
    moved = features + np.repeat(moves, 12, axis=1) * [1, 0]
    drawn = Drawn(np.concatenate([features[np.newaxis], moved]), np.arange(48))
    pool = EncodingPool({"levels": 2}).fit(features, labels, groups=memory.blocks)
    return pool, memory, drawn, Parts(np.array([0, 2]))


def test_one_object_is_trusted_where_rehearsed_sessions_move_all_alike(rng):
    to_one_side = 1.5 * rng.choice([-1, 1], size=(5, 1, 1))
    alike, opposite = np.ones((4, 1)), np.array([1, -1, 1, -1])[:, None]
    for moves, trust in ((alike, 1.0), (opposite, 0.0)):
        replays = [*_replays(*_rehearsed_by(to_one_side * moves, rng), 0)]
        assert len(replays) == 10
        assert _trust_in_one(replays) == trust


def test_of_one_confirmed_object_as_much_is_used_as_it_is_trusted(both):
    learnt = both[1]
    there = _presses(6, 4, lambda images: 1.5 * images + 30)
    confirmed, others = there[:1], there[6:]
    moved, right, gains = [], [], []
    for trust in (0.0, 0.5, 1.0):
        there = copy(learnt)
        there.chosen_ = {**learnt.chosen_, "rehearsal": {"share": 0.0, "trust": trust}}
        there.remount(confirmed)
        record = there.chosen_["remount"]
        assert record["trust"] == trust
        assert record.get("weight", 0.0) == trust**2
        assert len(there.memory_) == len(learnt.memory_) + (trust > 0)
        moved.append(record["moved"])
        gains.append(record["gain"])
        right.append(there.score(others))
    # Without trust neither the gain nor the shift nor the touch itself is used.
    assert (moved[0], gains[0]) == (0, 1)
    assert min(moved[1:]) > 0
    assert min(gains) < 1
    assert right[0] == learnt.score(others)
    # One touch of each of four objects takes three quarters of the mistrust away.
    there.chosen_ = {**learnt.chosen_, "rehearsal": {"share": 0.0, "trust": 0.0}}
    there.remount(_presses(1, 4))
    assert there.chosen_["remount"]["trust"] == 0.75


def test_objects_of_one_touch_each_are_not_confirmed():
    memory = _memory_of(np.eye(3), np.array(list("abc")))
    drawn = Drawn(np.stack([np.eye(3), np.eye(3) + 1]), np.arange(3))
    same = _and_confirmed(drawn, memory, Parts(np.array([0, 3])))
    assert_array_equal(same.features, drawn.features)


def test_effects_are_those_of_least_squares_over_all_unknowns(rng):
    """One of the four objects of a session is met in the next one too."""
    sessions = np.repeat(np.arange(12), 8)
    codes = np.repeat(3 * np.arange(12)[:, np.newaxis] + np.arange(4), 2)
    features = rng.normal(size=(37, 3))[codes] + rng.normal(size=(12, 3))[sessions]
    features += rng.normal(size=features.shape)
    design = np.hstack([np.eye(37)[codes], np.eye(12)[sessions]])
    added = np.linalg.lstsq(design, features, rcond=None)[0][37:][sessions]
    effects = session_effects(features, codes, sessions)
    assert_allclose(effects, added - added.mean(axis=0), atol=1e-9)


def test_sessions_that_share_no_object_add_nothing(rng):
    codes, sessions = np.repeat([0, 1, 2, 3], 3), np.repeat([0, 0, 1, 1], 3)
    effects = session_effects(rng.normal(size=(12, 2)), codes, sessions)
    assert_allclose(effects, 0, atol=1e-9)


def test_one_confirmed_touch_tells_no_more_than_places_of_its_object_differ():
    codes, sides = np.repeat([0, 1, 2], 4), np.tile([1.0, 1, -1, -1], 3)
    features = 20.0 * codes[:, None] + np.outer(sides, np.ones(5))
    taught = Taught(features, codes, Parts(np.array([0, 5])))
    # Of each object two places, whose touches are alike: one of them lies the square
    # root of 5 from the mean of both, the standard deviation is the root of 20 / 3.
    assert taught.within == pytest.approx(20 / 3)
    assert not shift_by_labels(features[:1], codes[:1], taught).any()
    # Ten from the mean in each value: all is told but the share of the noise.
    shift = shift_by_labels(features[:1] + 9.0, codes[:1], taught)
    assert_allclose(shift, -10 * (1 - (20 / 3) / 500))
