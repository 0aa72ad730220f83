"""How evidence adds up, and the episodes that show it."""

import numpy as np
import pytest

from palpate.recognition._calibration import (
    draw_asked,
    draw_episodes,
    fit_sequence_calibration,
)
from palpate.recognition._memory import blocks_in_order


def test_blocks_follow_the_recording():
    objects = np.repeat(["a", "b"], 10)
    order = np.tile(np.arange(10)[::-1], 2)
    group = blocks_in_order(objects, order)
    assert group[:10].tolist() == [4, 4, 3, 3, 2, 2, 1, 1, 0, 0]
    assert not set(group[:10]) & set(group[10:])


def test_an_object_with_few_touches_has_few_blocks():
    assert blocks_in_order(np.array(["a", "a", "b"])).tolist() == [0, 1, 2]


def test_episodes_come_from_one_object_and_few_blocks(rng):
    objects = np.repeat(["a", "b", "c"], [30, 6, 6])
    group = blocks_in_order(objects)
    rows = draw_episodes(objects, group, 6, rng)
    for episode in rows:
        assert len(set(objects[episode])) == 1
        assert len(set(episode)) == 6
    of_a = rows[objects[rows[:, 0]] == "a"]
    assert all(len(set(group[episode])) == 1 for episode in of_a)
    assert len(draw_episodes(objects, group, 7, rng)) == len(of_a)


def test_long_episodes_are_as_long_as_their_object_has_touches():
    objects = np.repeat(["a", "b", "c"], [40, 6, 2])
    drawn = draw_asked(objects, blocks_in_order(objects), seed=0)
    assert [(rows >= 0).sum(axis=1).tolist() for rows in drawn] == [
        [20] * 40,
        [6] * 40,
        [2] * 40,
    ]
    for name, rows in zip("abc", drawn, strict=True):
        assert rows.shape == (40, 20)
        for episode in rows:
            used = episode[episode >= 0]
            assert len(set(used)) == len(used)
            assert set(objects[used]) == {name}
    many = np.repeat(np.arange(3000), 2)
    drawn = draw_asked(many, blocks_in_order(many), seed=0)
    assert sum(map(len, drawn)) <= 1000
    assert {rows.shape[1] for rows in drawn} == {2}


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
