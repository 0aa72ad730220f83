"""What a report says of single episodes, against the beliefs they are made of."""

import re
from base64 import b64decode
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.evaluation import Plan, evaluate, explained_episodes, write_report

from .conftest import drawn

NAMES = ("bowl", "key", "mug", "pen")
PLAN = Plan(touches=(1, 3), orders=6, error=0.2, seed=3)


def rings(seed):
    """Rings of 10 x 10 taxels, whose radii are alike."""
    rng, x = np.random.default_rng(seed), np.arange(10) - 4.5
    radius = 2 + 0.4 * np.repeat(np.arange(4), 16)[:, None, None]
    radius = radius + 0.3 * rng.normal(size=radius.shape)
    images = np.exp(-((np.hypot(x[:, None], x) - radius) ** 2))
    images += 0.1 * rng.normal(size=images.shape)
    return Touches(images, object=np.repeat(NAMES, 16), geometry="array")


@pytest.fixture(scope="module", params=["electrodes", "rings"])
def result(request):
    """Evaluate touches in so much noise that some objects are confused."""
    if request.param == "electrodes":
        return evaluate(*(drawn(seed, NAMES, noise=4.0) for seed in (0, 1)), plan=PLAN)
    # The paper's preset chooses nothing, which saves seconds.
    return evaluate(rings(0), rings(1), plan=replace(PLAN, preset="liu2014"))


def section(page):
    return page[page.index("<h2>Why") : page.index("<h2>Touches of each")]


def test_wrong_decisions_come_first_and_right_ones_follow(result):
    figures, trials = result
    explained = explained_episodes(figures, trials)
    assert 1 < len(explained) <= 6
    rights = [episode.right for episode in explained]
    assert rights == sorted(rights)
    end = trials[0].episodes.decide(PLAN.error)
    assert (end.decided & ~end.right).any()
    assert end.right.any()
    assert set(rights) == {False, True}
    for episode in explained:
        assert (episode.label == episode.truth) == episode.right


def test_an_explained_episode_has_the_touches_of_the_figures(result):
    figures, trials = result
    episodes = trials[0].episodes
    for episode in explained_episodes(figures, trials):
        test = trials[0].fold.test[episode.rows]
        assert set(test.object) == {episode.name}
        belief = trials[0].recogniser.start(strangers=0).update(test)
        after = np.exp(episodes.beliefs[episodes.objects.index(episode.name)])
        same = after[:, len(episode.rows) - 1]
        # One of the six orders led to this belief, up to rounding of sums.
        gap = np.abs(same - list(belief.posterior.values())).max(axis=1).min()
        assert_allclose(gap, 0, atol=1e-9)
        assert episode.label in (belief.best, "unknown")


def test_the_page_shows_touches_beside_their_nearest(result, tmp_path):
    figures, trials = result
    page = section(write_report(tmp_path / "r.html", figures, trials).read_text())
    recogniser, fold = trials[0].recogniser, trials[0].fold
    explained = explained_episodes(figures, trials)
    steps = [
        (episode, step)
        for episode in explained
        for step in recogniser.start().update(fold.test[episode.rows]).explain()
    ]
    lines = re.findall(r"touch (\d+):<br>([\d.]+) nats for (\w+)<br>over (\w+)", page)
    assert len(lines) == len(steps)
    for (touch, nats, more, less), (_, step) in zip(lines, steps, strict=True):
        assert int(touch) == step["touch"]
        assert float(nats) == pytest.approx(abs(step["nats"]), abs=0.051)  # 1 decimal
        assert {more, less} == {step["best"], step["rival"]}
        assert (more == step["best"]) == (step["nats"] > 0)
    for episode in explained:
        belief = recogniser.start().update(fold.test[episode.rows])
        assert belief.reason(PLAN.error) in page
    assert "stranger" not in page  # none is called unknown
    doubting = figures["decision"] | {"strangers": 0.5, "refusal": 0.5}
    doubtful = figures | {"decision": doubting}
    told = write_report(tmp_path / "d.html", doubtful, trials).read_text()
    called = explained_episodes(doubtful, trials)
    assert {episode.label for episode in called} == {"unknown"}
    for episode in called:
        evidence = recogniser.start().update(episode.touches).unknown_evidence
        words = f"speak for a stranger by {evidence:.1f} nats; among what was learnt"
        assert words in told
    pictures = page.count("<img")
    if recogniser.chosen_["geometry"] == "none":
        assert pictures == 0
        return
    assert pictures == sum(1 + len(step["nearest"]) for _, step in steps)
    episode, step = steps[0]
    test_touch = fold.test[episode.rows[[step["touch"] - 1]]]
    nearest = fold.train[np.array([step["nearest"][0]["row"]])]
    assert nearest.object[0] == step["nearest"][0]["object"]
    coded = re.findall(r"src='data:image/png;base64,([^']+)'", page)
    pictures = [
        cv2.imdecode(np.frombuffer(b64decode(text), np.uint8), cv2.IMREAD_GRAYSCALE)
        for text in coded
    ]
    drawn = [picture.ravel() for picture in pictures if picture.shape == (72, 72)]
    for touch in (test_touch, nearest):
        (cleaned,) = recogniser.encoder_.clean(touch)
        levels = cleaned.astype(np.float32)
        large = cv2.resize(levels, (72, 72), interpolation=cv2.INTER_NEAREST).ravel()
        # Alike but for 256 levels, and contrast that leaves out the last half per cent.
        assert max(np.corrcoef(large, shown)[0, 1] for shown in drawn) > 0.98


def test_confused_pairs_are_of_two_objects_the_most_confused_first(result, tmp_path):
    page = write_report(tmp_path / "r.html", *result).read_text()
    part = page[page.index("<h2>Most confused pairs") :]
    confused = re.findall(r"<b>(\w+)</b> taken for <b>(\w+)</b>: (\d+) %", part)
    assert confused
    shares = [int(share) for *_, share in confused]
    assert shares == sorted(shares, reverse=True)
    assert all(true != taken for true, taken, _ in confused)
    confusion = np.mean([t.episodes.scores(3).confusion for t in result[1]], axis=0)
    names = result[1][0].recogniser.classes_.tolist()
    for true, taken, share in confused:
        row, col = names.index(true), names.index(taken)
        assert int(share) == pytest.approx(100 * confusion[row, col], abs=0.51)


def test_a_pair_without_a_confused_touch_left_has_a_report_too(result, tmp_path):
    """More folds add nothing to four pictures; some pairs have no single touch."""
    figures, trials = result
    page = write_report(tmp_path / "r.html", figures, [*trials] * 3).read_text()
    assert "one at a time" in page
    alone = [
        replace(t, episodes=replace(t.episodes, singles=None, beliefs=first_right(t)))
        for t in trials
    ]
    page = write_report(tmp_path / "r.html", figures, alone).read_text()
    assert "one at a time" not in page
    assert "taken for <b>" in page


def first_right(trial):
    """Return the beliefs of a trial, made sure of the truth after one touch."""
    return [
        np.concatenate([0 * b[:, :1] + np.eye(b.shape[2])[truth], b[:, 1:]], axis=1)
        for truth, b in zip(trial.episodes.truth, trial.episodes.beliefs, strict=True)
    ]


def ended(result, decision, strangers=None):
    """Return the summary of a result whose episodes ended so."""
    figures, _ = result
    decision = figures["decision"] | decision
    ends = {"decision": decision}
    if strangers is not None:
        ends["unknown_decision"] = decision | {"answers": {}} | strangers
    return [*type(figures)(figures | ends).summary()]


def test_names_given_to_strangers_are_wrong_names(result):
    """An error of 1 % needs log(0.05) / log(0.99) = 299 objects without a mistake."""
    decision = {"right": 91, "wrong": 2, "error": 0.01, "n_objects": 5}
    decision |= {"can_be_verified": False, "refused": 3, "n_episodes": 100}
    assert (
        "0 of 20 names were wrong; 1 named object cannot prove an error of 1 %, about "
        "300 would."
    ) in ended(result, decision | {"right": 20, "wrong": 0, "n_objects": 1})
    alone = (
        "2 of 93 names were wrong; 5 named objects cannot prove an error of 1 %, about "
        "300 would."
    )
    assert alone in ended(result, decision)
    assert alone in ended(result, decision, {"wrong": 0})
    assert (
        "22 of 113 names were wrong, 20 of them given to strangers; strangers aside, 5 "
        "named objects cannot prove an error of 1 %, about 300 would."
    ) in ended(result, decision, {"wrong": 20})
    none = decision | {"right": 0, "wrong": 0, "refused": 0}
    assert (
        "No episode ended with a name: all 100 with known objects stayed undecided."
    ) in ended(result, none)
    assert (
        "No episode ended with a name: of 100 with known objects 10 were called "
        "unknown, and the others stayed undecided."
    ) in ended(result, none | {"refused": 10})
    none |= {"refused": 100}
    assert (
        "20 of 20 names were wrong, 20 of them given to strangers; no known object was "
        "named."
    ) in ended(result, none, {"wrong": 20})
    assert (
        "No episode ended with a name: in all 100 episodes a known object was called "
        "unknown."
    ) in ended(result, none, {"wrong": 0})
