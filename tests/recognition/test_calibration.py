"""How evidence adds up, and the episodes that show it."""

import numpy as np
import pytest

from palpate.recognition import (
    Modality,
    ObjectRecogniser,
    SequenceCalibration,
    log_posteriors,
    with_floor,
)
from palpate.recognition._calibration import (
    LENGTHS,
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
    many = np.repeat(np.arange(3000), 2)
    drawn = draw_episodes(many, seed=0)
    assert sum(map(len, drawn)) <= 1000
    assert {rows.shape[1] for rows in drawn} == {2}


def test_touches_that_share_what_their_block_adds_weigh_less(rng):
    codes = np.repeat(np.arange(4), 200)
    blocks = np.repeat(np.arange(80), 10)

    def calibrated(share):
        noise = rng.normal(size=(len(codes), 4))
        shared = np.repeat(rng.normal(size=(80, 4)), 10, axis=0)
        said = np.sqrt(share) * shared + np.sqrt(1 - share) * noise
        said[np.arange(len(codes)), codes] += 1.0
        episodes = [rows[:, :10] for rows in draw_episodes(codes, 0, blocks=blocks)]
        prior = np.full(4, -np.log(4))
        return fit_sequence_calibration(said, codes, episodes, prior)

    # N(c, 1) evidence with a gap of 1 is a proper likelihood: weight 1.
    independent, repeated = calibrated(0.0), calibrated(0.8)
    assert independent.strength == pytest.approx(1, abs=0.25)
    assert independent.correlation < 0.1
    # What k touches tell has the variance 0.8 + 0.2 / k: the design effect of 0.8.
    assert repeated.correlation == pytest.approx(0.8, abs=0.2)


@pytest.mark.parametrize("n_touches", [1, 3, 4, 5, 8, 9, 12, 19, 20])
def test_a_visit_lies_in_as_few_neighbouring_blocks_as_hold_it(n_touches):
    """Blocks of four touches, in a ring: after the last comes the first."""
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
    assert np.mean([len(set(group[one])) for one in mixed]) > 2


@pytest.mark.parametrize(
    ("n_objects", "n_each"), [(2, 500), (25, 40), (26, 38), (700, 1), (1500, 1)]
)
def test_a_thousand_long_episodes_at_most_are_drawn(n_objects, n_each):
    objects = np.repeat(np.arange(n_objects), 3)
    drawn = draw_episodes(objects, seed=0)
    assert {rows.shape for rows in drawn} == {(n_each, 3)}
    whose = [int(objects[rows[0, 0]]) for rows in drawn]
    assert len(set(whose)) == len(whose) == min(n_objects, 1000)
    # Of very many some are asked, spread over all.
    assert (whose[0], whose[-1]) == (0, n_objects - 1)
    assert np.diff(whose).max() <= 2
    again = draw_episodes(objects, seed=0)
    assert all(np.array_equal(a, b) for a, b in zip(again, drawn, strict=True))


def loss_of(calibration, floored, codes, episodes, prior):
    """Return the log loss after each number of touches, all alike, one by one."""
    losses = []
    for length in LENGTHS:
        ends = [
            log_posteriors(floored[one[:length]], prior, calibration)[-1][codes[one[0]]]
            for one in np.concatenate(episodes)
            if len(one) >= length
        ]
        if ends:
            losses.append(-np.mean(ends))
    return np.mean(losses)


@pytest.fixture(scope="module")
def repeated():
    """Touches of three objects that resemble their neighbours and are too sure."""
    rng = np.random.default_rng(8)
    codes = np.repeat(np.arange(3), 40)
    shared = np.repeat(rng.normal(size=(12, 3)), 10, axis=0)
    said = 1.6 * (rng.normal(size=(120, 3)) / 2 + shared + np.eye(3)[codes])
    said[::9] = 0.0  # no contact
    blocks = np.repeat(np.arange(12), 10)
    episodes = [rows[:30, :8] for rows in draw_episodes(codes, 0, blocks=blocks)]
    return with_floor(said, 0.01), codes, episodes, np.log([0.5, 0.3, 0.2])


def test_the_calibration_found_is_of_least_loss(repeated):
    found = fit_sequence_calibration(*repeated)
    assert 0.1 < found.strength < 0.95
    assert 0.1 < found.correlation < 0.9
    least = loss_of(found, *repeated)
    for strength, correlation in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = SequenceCalibration(
            found.strength + 1e-3 * strength, found.correlation + 1e-3 * correlation
        )
        assert loss_of(beside, *repeated) > least


def test_calibrations_stay_within_their_bounds(repeated):
    floored, codes, episodes, prior = repeated
    # What always misleads keeps a twentieth of its weight.
    wrong = fit_sequence_calibration(floored, (codes + 1) % 3, episodes, prior)
    assert wrong.strength == pytest.approx(0.05)
    # What never misleads is taken at its word, and as if no touch were like another.
    sure = fit_sequence_calibration(
        with_floor(9.0 * np.eye(3)[codes], 0.01), codes, episodes, prior
    )
    assert (sure.strength, sure.correlation) == pytest.approx((1, 0), abs=1e-5)
    assert sure.correlation > 0
    # Touches that repeat the first one's word are worth one.
    first = np.repeat(floored[1::10], 10, axis=0)
    blocks = np.repeat(np.arange(12), 10)
    same = [rows[:, :5] for rows in draw_episodes(codes, 0, blocks=blocks)]
    alike = fit_sequence_calibration(first, codes, same, prior)
    assert alike.correlation == pytest.approx(1, abs=1e-5)
    assert alike.correlation < 1


def seen(seed=0, n_each=10, spread=1.0):
    """Examples of three things in a plane, and their names."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(["ball", "mug", "pen"], n_each)
    centres = np.array([[0.0, 50.0], [3.0, 50.0], [0.0, 90.0]])
    return np.repeat(centres, n_each, axis=0) + [spread, 10 * spread] * rng.normal(
        size=(3 * n_each, 2)
    ), labels


def test_a_sense_says_what_its_classifier_says_with_the_floor():
    X, y = seen()
    sense = Modality(floor=0.2).fit(X, y)
    assert sense.classes_.tolist() == ["ball", "mug", "pen"]
    asked = seen(1, 2)[0]
    scaled = (asked - X.mean(axis=0)) / X.std(axis=0)
    shares = np.exp(sense.classifier_.log_likelihood(scaled))
    shares = 0.8 * shares / shares.sum(axis=1, keepdims=True) + 0.2 / 3
    said = np.exp(sense.log_likelihood(asked, np.array(["pen", "ball", "mug"])))
    assert said == pytest.approx(shares[:, [2, 0, 1]])
    # What it does not know gets the mean of what it knows among those asked about.
    some = np.exp(sense.log_likelihood(asked, np.array(["box", "mug", "pen"])))
    middle = shares[:, 1:].mean(axis=1)
    assert some == pytest.approx(np.column_stack([middle, shares[:, 1:]]))
    none = sense.log_likelihood(asked, np.array(["box", "cup"]))
    assert none.tolist() == [[0.0, 0.0]] * 6


def test_examples_that_resemble_each_other_are_left_out_together():
    X, y = seen(spread=3.0)
    alone = Modality().fit(X, y).sequence_calibration_
    assert alone == Modality().fit(X, y, groups=np.arange(30)).sequence_calibration_
    # At its bounds the seed is no matter; of examples that overlap it is.
    overlap = seen(n_each=40, spread=4.0)
    drawn = [Modality(random_state=k).fit(*overlap) for k in (0, 1)]
    assert drawn[0].sequence_calibration_ != drawn[1].sequence_calibration_
    # Copies that are met in training are surer of themselves.
    rng = np.random.default_rng(2)
    copies = np.repeat(X, 4, axis=0) + 1e-3 * rng.normal(size=(120, 2))
    names, visit = np.repeat(y, 4), np.repeat(np.arange(30), 4)
    told = Modality().fit(copies, names, groups=visit).sequence_calibration_
    untold = Modality().fit(copies, names).sequence_calibration_
    assert told.strength < untold.strength - 0.2


@pytest.mark.parametrize("floor", [0, 0.5])
def test_a_floor_of_a_sense_is_at_most_a_half(floor):
    assert Modality(floor=floor).fit(*seen()).floor == floor
    for beyond in (-0.01, 0.51):
        with pytest.raises(ValueError, match="floor must be"):
            Modality(floor=beyond).fit(*seen())


@pytest.mark.parametrize("y", [["a"] * 4, ["a", "a", "a", "b"], ["a", "b"]])
def test_a_sense_needs_two_labels_of_two_examples(y):
    with pytest.raises(ValueError, match="y must"):
        Modality().fit(np.eye(4), y)
    Modality().fit(np.eye(4), ["a", "b", "b", "a"])


def test_a_label_left_out_whole_gets_the_least_that_any_got(rng):
    images = rng.normal(size=(24, 2, 4)) + 3 * np.repeat(np.eye(8)[:3], 8, 0).reshape(
        24, 2, 4
    )
    labels = np.repeat(["a", "b", "c"], 8)
    groups = np.where(labels == "c", 9, np.arange(24) % 4)
    learnt = ObjectRecogniser("corradi2015").fit(images, labels, groups)
    said = learnt.left_out_log_likelihood()
    assert np.isfinite(said).all()
    assert (said[16:, 2] == said[16:, :2].min(axis=1)).all()
