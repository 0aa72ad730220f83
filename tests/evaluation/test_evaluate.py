"""The protocol on drawn touches: figures known from how they were drawn."""

import json
import re
from collections import Counter
from dataclasses import replace
from html import escape

import numpy as np
import pytest

from palpate import Touches
from palpate.cli._output import answer
from palpate.evaluation import (
    Plan,
    _report,
    evaluate,
    explained_episodes,
    write_report,
)
from palpate.evaluation._report import whole_ticks
from palpate.evaluation._trial import confusion_of

from .conftest import drawn, often_idle

PLAN = Plan(touches=(1, 3, 6), orders=5)
NAMES = ("mug_a", "mug_b", "pen_a", "pen_b")


@pytest.fixture(scope="module")
def result():
    # Each of two strangers has eight touches like those of each known object.
    parts = drawn(3, NAMES)
    mixed = np.tile(["key_a", "key_b"], 32)
    unknown = Touches(parts.images, object=mixed, geometry="none")
    return evaluate(drawn(0, NAMES), drawn(1, NAMES), unknown=unknown, plan=PLAN)


def test_distinct_objects_are_told_apart(result):
    figures, _ = result
    assert figures["accuracy"]["6"] == 1
    assert figures["n_labels"] == 4
    assert figures["n_train_touches"] == figures["n_test_touches"] == 64
    assert figures["n_objects"] == {"1": 4, "3": 4, "6": 4}
    assert figures["unknown_auroc"]["6"] > 0.9
    assert figures["seconds"].keys() == {
        "learn",
        "encode_per_touch",
        "recognise_per_touch",
    }
    json.dumps(figures)


@pytest.mark.parametrize(("n_again", "is_said"), [(6, False), (7, True)])
def test_a_tenth_of_touches_that_were_taught_too_is_the_verdict(n_again, is_said):
    """Also where one file holds counts as whole numbers, and another as floats."""
    train, test = (
        Touches((1000 * touches.images).round(), **touches.columns, **touches.whole)
        for touches in (drawn(0, NAMES), drawn(1, NAMES))
    )
    met = Touches.concatenate([train[:n_again], test[n_again:]])
    whole = Touches(train.images.astype(np.int32), **train.columns, **train.whole)
    figures, _ = evaluate(whole, met, plan=PLAN)
    assert figures["n_test_touches_taught"] == n_again
    said = figures["verdict"].startswith("This says little of new touches: 7 of 64 ")
    assert said == is_said


def test_controls_without_their_cause_are_absent(result):
    controls = result[0]["controls"]
    assert controls["disc centre"] is None
    assert controls["no contact"] is None
    assert set(controls["brightness"]) == {"1", "3", "6"}


@pytest.mark.parametrize("name", ["an_idle_one", "the_idle_one"])
def test_touches_that_say_nothing_name_nothing(name):
    """Of equal beliefs the first in the alphabet is no answer."""
    figures, trials = evaluate(often_idle(0, name), often_idle(1, name), plan=PLAN)
    assert figures["flags"]["no contact"] == 5 / 32
    assert figures["controls"]["no contact"] == {"1": 0, "3": 0}
    # Nor are they mistakes.
    np.testing.assert_array_equal(confusion_of(trials, 1)[1], np.eye(2))


def test_decisions_are_right_and_use_few_touches(result):
    decision = result[0]["decision"]
    assert decision["accuracy"] == 1
    assert 1 <= decision["mean_touches"] < 16
    assert (decision["error"], decision["refusal"]) == (0.01, 0.01)
    assert decision["right"] == decision["n_episodes"]
    assert decision["wrong"] == decision["refused"] == decision["undecided"] == 0
    assert not decision["can_be_verified"]


def test_ends_of_episodes_with_strangers_are_those_of_the_figures(result):
    figures, trials = result
    decision = figures["unknown_decision"]
    n_episodes = sum(len(b) for b in trials[0].unknown_episodes.beliefs)
    assert decision["n_episodes"] == n_episodes
    undecided = round(decision["undecided"] * n_episodes)
    assert decision["right"] == 0
    assert decision["wrong"] + decision["refused"] + undecided == n_episodes
    parts = [*figures.summary()]
    *_, (_, columns, (known_row, stranger_row)) = (
        part for part in parts if not isinstance(part, str)
    )
    assert (columns[0], known_row[0], stranger_row[0]) == (
        "objects",
        "known",
        "strangers",
    )
    assert stranger_row[3].startswith(f"{decision['refused']} (")
    answers = decision["answers"]
    assert {*answers} == {*trials[0].unknown_episodes.objects}
    all_answers = sum((Counter(each) for each in answers.values()), Counter())
    assert all_answers.total() == n_episodes
    assert all_answers["unknown"] == decision["refused"]
    assert all_answers["undecided"] == undecided
    assert sum(", never learnt: " in part for part in parts) == len(answers)


def test_wrong_names_of_strangers_are_explained_first(tmp_path):
    """A thing that feels just like a learnt one gets its name."""
    alike = drawn(2, NAMES[:1])
    stranger = Touches(alike.images, object=[NAMES[3]] * 16, geometry="none")
    train, test = drawn(0, NAMES[:3]), drawn(1, NAMES[:3])
    plan = Plan(touches=(1, 3), orders=3)
    figures, trials = evaluate(train, test, unknown=stranger, plan=plan)
    assert figures["unknown_decision"]["wrong"] > 0
    first, *others = explained_episodes(figures, trials)
    assert first.is_stranger
    assert not first.right
    assert first.name == first.truth == NAMES[3]
    assert first.label == NAMES[0]
    assert {*first.touches.object} == {NAMES[3]}
    assert first.label in figures["unknown_decision"]["answers"][NAMES[3]]
    assert not any(other.is_stranger for other in others)
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    page = write_report(tmp_path / "r.html", figures, trials).read_text()
    why = page[page.index("<h2>Why") :]
    assert f"<b>{NAMES[3]}</b>, never learnt, taken for <b>{first.label}</b>" in why
    (line,) = (part for part in figures.summary() if ", never learnt: " in part)
    assert line in page


def test_numbers_of_touches_that_no_object_has_are_named():
    plan = Plan(touches=(1, 4, 500), orders=2)
    figures, _ = evaluate(drawn(0, NAMES), split="between", plan=plan)
    assert list(figures["accuracy"]) == ["1", "4"]
    (left_out,) = (note for note in figures["notes"] if note.startswith("Left out"))
    assert left_out == (
        "Left out: figures after 500 touches; no object has more than 4 test touches."
    )


def test_numbers_of_touches_in_any_order_give_the_same_figures(result):
    plan = replace(PLAN, touches=(6, 1, 3, 6))
    figures, _ = evaluate(drawn(0, NAMES), drawn(1, NAMES), plan=plan)
    assert [*figures["accuracy"].items()] == [*result[0]["accuracy"].items()]
    assert "right after 6 touches" in figures["verdict"]
    assert [*figures["controls"]["brightness"]] == ["1", "3", "6"]


def test_shares_above_the_learnt_limit_are_of_both_kinds(result):
    figures, (trial,) = result
    limit = trial.recogniser.strangers_.threshold(3)
    for key, episodes in (
        ("unknown_refused", trial.unknown_episodes),
        ("known_refused", trial.episodes),
    ):
        share = (episodes.unknown_after(3) > limit).mean()
        assert figures[key]["3"] == pytest.approx(share)


def test_every_episode_ends_as_a_belief_that_decides_after_each_touch():
    train, test = drawn(0, NAMES, noise=1.5), drawn(1, NAMES, noise=1.5)
    plan = Plan(touches=(1, 3), orders=3, error=0.05, refusal=0.2)
    figures, (trial,) = evaluate(train, test, plan=plan)
    assert figures["decision"]["refusal"] == 0.2
    ends = trial.episodes.decide(0.05, 0.2)
    rows = np.concatenate(trial.episodes.rows)
    assert ends.decided.sum() > 0
    for number, touches in enumerate(rows):
        belief, used, decision = trial.recogniser.start(), 0, None
        while decision is None and used < len(touches):
            belief.update(test[touches[used : used + 1]])
            decision, used = belief.decide(0.05, refusal=0.2), used + 1
        assert ends.touches[number] == used
        assert ends.decided[number] == (decision is not None)
        assert ends.refused[number] == (decision == "unknown")
        assert ends.right[number] == (decision == ends.objects[number])


def test_how_episodes_end_is_in_the_report(result, tmp_path):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    page = write_report(tmp_path / "r.html", *result).read_text()
    assert "Stopping at an error of 0.01, a refusal of 0.01" in page
    assert "<td>called unknown</td>" in page
    assert escape(result[0]["verdict"]) in page
    assert re.search(r"<td>[^<]*</td>(<td>-</td>)+</tr>", page) is None
    assert re.search(r"<b>([^<]+)</b>[^<]* taken for <b>\1</b>", page) is None
    assert "named objects cannot prove an error of 1 %, about 300 would." in page
    assert "category right, %" in page


def test_pure_noise_is_recognised_at_chance():
    noise = Touches(
        np.random.default_rng(0).normal(size=(400, 3, 24)),
        object=np.repeat(["a", "b", "c", "d"], 100),
        geometry="none",
    )
    figures, _ = evaluate(noise, split="between", plan=Plan(touches=(1,), orders=2))
    # 100 test touches at chance 0.25: four standard errors.
    assert abs(figures["accuracy"]["1"] - 0.25) < 0.18


def test_objects_with_fewer_touches_are_left_out_at_k():
    test = drawn(1, NAMES)
    fewer = test[np.r_[0:16, 16:18, 32:48, 48:64]]
    figures, _ = evaluate(drawn(0, NAMES), fewer, plan=PLAN)
    assert figures["n_objects"] == {"1": 4, "3": 3, "6": 3}


def test_one_touch_uses_every_test_touch_once():
    figures, trials = evaluate(drawn(0, NAMES), drawn(1, NAMES, noise=3), plan=PLAN)
    best = trials[0].evidence.log_likelihood.argmax(axis=1)
    hits = trials[0].recogniser.classes_[best] == trials[0].fold.test.object
    assert figures["accuracy"]["1"] == pytest.approx(hits.mean())


def test_of_unseen_objects_categories_are_recognised(tmp_path, capsys):
    """What is expected of another day is of learnt objects, and none was learnt."""
    figures, trials = evaluate(drawn(0, NAMES), split="unseen-objects", plan=PLAN)
    assert figures["label"] == "category"
    assert figures["n_folds"] == len(trials) == 2
    assert figures["n_labels"] == 2
    alone = type(figures)(figures | {"left_out": ["key"]}).summary()
    assert "Never asked, alone in their category: 1 (key)." in alone
    page = write_report(tmp_path / "r.html", figures, trials).read_text()
    assert re.search(r"<b>(mug|pen)_[ab]</b> \(\1\) ", page)
    answer(False, figures, *figures.summary())
    for text in (page, capsys.readouterr().out):
        assert "none in two" not in text
    learnt = type(figures)(figures | {"split": "last"})
    answer(False, learnt, *learnt.summary())
    assert "none in two" in capsys.readouterr().out


def test_training_touches_drawn_with_the_same_seed_give_the_same_figures():
    plan = Plan(touches=(1, 3), orders=3, train_touches=8, seed=5)
    first, _ = evaluate(drawn(0, NAMES), split="last", plan=plan)
    second, _ = evaluate(drawn(0, NAMES), split="last", plan=plan)
    assert first["n_train_touches"] == 32
    for key in ("accuracy", "log_loss", "ece", "controls", "decision"):
        assert first[key] == second[key]


def test_report_is_one_file_that_loads_nothing(result, tmp_path):
    path = write_report(tmp_path / "r.html", *result)
    page = path.read_text()
    addresses = re.findall(r"(?:src|href)=['\"]?([^'\" >]+)", page)
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert "<script" not in page
    for name in NAMES:
        assert name in page


def test_report_escapes_names(tmp_path):
    names = ("<script>alert(1)</script>", "b")
    figures, trials = evaluate(drawn(0, names), drawn(1, names), plan=PLAN)
    page = write_report(tmp_path / "r.html", figures, trials).read_text()
    assert "<script>" not in page


def test_controls_are_named_as_such(result):
    figures, _ = result
    after = dict.fromkeys(figures["accuracy"], 0.25)
    controls = {"brightness": after, "no contact": after}
    parts = type(figures)(figures | {"controls": controls}).summary()
    _, _, lines = next(part for part in parts if not isinstance(part, str))
    names = [name for name, *_ in lines]
    assert [name for name in names if "alone" in name or "without" in name] == [
        "control: brightness alone, %",
        "control: touches without contact alone, %",
    ]


def test_text_in_backticks_is_code_in_a_report(result, tmp_path):
    figures, trials = result
    command = "palpate evaluate --split session"
    texts = {
        "recommendations": [f"Say `{command}` & --seed."],
        "notes": ["No `order`."],
    }
    page = write_report(tmp_path / "r.html", figures | texts, trials).read_text()
    assert f"Say <code>{command}</code> &amp; <code>--seed</code>." in page
    assert "No <code>order</code>." in page
    assert "`" not in page


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either `test` touches or a `split`.*got neither"),
        ({"test": drawn(1, NAMES), "split": "last"}, "got both"),
        ({"test": drawn(1, ("mug_a", "key_a"))}, "'key_a', which was not learnt"),
        ({"split": "last", "plan": Plan(touches=(500,))}, "a number up to 4"),
        ({"split": "last", "unknown": drawn(1, ("mug_a",))}, "got 'mug_a'"),
        # A mug that was never learnt is no stranger where mugs are.
        (
            {
                "split": "last",
                "unknown": drawn(1, ("key_a", "mug_c")),
                "plan": Plan(label="category"),
            },
            "unknown touches must be of .* got 'mug'",
        ),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        evaluate(drawn(0, NAMES), **arguments)


@pytest.mark.parametrize("name", ["train", "test", "unknown"])
def test_images_without_labels_are_refused_by_their_name(name):
    arguments = {"train": drawn(0, NAMES), name: np.ones((4, 3, 24))}
    split = None if name == "test" else "last"
    with pytest.raises(TypeError, match=f"{name} must be Touches, got ndarray"):
        evaluate(**arguments, split=split)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"touches": (0,)}, "touches must be at least 1"),
        ({"touches": ()}, r"touches must hold numbers .* got \(\)"),
        ({"touches": 5}, "touches must hold numbers .* got 5"),
        ({"remount": None}, "remount must be none, .* got None"),
        ({"remount": "twice"}, "remount must.*twice"),
        ({"remount": "confirm"}, "remount must.*confirm"),
        ({"remount": "recentre:0"}, "remount must.*recentre:0"),
        ({"remount": "confirm:-1"}, "remount must.*confirm:-1"),
        ({"remount": "none:3"}, "remount must.*none:3"),
        ({"remount": "recentre:x"}, "remount must.*recentre:x"),
        ({"label": "size"}, "'object', 'category'"),
        ({"preset": "best"}, "'default'"),
        ({"error": 5.0}, "error must be finite and between"),
        ({"orders": 0}, "orders must be at least 1"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_a_plan_is_checked_before_anything_is_read(values, message):
    with pytest.raises(ValueError, match=message):
        Plan(**values)


def test_calibration_is_told_before_and_after():
    # Neighbouring touches that are moved alike count for fewer than they are.
    rng = np.random.default_rng(0)
    parts = [drawn(seed, NAMES, noise=2.5) for seed in (0, 1)]
    moved = [p.images + 3 * np.repeat(rng.normal(size=(8, 3, 24)), 8, 0) for p in parts]
    sets = [
        Touches(images, **p.columns, **p.whole)
        for images, p in zip(moved, parts, strict=True)
    ]
    figures, _ = evaluate(*sets, plan=PLAN)
    assert figures["ece"].keys() == figures["ece_before"].keys()
    assert figures["ece"]["1"] == pytest.approx(figures["ece_before"]["1"])
    assert figures["ece"]["6"] < figures["ece_before"]["6"]


def test_ticks_are_whole_round_and_few():
    assert whole_ticks(5) == [1, 2, 3, 4, 5]
    assert whole_ticks(20) == [1, 5, 10, 15, 20]
    assert all(len(whole_ticks(n)) <= 8 for n in range(2, 400))


@pytest.mark.slow
def test_how_often_an_object_was_taught_is_no_nuisance_of_the_sensor(
    monkeypatch, tmp_path
):
    """Each object has three parts of noise; a fold tests one part of one object.

    Nothing tells the objects apart, so no control may name more than chance and a
    chance of the draw. Rows of the matrix of names are of the folds that test them.
    """
    rng = np.random.default_rng(5)
    names = np.repeat(["mug", "box", "pen"], 24)
    parts = np.char.add(names, np.tile(np.repeat(list("abc"), 8), 3))
    about = {"object": names, "session": parts, "geometry": "none"}
    noise = Touches(rng.random((72, 1, 64)), **about)
    plan = Plan(touches=(1, 3), orders=2)
    figures, trials = evaluate(noise, split="session", plan=plan)
    assert len(trials) == 9
    for name in ("brightness", "sorted pixels"):
        assert max(figures["controls"][name].values()) < 0.6
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    drawn_shares = []
    monkeypatch.setattr(
        _report,
        "confusion_plot",
        lambda shares, names: drawn_shares.append(shares) or "",
    )
    write_report(tmp_path / "r.html", figures, trials)
    np.testing.assert_allclose(drawn_shares[0].sum(axis=1), 1)


def test_controls_that_do_as_well_are_named_with_the_touches(result):
    figures, _ = result
    curves = {
        "accuracy": {"1": 0.5, "5": 0.9},
        "controls": {
            "brightness": {"1": 0.5, "5": 0.8},
            "disc centre": {"1": 0.6, "5": 0.95},
            "sorted pixels": {"1": 0.1, "5": 0.2},
            "no contact": {"1": 0.9, "5": 0.9},
            "absent": None,
        },
    }
    sentences = [
        part
        for part in type(figures)(figures | curves).summary()
        if "alone does as well" in part
    ]
    assert [sentence.split(":")[0] for sentence in sentences] == [
        "brightness alone does as well after 1 touch",
        "disc centre alone does as well after 1, 5 touches",
    ]
    assert all("may have learnt the recording" in sentence for sentence in sentences)
