"""What left-out touches tell: how evidence adds up, and whether turns matter."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate._numbers import with_floor
from palpate.recognition import (
    Evidence,
    Modality,
    ObjectRecogniser,
    SequenceCalibration,
)
from palpate.recognition._calibration import (
    LENGTHS,
    draw_episodes,
    fit_sequence_calibration,
)
from palpate.recognition._evidence import (
    as_touches,
    beliefs_after,
    doubts,
    given_prior,
    is_informative,
)
from palpate.recognition._learning import what_matters
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


def test_touches_that_share_what_their_block_adds_weigh_less(rng):
    codes = np.repeat(np.arange(4), 200)
    blocks = np.repeat(np.arange(80), 10)

    def calibrated(share):
        noise = rng.normal(size=(len(codes), 4))
        shared = np.repeat(rng.normal(size=(80, 4)), 10, axis=0)
        log_likelihood = np.sqrt(share) * shared + np.sqrt(1 - share) * noise
        log_likelihood[np.arange(len(codes)), codes] += 1.0
        episodes = [rows[:, :10] for rows in draw_episodes(codes, 0, blocks=blocks)]
        prior = np.full(4, -np.log(4))
        return fit_sequence_calibration(log_likelihood, codes, episodes, prior)

    # N(c, 1) evidence with a gap of 1 is a proper likelihood: weight 1.
    independent, repeated = calibrated(0.0), calibrated(0.8)
    assert independent.strength == pytest.approx(1, abs=0.25)
    assert independent.correlation < 0.1
    # What k touches tell has the variance 0.8 + 0.2 / k: the design effect of 0.8.
    assert repeated.correlation == pytest.approx(0.8, abs=0.2)


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


def log_posteriors(floored, prior, calibration):
    """Return log posteriors after each touch of an episode."""
    used = is_informative(floored)
    return beliefs_after(used, floored, prior, calibration)[0]


def loss_of(calibration, floored, codes, episodes, prior):
    """Return the log loss episode by episode; each number of touches counts alike."""
    losses = []
    for length in LENGTHS:
        ends = [
            log_posteriors(floored[episode[:length]], prior, calibration)[-1][
                codes[episode[0]]
            ]
            for episode in np.concatenate(episodes)
            if len(episode) >= length
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
    log_likelihood = 1.6 * (rng.normal(size=(120, 3)) / 2 + shared + np.eye(3)[codes])
    log_likelihood[::9] = 0.0  # no contact
    blocks = np.repeat(np.arange(12), 10)
    episodes = [rows[:30, :8] for rows in draw_episodes(codes, 0, blocks=blocks)]
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


def examples(seed=0, n_each=10, spread=1.0):
    """Examples of three things in a plane, and their names."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(["ball", "mug", "pen"], n_each)
    centres = np.array([[0.0, 50.0], [3.0, 50.0], [0.0, 90.0]])
    return np.repeat(centres, n_each, axis=0) + [spread, 10 * spread] * rng.normal(
        size=(3 * n_each, 2)
    ), labels


def test_a_sense_gives_the_probabilities_of_its_classifier_with_the_floor():
    X, y = examples()
    sense = Modality(floor=0.2).fit(X, y)
    assert sense.classes_.tolist() == ["ball", "mug", "pen"]
    new_examples = examples(1, 2)[0]
    scaled = (new_examples - X.mean(axis=0)) / X.std(axis=0)
    shares = np.exp(sense.classifier_.log_likelihood(scaled))
    shares = 0.8 * shares / shares.sum(axis=1, keepdims=True) + 0.2 / 3
    probabilities = np.exp(
        sense.log_likelihood(new_examples, np.array(["pen", "ball", "mug"]))
    )
    assert probabilities == pytest.approx(shares[:, [2, 0, 1]])
    # A name that it never learnt gets the mean of the learnt ones among the names.
    with_box = np.exp(
        sense.log_likelihood(new_examples, np.array(["box", "mug", "pen"]))
    )
    middle = shares[:, 1:].mean(axis=1)
    assert with_box == pytest.approx(np.column_stack([middle, shares[:, 1:]]))
    unlearnt = sense.log_likelihood(new_examples, np.array(["box", "cup"]))
    assert unlearnt.tolist() == [[0.0, 0.0]] * 6


def test_examples_that_resemble_each_other_are_left_out_together():
    X, y = examples(spread=3.0)
    alone = Modality().fit(X, y).sequence_calibration_
    assert alone == Modality().fit(X, y, groups=np.arange(30)).sequence_calibration_
    # The seed changes no calibration at its bounds, but that of overlapping examples.
    overlap = examples(n_each=40, spread=4.0)
    drawn = [Modality(random_state=k).fit(*overlap) for k in (0, 1)]
    assert drawn[0].sequence_calibration_ != drawn[1].sequence_calibration_
    # A copy whose original is in training makes a sense look surer than it is.
    rng = np.random.default_rng(2)
    copies = np.repeat(X, 4, axis=0) + 1e-3 * rng.normal(size=(120, 2))
    names, visit = np.repeat(y, 4), np.repeat(np.arange(30), 4)
    grouped = Modality().fit(copies, names, groups=visit).sequence_calibration_
    ungrouped = Modality().fit(copies, names).sequence_calibration_
    assert grouped.strength < ungrouped.strength - 0.2


@pytest.mark.parametrize("floor", [0, 0.5])
def test_a_floor_of_a_sense_is_at_most_a_half(floor):
    assert Modality(floor=floor).fit(*examples()).floor == floor
    for beyond in (-0.01, 0.51):
        with pytest.raises(ValueError, match="floor must be"):
            Modality(floor=beyond).fit(*examples())


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (["a"] * 4, "hold at least two labels of two examples each"),
        (["a", "a", "a", "b"], "hold at least two labels of two examples each"),
        (["a", "b"], "have one label for each of 4 examples"),
    ],
)
def test_a_sense_needs_two_labels_of_two_examples(y, message):
    with pytest.raises(ValueError, match=f"y must {message}"):
        Modality().fit(np.eye(4), y)
    Modality().fit(np.eye(4), ["a", "b", "b", "a"])


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


def test_one_impossible_touch_does_not_rule_an_object_out():
    with np.errstate(divide="ignore"):
        impossible = np.log([[0.0, 1.0]])
    floored = np.exp(with_floor(impossible, 0.01))
    assert_allclose(floored, [[0.005, 0.995]])


def test_without_floor_likelihoods_keep_their_ratio():
    raw = np.array([[-1000.0, -1003.0]])
    kept = with_floor(raw, 0)
    assert kept[0, 0] - kept[0, 1] == pytest.approx(3)


def test_fully_correlated_touches_are_worth_one():
    touch = np.log([[0.7, 0.3]])
    after = log_posteriors(
        np.repeat(touch, 9, axis=0), np.log([0.5, 0.5]), SequenceCalibration(1, 1)
    )
    assert_allclose(np.exp(after), [[0.7, 0.3]] * 9)


def test_doubt_is_exact_near_certainty():
    # 1 - p rounds to 0 in double precision here; the sum of the others does not.
    log_posterior = np.array([np.log1p(-2e-20), np.log(1e-20), np.log(1e-20)])
    assert doubts(log_posterior) == pytest.approx(2e-20)


def test_the_design_effect_is_that_of_equally_correlated_readings():
    assert SequenceCalibration() == SequenceCalibration(1.0, 0.0)
    k = np.arange(1, 6)
    assert_allclose(SequenceCalibration().weight(k), 1)
    # k readings of correlation c have the variance of k / (1 + (k - 1) c) free ones.
    weights = SequenceCalibration(0.6, 0.3).weight(k)
    assert_allclose(weights, 0.6 / (1 + 0.3 * (k - 1)))
    assert SequenceCalibration(0.6, 0.3).weight(0) == 0.6


@pytest.mark.parametrize("floor", [0.001, 0.01, 0.3])
def test_a_floor_mixes_each_touch_with_the_uniform_one(floor, rng):
    shares = rng.dirichlet(np.ones(4), size=(3, 2))
    mixed = np.exp(with_floor(np.log(shares) - 700, floor))
    assert_allclose(mixed, (1 - floor) * shares + floor / 4)
    assert mixed.min() >= floor / 4


def test_posteriors_of_many_episodes_are_those_of_each(rng):
    steps = np.log(rng.dirichlet(np.ones(3), size=(4, 2, 6)))
    steps[1, :, 3] = steps[2, 1, 0] = 0.5  # no contact
    prior, calibration = np.log([0.5, 0.3, 0.2]), SequenceCalibration(0.8, 0.2)
    used = is_informative(steps)
    together, counts = beliefs_after(used, steps, prior, calibration)
    assert together.shape == steps.shape
    for episode in np.ndindex(4, 2):
        total, count = np.zeros(3), 0
        for k, step in enumerate(steps[episode]):
            if np.ptp(step) > 0:
                total, count = total + step, count + 1
            weight = 0.8 / (1 + max(count - 1, 0) * 0.2)
            shares = np.exp(prior + weight * total)
            after = np.exp(together[episode][k])
            assert_allclose(after, shares / shares.sum(), rtol=1e-12)
            assert counts[episode][k] == count
            doubt = 1 - (shares / shares.sum()).max()
            assert doubts(together)[episode][k] == pytest.approx(doubt)


def test_a_prior_is_brought_to_sum_one_in_the_order_of_the_objects():
    names = np.array(["ball", "mug", "pen"])
    logs = given_prior({"pen": 6.0, "ball": 1.0, "mug": 3.0}, names)
    assert_allclose(np.exp(logs), [0.1, 0.3, 0.6])
    assert_allclose(
        given_prior({2: 1.0, 10: 3.0}, np.array([2, 10])), np.log([0.25, 0.75])
    )


@pytest.mark.parametrize(
    ("prior", "error", "message"),
    [
        ([0.5, 0.5], TypeError, "prior must map objects to probabilities, got list"),
        ({"a": 1.0}, ValueError, "difference in 'b'. The objects are a, b"),
        ({"a": 1.0, "b": 1.0, "c": 1.0}, ValueError, "a difference in 'c'"),
        ({"a": 1.0, "b": 0.0}, ValueError, "prior must be positive"),
        ({"a": 0.9e-12, "b": 1.0}, ValueError, "got 9e-13 for 'a'. Give it at least"),
    ],
)
def test_a_prior_without_a_positive_number_for_each_object_is_refused(
    prior, error, message
):
    with pytest.raises(error, match=message):
        given_prior(prior, np.array(["a", "b"]))
    assert given_prior({"a": 1e-12, "b": 1.0}, np.array(["a", "b"]))[0] < -27.6


def test_images_lists_and_touches_are_touches():
    image = np.arange(6.0).reshape(2, 3)
    touch, three = as_touches(image), as_touches([image] * 3)
    assert touch.images.shape == (1, 2, 3)
    assert three.images.shape == (3, 2, 3)
    assert as_touches(touch) is touch
    assert len(as_touches([touch, three])) == 4
    assert isinstance(as_touches([touch]), Touches)
    for bad in ([], np.zeros(3), np.zeros((1, 2, 2, 2, 3))):
        shape = np.asarray(bad).shape
        with pytest.raises(ValueError, match="touch must be") as refused:
            as_touches(bad)
        assert str(refused.value).endswith(f"got an array of shape {shape}.")
    with pytest.raises(ValueError, match=r"\(4, 2, 3, 3\). Name its channels: Touches"):
        as_touches(np.zeros((4, 2, 3, 3)))


def test_evidence_taken_apart_is_put_together_again(rng):
    parts = [rng.normal(size=shape) for shape in ((5, 2), (5, 3), (5, 2, 3), (5, 3))]
    features, log_likelihood, each, far = parts
    flags = ["", "double contact", "", "saturated", ""]
    whole = Evidence(
        features, log_likelihood, flags, each, far, rng.normal(size=(5, 7))
    )
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
    own_posteriors = {"levels": seeing + rng.normal(scale=0.1, size=100)}
    own_posteriors["moments"] = blind + rng.normal(scale=0.1, size=100)
    own_posteriors["moments"] += (blind - seeing) - (
        own_posteriors["moments"] - own_posteriors["levels"]
    ).mean()
    figures = {
        "levels": {"log_loss": -seeing, "accuracy": 0.85, "blind_to": []},
        "moments": {"log_loss": -blind, "accuracy": 0.38, "blind_to": ["turns"]},
    }
    assert what_matters("turns", figures, own_posteriors).startswith(sentence)
    assert what_matters("shifts", figures, own_posteriors) is None
