"""How touches add up: closed cases of floor, trust and posterior."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.recognition import (
    Evidence,
    SequenceCalibration,
    as_touches,
    doubts,
    given_prior,
    log_posteriors,
    n_informative,
    with_floor,
)


def test_posterior_is_the_normalised_product():
    likelihood = np.array([[0.5, 0.25], [0.2, 0.6]])
    posterior = np.exp(
        log_posteriors(np.log(likelihood), np.log([0.5, 0.5]), SequenceCalibration())
    )
    assert_allclose(posterior[0], [2 / 3, 1 / 3])
    assert_allclose(posterior[1], [0.1 / 0.25, 0.15 / 0.25])


def test_prior_enters_once():
    flat = np.zeros((3, 2))
    posterior = np.exp(log_posteriors(flat, np.log([0.8, 0.2]), SequenceCalibration()))
    assert_allclose(posterior, [[0.8, 0.2]] * 3)


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


def test_the_best_object_does_not_depend_on_the_trust(rng):
    steps = rng.normal(size=(20, 5))
    prior = np.full(5, -np.log(5))
    best = log_posteriors(steps, prior, SequenceCalibration()).argmax(axis=1)
    tempered = log_posteriors(steps, prior, SequenceCalibration(0.4, 0.3)).argmax(
        axis=1
    )
    assert (best == tempered).all()


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
    together = log_posteriors(steps, prior, calibration)
    counts = n_informative(steps)
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
def test_a_prior_that_is_none_is_refused(prior, error, message):
    with pytest.raises(error, match=message):
        given_prior(prior, np.array(["a", "b"]))
    assert given_prior({"a": 1e-12, "b": 1.0}, np.array(["a", "b"]))[0] < -27.6


def test_images_lists_and_touches_are_touches():
    image = np.arange(6.0).reshape(2, 3)
    one, three = as_touches(image), as_touches([image] * 3)
    assert one.images.shape == (1, 2, 3)
    assert three.images.shape == (3, 2, 3)
    assert as_touches(one) is one
    assert len(as_touches([one, three])) == 4
    assert isinstance(as_touches([one]), Touches)
    for bad in ([], np.zeros(3), np.zeros((1, 2, 2, 2, 3))):
        shape = np.asarray(bad).shape
        with pytest.raises(ValueError, match="touch must be") as refused:
            as_touches(bad)
        assert str(refused.value).endswith(f"got an array of shape {shape}.")
    with pytest.raises(ValueError, match=r"\(4, 2, 3, 3\). Name its channels: Touches"):
        as_touches(np.zeros((4, 2, 3, 3)))


def test_evidence_taken_apart_is_put_together_again(rng):
    parts = [rng.normal(size=shape) for shape in ((5, 2), (5, 3), (5, 2, 3), (5, 3))]
    features, said, each, far = parts
    flags = ["", "double contact", "", "saturated", ""]
    whole = Evidence(features, said, flags, each, far, rng.normal(size=(5, 7)))
    alone = [whole.one(k) for k in range(5)]
    assert [part.flags for part in alone] == [[flag] for flag in flags]
    assert {len(array) for part in alone for array in part} == {1}
    for one, other in zip(Evidence.together(alone), whole, strict=True):
        assert np.array_equal(one, other)
