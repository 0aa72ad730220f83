"""Numbers, decisions and sentences of a belief, beside those worked out by hand."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import log_softmax, softmax

from palpate import Touches
from palpate.recognition import (
    Belief,
    Episode,
    Evidence,
    ObjectRecogniser,
    SequenceCalibration,
)

NAMES = ("ball", "cup", "mug", "pen", "rod")
KINDS = ("", "vessel", "vessel", "tool", "tool")
N_EACH, SHAPE = 6, (2, 4)


def drawn(seed):
    """Return touches of five objects, each with a pattern of its own."""
    rng = np.random.default_rng(seed)
    images = np.repeat(3 * np.eye(8)[:5].reshape(5, *SHAPE), N_EACH, axis=0)
    return Touches(
        images + rng.normal(size=images.shape),
        object=np.repeat(NAMES, N_EACH),
        geometry="none",
    )


@pytest.fixture(scope="module")
def model():
    learnt = ObjectRecogniser().fit(drawn(0))
    rng = np.random.default_rng(5)
    X = 2 * np.eye(5)[np.repeat(range(5), 8)] + 0.5 * rng.normal(size=(40, 5))
    return learnt.learn_modality("sight", X, np.repeat(NAMES, 8))


@pytest.fixture
def start(model):
    """Return a function that begins a belief of these parts, with no stranger expected.

    Its score is evidence for a stranger as `stranger_model` says.
    """

    def begin(
        prior=None,
        *,
        floor=0.0,
        calibration=(1.0, 0.0),
        model_parts=None,
        strangers=0.0,
        **stranger_parts,
    ):
        belief_model = replace(
            model.belief_model(),
            strangers=replace(stranger_model(model), **stranger_parts),
            floor=floor,
            sequence_calibration=SequenceCalibration(*calibration),
            **({"categories": np.array(KINDS)} | (model_parts or {})),
        )
        by_name = None if prior is None else dict(zip(NAMES, prior, strict=True))
        return Belief(belief_model, model.evidence, by_name, strangers)

    return begin


def stranger_model(model):
    """Give evidence for a stranger of log(score / 0.1), and a nat a deviation above 1.

    The score's logarithm in nats is compared with 0, its deviation being 1.
    """
    learnt = model.strangers_
    falling = replace(
        learnt.low_curve, levels=np.log([1e-9, 1.0]), log_ratios=np.log([[1e-8, 10.0]])
    )
    return replace(
        learnt,
        weights=np.array([0.7, 0.3]),
        high=np.array([[0.0, 1.0]]),
        low_curve=falling,
        low_category_curve=falling,
        high_curve=replace(
            falling, levels=np.array([1.0, 9.0]), log_ratios=np.array([[0.0, 8.0]])
        ),
    )


def posed(belief, *shares, **more):
    """Update with one touch, after which a belief without prior has these shares."""
    return belief.update_from_log_likelihood(np.log(shares), **more)


SURE = 0.02, 0.95, 0.01, 0.01, 0.01
TORN = 0.01, 0.5, 0.47, 0.01, 0.01


@pytest.mark.parametrize("floor", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("calibration", [(1.0, 0.0), (0.7, 0.2)])
def test_belief_and_unknown_are_those_summed_by_hand_after_each_touch(
    start, floor, calibration
):
    rng = np.random.default_rng(1)
    rows = 2 * rng.normal(size=(5, 5))
    rows[2] = 7.0  # says nothing
    each, distances = rng.normal(size=(5, 2, 5)), 3 + rng.normal(size=(5, 5))
    prior = np.array([0.1, 0.2, 0.3, 0.3, 0.1])
    usual, far = rng.normal(size=5), np.array([[0.1, 1.0], [0.2, 0.5], [-0.3, 0.4]])
    parts = {"usual": usual, "far": far, "strangers": 0.2}
    belief = start(prior, floor=floor, calibration=calibration, **parts)
    assert belief.unknown == pytest.approx(0.2)
    lowest = {}
    for k in range(5):
        belief.update_from_log_likelihood(
            rows[k],
            by_encoding=each[k : k + 1] - 1000.0,  # of one touch the scale is free
            log_distances=distances[k : k + 1],
        )
        used = [touch for touch in range(k + 1) if touch != 2]
        n = len(used)
        weight = calibration[0] / (1 + (n - 1) * calibration[1])

        def summed(log_likelihood, used=used, weight=weight):
            mixed = (1 - floor) * softmax(log_likelihood, axis=-1) + floor / 5
            total = weight * np.log(mixed[used]).sum(axis=0) + np.log(prior)
            return log_softmax(total, axis=-1)

        logs = summed(rows)
        assert_allclose(belief.log_posterior, logs, atol=1e-12)
        assert belief.best == NAMES[logs.argmax()]
        agreed = np.array([0.7, 0.3]) @ summed(each)
        excess_distance = (distances[used].mean(axis=0) - usual)[agreed.argmax()]
        mean, spread = far[min(n, 3) - 1]
        nats = max(0, (excess_distance - mean) / spread - 1.645) - agreed.max()
        level = max(1 - np.exp(-nats), 1 - np.exp(logs.max()))
        above = np.log(nats + 1e-6)
        level = lowest[belief.best] = min(level, lowest.get(belief.best, 1.0))
        odds = 0.25 * level / 0.1 * np.exp(max(above - 1, 0) + 1e-3 * above)
        unknown = odds / (1 + odds)
        assert belief.unknown_evidence == pytest.approx(np.log(odds / 0.25))
        assert belief.unknown == pytest.approx(unknown)
        shares = (1 - unknown) * np.exp(logs)
        assert belief.posterior == pytest.approx(dict(zip(NAMES, shares, strict=True)))
        assert belief.doubt == pytest.approx(1 - shares.max())
        kinds = np.exp(logs) @ np.eye(3)[[0, 1, 1, 2, 2]]
        named = [belief.categories[name] for name in ("ball", "vessel", "tool")]
        ratios = np.array(named) / kinds
        # All categories are less by the same factor, for the probability of unknown.
        assert ratios == pytest.approx(np.full(3, ratios[0]))
        assert ratios[0] < 1
        assert belief.touches_used == k + 1
        assert belief.flags == [""] * (k + 1)


def test_touches_come_one_by_one_or_together(start, model):
    touches = drawn(3)[::4]
    evidence = model.evidence(touches)
    weights = model.strangers_.weights
    beliefs = [start(floor=0.01, weights=weights, strangers=0.1) for _ in "12345"]
    beliefs[0].update(touches)
    beliefs[1].update(evidence)
    for k in range(len(touches)):
        beliefs[2].update(evidence.of_touch(k))
        beliefs[3].update(touches.images[k])
        beliefs[4].update(touches[k])
    assert beliefs[3].posterior == beliefs[4].posterior
    touch_numbers = [explained["touch"] for explained in beliefs[0].explain()]
    for belief in beliefs[1:]:
        # Products of one row and of several round differently.
        assert belief.posterior == pytest.approx(beliefs[0].posterior, abs=1e-9)
        assert belief.unknown == pytest.approx(beliefs[0].unknown, abs=1e-9)
        assert [explained["touch"] for explained in belief.explain()] == touch_numbers


def test_doubt_is_exact_near_certainty(start):
    # 1 - p rounds to 0 in double precision here; the sum of the others does not.
    belief = posed(start(), 1, *[5e-21] * 4)
    assert belief.doubt == pytest.approx(2e-20, rel=1e-9, abs=0)


def test_before_the_first_touch_nothing_is_decided_however_sure_the_prior(start):
    belief = start([0.996, 0.001, 0.001, 0.001, 0.001])
    for level in ("object", "category", "any"):
        assert belief.decide(0.5, level=level) is None
    # One touch is enough, even if it says nothing.
    belief.update_from_log_likelihood(np.zeros(5))
    assert belief.decide(0.5) == "ball"
    assert belief.touches_used == 1


def test_a_decision_is_for_an_error_of_one_in_a_hundred_unless_another_is_given(start):
    assert posed(start(), 0.9905, *[0.0095 / 4] * 4).decide() == "ball"
    belief = posed(start(), 0.9895, *[0.0105 / 4] * 4)
    assert belief.promise().level == 0.01
    assert belief.decide() is None
    # Rounded down: 99 % would read as if the belief had reached what was asked for.
    assert belief.reason() == "probably ball (98 %): touch again"


@pytest.mark.parametrize(
    ("strangers", "arguments"),
    [
        (0.0, {}),
        (0.05, {}),
        (0.3, {}),
        (0.0, {"costs": {}}),
        (0.0, {"level": "category"}),
    ],
)
def test_shares_and_scores_at_their_limit_are_accepted(start, strangers, arguments):
    belief = posed(start(strangers=strangers), *SURE)
    doubt = belief.doubt
    if "costs" in arguments:
        doubt = float((np.exp(belief.log_posterior) @ (1 - np.eye(5))).min())
    if "level" in arguments:
        doubt = 1 - belief.categories["vessel"]
    assert belief.decide(doubt, **arguments) is not None
    assert belief.decide(np.nextafter(doubt, 0), **arguments) is None


def test_unknown_is_named_when_its_probability_is_one_less_the_refusal(start):
    torn = np.log([[(0.96, 0.01, 0.01, 0.01, 0.01), (0.01, 0.01, 0.01, 0.96, 0.01)]])
    belief = posed(start(strangers=0.3), *SURE, by_encoding=torn)
    assert belief.unknown > 0.7
    missing = 1 - belief.unknown
    assert belief.decide(missing * 1.001) == "unknown"
    assert belief.decide(missing * 0.999) is None
    assert belief.decide(1e-6, refusal=missing * 1.001) == "unknown"
    assert belief.decide(missing * 1.001, refusal=1e-6) is None
    assert belief.named(0.4) == ("unknown", "unknown")
    # The same touches in a closed world are of the object that they favour.
    closed = posed(start(), *SURE, by_encoding=torn)
    assert (closed.unknown, closed.decide(0.1)) == (0, "cup")


def test_a_category_has_a_probability_of_its_own(start):
    # Of vessels the two encodings give 0.97 and 0.92, of cups 0.5 and 0.3.
    each = np.log([[TORN, (0.04, 0.3, 0.62, 0.02, 0.02)]])
    belief = posed(start(strangers=0.1), *TORN, by_encoding=each)
    score = 1 - 0.97**0.7 * 0.92**0.3
    share = 0.97 / (1 + 0.1 / 0.9 * score / 0.1)
    assert belief.categories["vessel"] == pytest.approx(share)
    assert belief.decide(1.001 * (1 - share), level="category") == "vessel"
    assert belief.decide(0.999 * (1 - share), level="category") is None
    assert belief.decide(1.001 * (1 - share), level="any") == ("category", "vessel")
    assert belief.decide(1.001 * (1 - share), level="object") is None
    # An object is named first where it may be; never where categories are asked for.
    sure = posed(start(), *SURE)
    assert sure.decide(0.1, level="any") == ("object", "cup")
    assert sure.decide(0.1, level="category") == "vessel"
    assert posed(start(), *TORN).decide(0.02, level="category") is None


def test_a_new_thing_of_a_known_category_is_of_that_category(start, model):
    # One encoding is sure of the cup, the other of the mug: of vessels both are.
    cup, mug = (0.001, 0.996, *[0.001] * 3), (0.001, 0.001, 0.996, *[0.001] * 2)
    torn = touch_evidence(model, *cup)._replace(by_encoding=np.log([[cup, mug]]))
    episode = Episode(start(strangers=0.3), error=0.05, level="category")
    assert episode.add(torn) == "a vessel, 98 % after 1 touch; which one I cannot tell"
    assert episode.belief.unknown > 0.7
    assert not episode.in_doubt
    # Too little for the name is not enough for none.
    belief = episode.belief
    assert belief.decide(0.01, refusal=0.3, level="category") is None
    assert belief.decide(0.01, refusal=0.3, level="any") == ("unknown", "unknown")


def test_an_object_that_is_called_as_a_category_counts_with_it(start):
    kinds = {"categories": np.array(["", "ball", "ball", "tool", "tool"])}
    belief = posed(start(model_parts=kinds), 0.2, 0.6, 0.15, 0.04, 0.01)
    assert belief.categories == pytest.approx({"ball": 0.95, "tool": 0.05})
    assert belief.decide(0.1, level="category") == "ball"


@pytest.mark.parametrize("strangers", [-0.1, 1.0, 1.5, np.nan])
def test_a_share_of_strangers_is_at_least_0_and_below_1(model, strangers):
    with pytest.raises(ValueError, match="strangers must be"):
        model.start(strangers=strangers)
    with pytest.raises(TypeError, match="strangers must be a number"):
        model.start(strangers="few")


def test_the_object_of_least_expected_cost_is_named(start):
    rng = np.random.default_rng(2)
    shares = rng.dirichlet(np.ones(5))
    table = rng.uniform(0, 2, (5, 5)) * (1 - np.eye(5))
    costs = {
        truth: {named: table[k, j] for j, named in enumerate(NAMES) if (k + j) % 3}
        for k, truth in enumerate(NAMES)
    }
    for k, j in np.ndindex(5, 5):
        if k != j and (k + j) % 3 == 0:
            table[k, j] = 1  # what is not given costs 1
    expected = shares @ table
    belief = posed(start(), *shares)
    least = float(expected.min())
    assert least < 0.5
    cheapest = NAMES[expected.argmin()]
    assert belief.decide(least + 1e-6, costs) == cheapest != belief.best
    assert belief.reason(least + 1e-6, costs).startswith(f"{cheapest}, ")
    assert belief.decide(least - 1e-6, costs) is None
    # Naming what was never learnt costs 1, whatever it is called.
    open_world = posed(start(strangers=0.02), *shares)
    cost = (1 - open_world.unknown) * least + open_world.unknown
    assert least + 0.01 < cost < 0.5
    assert open_world.decide(cost + 1e-6, costs) == cheapest
    assert open_world.decide(cost - 1e-6, costs) is None


def test_shares_asked_for_are_between_a_millionth_and_a_half(start):
    belief = posed(start(), *SURE)
    for share in (1e-6, 0.5):
        belief.decide(share)
        belief.decide(refusal=share)
    for share in (0.99e-6, 0.51, np.nan):
        with pytest.raises(ValueError, match="error must be"):
            belief.decide(share)
        with pytest.raises(ValueError, match="refusal must be"):
            belief.decide(refusal=share)


@pytest.mark.parametrize("ask", ["decide", "reason", "is_stuck"])
@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"error": 0.6}, ValueError, "error must be"),
        ({"refusal": 0.6}, ValueError, "refusal must be"),
        ({"level": "kind"}, ValueError, "level must be one of"),
        ({"costs": {"cup": {"mug": -1}}}, ValueError, "costs must be"),
        ({"costs": {"key": {}}}, ValueError, "costs must be"),
        ({"costs": {"mug": {"mug": 1.0}}}, ValueError, "0 for the right name"),
        ({"costs": 5}, TypeError, "costs must be a mapping"),
        ({"costs": {"mug": 5}}, TypeError, "costs of 'mug'"),
        ({"costs": {}, "level": "category"}, ValueError, "costs must be left out"),
    ],
)
def test_what_cannot_be_asked_is_refused_before_the_first_touch(
    start, ask, options, error, message
):
    with pytest.raises(error, match=message):
        getattr(start(), ask)(**options)


@pytest.mark.parametrize(
    ("shares", "strangers", "arguments", "sentence"),
    [
        (SURE, 0.0, {"error": 0.06}, "cup, 95 % after 1 touch"),
        (SURE, 0.0, {"error": 0.02}, "probably cup (95 %): touch again"),
        (SURE, 0.1, {"error": 0.02}, "probably cup (90 %): touch again"),
        (TORN, 0.0, {"error": 0.06}, "cup or mug: touch again"),
        (TORN, 0.3, {"error": 0.06}, "nothing I know, cup or mug: touch again"),
        ((0.2,) * 5, 0.0, {}, "perhaps ball (20 %): touch again"),
        (
            TORN,
            0.0,
            {"error": 0.06, "level": "any"},
            "a vessel, 97 % after 1 touch; which one I cannot tell",
        ),
        ((1 - 4e-6, *[1e-6] * 4), 0.0, {}, "ball, over 99.9 % after 1 touch"),
    ],
)
def test_a_reason_is_one_sentence(start, shares, strangers, arguments, sentence):
    belief = posed(start(strangers=strangers), *shares)
    assert belief.reason(**arguments) == sentence
    # A touch that says nothing is counted, and changes nothing else.
    belief.update_from_log_likelihood(np.zeros(5))
    assert belief.reason(**arguments) == sentence.replace("1 touch", "2 touches")
    assert "said nothing." in belief.why()[-1]


def test_more_touches_are_not_asked_for_where_all_are_worth_one(start, model):
    """A belief says so after six touches, as many as each object was taught with."""
    odds = touch_evidence(model, 1, 90, 80, 1, 1)
    for calibration, words in (
        # However many there are, the cup has 90 : 80 at most, to the power of 1.
        ((1.0, 1.0), "more touches will not tell; teach cup and mug again, at other"),
        # Of many independent touches the cup has 90 : 80 to the power of them.
        ((1.0, 0.0), "touch again"),
    ):
        episode = Episode(start(calibration=calibration))
        for _ in range(5):
            assert episode.add(odds) == "cup or mug: touch again"
        sentence = episode.add(odds)
        assert sentence.startswith(f"cup or mug: {words}")
        assert sentence == episode.belief.reason()
    # Only doubt about a stranger is left, and touches that add up may still end it.
    assert (
        not start(strangers=0.9)
        .update(Evidence.together([touch_evidence(model, 1, 9e9, 1, 1, 1)] * 6))
        .is_stuck(1e-6)
    )
    # Where no score is evidence for or against a stranger, twenty touches are enough.
    curve = type(model.strangers_.low_curve)(np.zeros(1), np.zeros((1, 1)))
    flat = start(strangers=0.9, low_curve=curve, high_curve=curve)
    cup = touch_evidence(model, 1, 9e9, 1, 1, 1)
    assert not flat.update(Evidence.together([cup] * 19)).is_stuck()
    assert flat.update(cup).is_stuck()
    # The belief of the episode is unchanged: a copy of it is projected.
    for _ in range(60):
        episode.add(odds)
    assert episode.decision == "cup"


@pytest.mark.parametrize(
    ("shares", "strangers", "advice"),
    [
        (SURE, 0.0, "cup again, at other places"),
        (TORN, 0.0, "cup and mug again, at other places"),
        (TORN, 0.3, "cup and mug again, at other places, or this, if it is new"),
        ((0.3, 0.25, 0.2, 0.15, 0.1), 0.0, "ball, cup and mug again, at other places"),
    ],
)
def test_a_belief_that_is_stuck_names_the_objects_to_teach_again(
    start, shares, strangers, advice
):
    belief = start(calibration=(1.0, 1.0), strangers=strangers)
    for _ in range(6):
        assert not belief.is_stuck(0.02)
        before = belief.reason(error=0.02)
        posed(belief, *shares)
    words, _ = before.split(": touch again")
    sentence = f"{words}: more touches will not tell; teach {advice}"
    assert belief.reason(error=0.02) == sentence


def test_why_tells_the_figures_behind_a_sentence(start):
    belief = posed(start(strangers=0.1), *SURE)
    object_sentence, stranger_sentence, promise_sentence = belief.why(0.02)
    assert object_sentence.startswith(
        "cup has probability 90 %, ball 1 %; 98 % was asked for."
    )
    assert "A share of 0.1 strangers was expected" in stranger_sentence
    assert "against one by 0.7 nats" in stranger_sentence
    assert promise_sentence == str(belief.promise(0.02))
    assert "closed world" in posed(start(), *SURE).why()[1]


def test_another_sense_adds_its_examples_by_its_own_calibration(start, model):
    sight = model.modalities_["sight"]
    X = np.random.default_rng(4).normal(size=(4, 5)) + np.eye(5)[1]
    prior = np.array([0.1, 0.2, 0.3, 0.3, 0.1])
    belief = start(prior)
    for k in range(4):
        belief.update_sense("sight", X[k])
        rows = sight.log_likelihood(X[: k + 1], np.array(NAMES))
        weight = sight.sequence_calibration_.weight(k + 1)
        expected = softmax(np.log(prior) + weight * rows.sum(axis=0))
        assert list(belief.posterior.values()) == pytest.approx(list(expected))
    assert belief.touches_used == 0
    assert belief.decide(0.5) == "cup"
    together = start(prior).update_sense("sight", X)
    assert together.posterior == pytest.approx(belief.posterior)
    posed(together, *SURE)
    both = softmax(np.log(SURE) + np.log(list(belief.posterior.values())))
    for belief in (together, posed(start(prior), *SURE).update_sense("sight", X)):
        assert list(belief.posterior.values()) == pytest.approx(list(both))
    # The score is of all senses: each encoding counts with the other sense.
    score = 1 - both.max()
    above = np.log(-np.log1p(-score) + 1e-6)
    nats = np.log(score / 0.1) + max(above - 1, 0) + 1e-3 * above
    assert together.unknown_evidence == pytest.approx(nats)


def test_an_example_of_another_length_is_refused_by_its_name(start):
    with pytest.raises(ValueError, match=r"X must have 5 features, .* got 3"):
        start().update_sense("sight", [1.0, 2.0, 3.0])


def test_a_copy_goes_on_by_itself_with_every_sense(start):
    belief, alone = (
        posed(start().update_sense("sight", np.ones(5)), *SURE) for _ in range(2)
    )
    other = posed(copy.copy(belief).update_sense("sight", np.eye(5)[2]), *TORN)
    for each, n_touches in ((belief, 1), (other, 2)):
        assert each.touches_used == len(each.flags) == len(each.explain()) == n_touches
    assert belief.posterior == alone.posterior
    assert posed(belief, *TORN).posterior == posed(alone, *TORN).posterior
    assert other.touches_used == 2
    belief.log_posterior[:] = 0
    assert belief.posterior == alone.posterior


def test_explanations_weigh_each_touch_between_the_two_best(start, model):
    rows = np.log([SURE, TORN, (0.2, 0.1, 0.6, 0.05, 0.05), (0.2,) * 5])
    features = model.memory_.features[[3, 9, 14, 20]] + 0.01
    belief = start(calibration=(0.8, 0.1))
    flags = ["", "saturated", "", "no contact"]
    belief.update_from_log_likelihood(rows, features=features, flags=flags)
    total = rows[:3].sum(axis=0)
    best, rival = np.argsort(-total)[:2]
    nats = 0.8 / 1.2 * (rows[:, best] - rows[:, rival])
    order = np.argsort(-np.abs(nats))
    explanations = belief.explain(n_touches=9, n_nearest=30)

    def listed(name):
        return [explanation[name] for explanation in explanations]

    assert listed("touch") == (order + 1).tolist()
    assert listed("flag") == [flags[k] for k in order]
    assert listed("best") == ["cup"] * 4 == [NAMES[best]] * 4
    assert listed("rival") == ["mug"] * 4 == [NAMES[rival]] * 4
    assert listed("nats") == pytest.approx(nats[order].tolist())
    learnt = model.memory_.features
    pair_distances = np.linalg.norm(learnt[:, None] - learnt, axis=2)
    unit = np.median(pair_distances[np.triu_indices(len(learnt), 1)])
    for nearest, k in zip(listed("nearest"), order, strict=True):
        distances = np.linalg.norm(learnt - features[k], axis=1) / unit
        rows = np.argsort(distances)
        assert [near["row"] for near in nearest] == rows.tolist()
        assert [near["object"] for near in nearest] == [
            NAMES[r // N_EACH] for r in rows
        ]
        near_distances = [near["distance"] for near in nearest]
        assert near_distances == pytest.approx(distances[rows].tolist())
    shortest = belief.explain()
    assert [len(explanation["nearest"]) for explanation in shortest] == [3] * 3
    # Without features there is nothing that a touch resembles.
    assert posed(start(), *SURE).explain()[0]["nearest"] == []


@pytest.mark.parametrize("number", ["n_touches", "n_nearest"])
def test_numbers_that_are_explained_are_at_least_0(model, number):
    assert model.start().explain() == []
    belief = model.start().update(drawn(1)[:4])
    with pytest.raises(ValueError, match=f"{number} must be at least 0, got -1"):
        belief.explain(**{number: -1})
    assert belief.explain(0) == []
    assert not any(step["nearest"] for step in belief.explain(n_nearest=0))


def test_a_belief_shows_the_three_most_probable(start):
    belief = posed(start(), 0.05, 0.6, 0.21, 0.04, 0.1)
    expected = "<Belief after 1 touch: cup 0.60, mug 0.21, rod 0.10, unknown 0.00>"
    assert repr(belief) == expected
    # Names are shown up to 24 letters.
    model_parts = {"classes": np.array(["a" * 24, "b" * 25, "c", "d", "e"])}
    belief = posed(start(model_parts=model_parts), 0.6, 0.3, 0.08, 0.01, 0.01)
    listed = f"{'a' * 24} 0.60, {'b' * 21}... 0.30, c 0.08, unknown 0.00"
    assert repr(belief) == f"<Belief after 1 touch: {listed}>"


def test_bars_are_as_long_as_their_shares(start):
    page = posed(start(), 0.05, 0.6, 0.2499, 0.1, 0.0001)._repr_html_()
    head = "<table><caption>cup, mug or pen: touch again</caption>"
    assert page.startswith(head)
    widths = [part.split("em")[0] for part in page.split("width:")[1:]]
    # Twelve em are all of it; the least is a line of 0.02 that can be seen.
    assert widths == ["7.20", "3.00", "1.20", "0.60", "0.02", "0.02"]
    assert page.index("nothing learnt") > page.index(">rod<")
    assert [
        page.index(f">{name}<") for name in ("cup", "mug", "pen", "ball", "rod")
    ] == (sorted(page.index(f">{name}<") for name in NAMES))
    assert "</div> 0.600</td>" in page
    assert page.count("<tr>") == 6
    assert "more" not in page


def test_names_are_text_on_a_page_and_no_markup(start):
    names = {"classes": np.array(["<b>ball</b>", "cup", "mug", "pen", "rod"])}
    page = posed(start(model_parts=names), *TORN)._repr_html_()
    assert "&lt;b&gt;ball&lt;/b&gt;" in page
    assert "<b>" not in page


@pytest.mark.parametrize(
    ("rows", "parts", "message"),
    [
        (np.zeros((1, 1, 5)), {}, r"log_likelihood must .*got \(1, 1, 5\)"),
        (np.zeros(4), {}, r"log_likelihood must .*\(n_touches, 5\), got \(1, 4\)"),
        (np.zeros((2, 6)), {}, r"log_likelihood must .*got \(2, 6\)"),
        (np.full(5, -np.inf), {}, "log_likelihood must .*for touch 0"),
        ([[0.0] * 5, [-np.inf] * 5], {}, "log_likelihood must .*for touch 1"),
        (np.zeros((2, 5)), {"flags": [""]}, "flags must be one for each of 2 .*got 1"),
        (np.zeros((2, 5)), {"features": np.zeros((1, 2))}, r"features must .*\(2, "),
        (
            np.zeros((2, 5)),
            {"log_distances": np.zeros((1, 5))},
            r"log_distances must have .*\(2, 5\)",
        ),
        (np.zeros((2, 5)), {"by_encoding": np.zeros((2, 9, 5))}, "by_encoding must"),
    ],
)
def test_evidence_of_another_shape_or_none_is_refused(start, rows, parts, message):
    belief = start()
    with pytest.raises(ValueError, match=message):
        belief.update_from_log_likelihood(rows, **parts)
    assert (belief.touches_used, belief.flags, belief.explain()) == (0, [], [])


def test_only_a_touch_that_rules_all_out_or_is_no_number_is_refused(start):
    belief = start()
    rows = np.zeros((3, 5))
    rows[0, 1:] = -np.inf
    belief.update_from_log_likelihood(rows)
    assert belief.touches_used == 3
    for bad in (np.nan, np.inf):
        rows[1, 2] = bad
        with pytest.raises(ValueError, match=f"{bad}.* for touch 1. Leave that touch"):
            belief.update_from_log_likelihood(rows)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_encoding_that_says_no_number_is_refused_and_changes_nothing(model, bad):
    touches, belief = drawn(1)[:2], model.start()
    evidence = model.evidence(touches)
    by_encoding = evidence.by_encoding.copy()
    by_encoding[1, 0] = bad
    with pytest.raises(ValueError, match=r"by_encoding must hold .* for touch 1\. "):
        belief.update(evidence._replace(by_encoding=by_encoding))
    assert belief.touches_used == 0
    assert belief.flags == []


def touch_evidence(model, *odds):
    """Evidence of one touch by which things are so many times as probable."""
    n_parts = len(stranger_model(model).weights)
    rows = np.log([odds])
    return Evidence(
        features=np.full((1, model.memory_.features.shape[1]), np.nan),
        log_likelihood=rows,
        flags=[""],
        by_encoding=np.broadcast_to(rows[:, np.newaxis], (1, n_parts, 5)),
        log_distances=np.full((1, 5), np.nan),
        looks=np.zeros((1, 7)),
    )


def test_a_decision_stays_until_it_is_as_improbable_as_it_was_probable(start, model):
    episode = Episode(start(), error=0.05)
    # Odds of ball, cup, mug, pen, rod: 1 : 96 : 1 : 1 : 1.
    assert (
        episode.add(touch_evidence(model, 1, 96, 1, 1, 1)) == "cup, 96 % after 1 touch"
    )
    # 1 : 96 : 400 : 1 : 1, so that the cup has 0.19: less likely, and not ruled out.
    doubted = episode.add(touch_evidence(model, 1, 1, 400, 1, 1))
    assert doubted == (
        "cup, 19 % after 2 touches; mug is more probable now: touch again"
    )
    assert (episode.decision, episode.decided_at, episode.withdrawn) == ("cup", 1, [])
    assert episode.in_doubt
    # 1 : 96 : 4000 : 1 : 1, the cup has 0.023.
    assert (
        episode.add(touch_evidence(model, 1, 1, 10, 1, 1))
        == "mug, 97 % after 3 touches"
    )
    assert (episode.decision, episode.decided_at) == ("mug", 3)
    assert not episode.in_doubt
    assert episode.withdrawn == [
        "cup was withdrawn after touch 3, when mug was more probable"
    ]


def test_what_is_withdrawn_need_not_be_less_probable_than_another(start, model):
    episode = Episode(start(), error=0.4)
    assert episode.add(touch_evidence(model, 1, 8, 1, 1, 1)).startswith("cup")
    # 5 : 8 : 5 : 5 : 5, the cup has 0.29.
    episode.add(touch_evidence(model, 5, 1, 5, 5, 5))
    assert (episode.decision, episode.withdrawn) == (
        None,
        ["cup was withdrawn after touch 2, when it had 28 % left"],
    )


def test_unknown_is_withdrawn_when_it_is_less_probable_than_its_refusal(start, model):
    episode = Episode(start(strangers=0.5), error=0.01, refusal=0.2)
    belief = episode.belief
    # Cup before all others by 1.5 : 1, what is left to each of the learnt ones.
    episode.add(touch_evidence(model, 1, 1.5, 1, 1, 1))
    for log_shares, decision in (
        ((0.2, 0.8), "unknown"),
        ((0.6, 0.4), "unknown"),
        ((0.85, 0.15), None),
    ):
        belief._log_shares = tuple(np.log(log_shares))
        episode._decide()
        assert episode.decision == decision
    assert episode.withdrawn == [
        "nothing I know was withdrawn after touch 1, when cup was more probable"
    ]


def test_several_images_are_as_many_touches_of_an_episode(model):
    images = drawn(3).images[:3]
    together, alone = Episode(model.start()), Episode(model.start())
    sentence = together.add(images)
    assert sentence == [alone.add(image) for image in images][-1]
    assert [touch.touch for touch in together.touches] == [1, 2, 3]
    assert together.n_counted == 3
    for joint, single in zip(together.touches, alone.touches, strict=True):
        # Products of one row and of several round differently.
        assert joint.posterior == pytest.approx(single.posterior, abs=1e-9)


def test_images_lists_and_touches_are_touches(model):
    image = drawn(3).images[0]
    three = Touches(np.stack([image] * 3))
    for touch, n_touches in (
        (image, 1),
        (three, 3),
        (three.images, 3),
        ([image] * 3, 3),
        ([three], 3),
        ([three[:1], three], 4),
    ):
        assert model.start().update(touch).touches_used == n_touches


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ([[1.0, 2.0], [3.0]], "touch must be one array, got lists"),
        ([], r"touch must be .* got an array of shape \(0,\)\.$"),
        (np.zeros(3), r"touch must be .* got an array of shape \(3,\)\.$"),
        (np.zeros((1, 2, 2, 2, 3)), r"touch must be .* shape \(1, 2, 2, 2, 3\)\.$"),
        (np.zeros((4, 2, 4, 3)), r"\(4, 2, 4, 3\)\. Name its channels: Touches"),
    ],
)
def test_what_is_no_touch_is_refused(model, bad, message):
    belief = model.start()
    for take in (belief.update, Episode(belief).add):
        with pytest.raises(ValueError, match=message):
            take(bad)
    assert belief.touches_used == 0


def test_an_episode_shows_its_sentence(start, model):
    episode = Episode(start(), error=0.05)
    assert repr(episode) == "<Episode: no touch yet: touch it>"
    episode.add(touch_evidence(model, 1, 96, 1, 1, 1))
    assert repr(episode) == "<Episode: cup, 96 % after 1 touch>"
