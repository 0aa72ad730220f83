"""What left-out touches tell: how evidence adds up, and whether turns matter."""

import numpy as np
import pytest
from scipy.special import log_softmax

from palpate._numbers import with_floor
from palpate.recognition import Evidence, ObjectRecogniser, SequenceCalibration
from palpate.recognition._calibration import (
    LENGTHS,
    draw_episodes,
    fit_sequence_calibration,
)
from palpate.recognition._learning import what_matters


def test_long_episodes_are_as_long_as_their_object_has_touches():
    objects = np.repeat(["a", "b", "c"], [40, 6, 2])
    drawn = draw_episodes(objects, seed=0)
    assert [(rows >= 0).sum(axis=1).tolist() for rows in drawn] == [
        [20] * 333,
        [6] * 333,
        [2] * 333,
    ]
    for name, rows in zip("abc", drawn, strict=True):
        assert rows.shape == (333, 20)
        for episode in rows:
            used = episode[episode >= 0]
            assert len(set(used)) == len(used)
            assert set(objects[used]) == {name}


@pytest.mark.parametrize("n_touches", [1, 3, 4, 5, 8, 9, 12, 19, 20])
def test_a_visit_lies_in_as_few_neighbouring_blocks_as_hold_it(n_touches):
    """Blocks of four touches form a ring: after the last comes the first."""
    objects, group = np.repeat(["a", "b"], 20), np.repeat(np.arange(10), 4)[::-1]
    drawn = np.concatenate(draw_episodes(objects, 0, blocks=group))[:, :n_touches]
    for episode in drawn:
        blocks = np.unique(group[episode]) % 5
        assert len(blocks) == -(-n_touches // 4)
        gaps = np.diff(np.append(blocks, blocks[0] + 5))
        assert (gaps > 1).sum() <= 1
        assert len(set(episode)) == n_touches
        assert len(set(objects[episode])) == 1
    # All places of the ring are begun at; without blocks they are mixed.
    assert len(np.unique(group[drawn[:, 0]])) == 10
    mixed = np.concatenate(draw_episodes(objects, 0))[:, :4]
    assert np.mean([len(set(group[visit])) for visit in mixed]) > 2


@pytest.mark.parametrize(
    ("n_objects", "n_each"), [(2, 500), (25, 40), (26, 38), (700, 1), (1500, 1)]
)
def test_a_thousand_long_episodes_at_most_are_drawn(n_objects, n_each):
    objects = np.repeat(np.arange(n_objects), 3)
    drawn = draw_episodes(objects, seed=0)
    assert {rows.shape for rows in drawn} == {(n_each, 3)}
    drawn_objects = [int(objects[rows[0, 0]]) for rows in drawn]
    assert len(set(drawn_objects)) == len(drawn_objects) == min(n_objects, 1000)
    # Of very many objects a thousand have an episode, spread over all.
    assert (drawn_objects[0], drawn_objects[-1]) == (0, n_objects - 1)
    assert np.diff(drawn_objects).max() <= 2
    again = draw_episodes(objects, seed=0)
    assert all(np.array_equal(a, b) for a, b in zip(again, drawn, strict=True))


def loss_of(calibration, floored, codes, episodes, prior):
    """Return the log loss episode by episode; each number of touches counts alike."""
    losses = []
    for length in LENGTHS:
        ends = []
        for episode in np.concatenate(episodes):
            episode = episode[episode >= 0]
            if len(episode) >= length:
                rows = floored[episode[:length]]
                rows = rows[np.ptp(rows, axis=1) > 0]
                total = calibration.weight(len(rows)) * rows.sum(axis=0)
                ends.append(log_softmax(total + prior)[codes[episode[0]]])
        if ends:
            losses.append(-np.mean(ends))
    return np.mean(losses)


@pytest.fixture(scope="module")
def repeated():
    """Touches of three objects that resemble their neighbours and are too sure."""
    rng = np.random.default_rng(8)
    codes = np.repeat(np.arange(3), 40)
    shared = np.repeat(rng.normal(size=(12, 3)), 10, axis=0)
    log_likelihood = 1.6 * (rng.normal(size=(120, 3)) / 2 + shared + np.eye(3)[codes])
    log_likelihood[::9] = 0.0  # no contact
    blocks = np.repeat(np.arange(12), 10)
    episodes = [rows[:30, :8] for rows in draw_episodes(codes, 0, blocks=blocks)]
    for rows in episodes:
        rows[:20, 3:] = -1  # shorter ones
    return with_floor(log_likelihood, 0.01), codes, episodes, np.log([0.5, 0.3, 0.2])


def test_the_fitted_calibration_is_of_least_loss(repeated):
    calibration = fit_sequence_calibration(*repeated)
    assert 0.1 < calibration.strength < 0.95
    assert 0.1 < calibration.correlation < 0.9
    least = loss_of(calibration, *repeated)
    for strength, correlation in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = SequenceCalibration(
            calibration.strength + 1e-3 * strength,
            calibration.correlation + 1e-3 * correlation,
        )
        assert loss_of(beside, *repeated) > least


def test_calibrations_stay_within_their_bounds(repeated):
    floored, codes, episodes, prior = repeated
    # Evidence that always misleads keeps a twentieth of its weight.
    wrong = fit_sequence_calibration(floored, (codes + 1) % 3, episodes, prior)
    assert wrong.strength == pytest.approx(0.05)
    # Evidence that never misleads has its full weight, as of independent touches.
    sure = fit_sequence_calibration(
        with_floor(9.0 * np.eye(3)[codes], 0.01), codes, episodes, prior
    )
    assert (sure.strength, sure.correlation) == pytest.approx((1, 0), abs=1e-5)
    assert sure.correlation > 0
    # Touches that repeat the evidence of the first are worth one.
    first = np.repeat(floored[1::10], 10, axis=0)
    blocks = np.repeat(np.arange(12), 10)
    same = [rows[:, :5] for rows in draw_episodes(codes, 0, blocks=blocks)]
    alike = fit_sequence_calibration(first, codes, same, prior)
    assert alike.correlation == pytest.approx(1, abs=1e-5)
    assert alike.correlation < 1


def test_a_label_left_out_whole_gets_the_least_likelihood_of_the_others(rng):
    images = rng.normal(size=(24, 2, 4)) + 3 * np.repeat(np.eye(8)[:3], 8, 0).reshape(
        24, 2, 4
    )
    labels = np.repeat(["a", "b", "c"], 8)
    groups = np.where(labels == "c", 9, np.arange(24) % 4)
    learnt = ObjectRecogniser("corradi2015").fit(images, labels, groups)
    log_likelihood = learnt.left_out_log_likelihood()
    assert np.isfinite(log_likelihood).all()
    assert (log_likelihood[16:, 2] == log_likelihood[16:, :2].min(axis=1)).all()


def test_evidence_taken_apart_is_put_together_again(rng):
    shapes = (5, 2), (5, 3), (5, 2, 3), (5, 3), (5, 7)
    features, log_likelihood, *others = (rng.normal(size=shape) for shape in shapes)
    flags = ["", "double contact", "", "saturated", ""]
    whole = Evidence(features, log_likelihood, flags, *others)
    alone = [whole.of_touch(k) for k in range(5)]
    assert [part.flags for part in alone] == [[flag] for flag in flags]
    assert whole.of_touch(-2).flags == ["saturated"]
    for beyond in (5, -6):
        with pytest.raises(IndexError, match=f"{beyond} is out of range: there are 5"):
            whole.of_touch(beyond)
    assert {len(array) for part in alone for array in part} == {1}
    for joined, original in zip(Evidence.together(alone), whole, strict=True):
        assert np.array_equal(joined, original)


@pytest.mark.parametrize(
    ("seeing", "blind", "sentence"),
    [
        (-0.1, -1.0, "turns matter here: as they come 85 %, blind to turns 38 %"),
        (-1.0, -0.1, "turns mislead here: as they come 85 %, blind to turns 38 %"),
        (-0.5, -0.5, "whether turns matter cannot be told here"),
    ],
)
def test_whether_turns_matter_is_said_in_a_sentence(seeing, blind, sentence, rng):
    noise = rng.normal(scale=0.1, size=100)
    own_posteriors = {"levels": seeing + noise, "moments": blind + noise[::-1]}
    figures = {
        "levels": {"log_loss": -seeing, "accuracy": 0.85, "blind_to": []},
        "moments": {"log_loss": -blind, "accuracy": 0.38, "blind_to": ["turns"]},
    }
    assert what_matters("turns", figures, own_posteriors).startswith(sentence)
    assert what_matters("shifts", figures, own_posteriors) is None
