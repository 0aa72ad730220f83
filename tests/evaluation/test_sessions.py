"""Sessions and persons left out, and remounting to the session that is tested."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches, simulate_touches
from palpate.evaluation import Plan, evaluate, explained_episodes, write_report
from palpate.recognition import sessions_message
from palpate.simulation import DomeCamera

CENTRES = 4 * np.random.default_rng(7).normal(size=(5, 8))
MOVES = {
    "mon": np.zeros(8),
    "tue": np.array([6.0, -5, 4, 0, 7, -3, 5, 4]),
    "wed": np.array([-4.0, -5, 3, -7, 0, -4, 5, -6]),
}
PLAN = Plan(touches=(1, 3), orders=4)


def visited(session, n, seed, objects="abcde", subject="ann"):
    rng = np.random.default_rng(seed)
    names = np.repeat(list(objects), n)
    images = CENTRES[["abcde".index(name) for name in names]] + MOVES[session]
    images = images + rng.normal(size=images.shape)
    columns = {"session": [session] * len(names), "subject": [subject] * len(names)}
    order = np.tile(np.arange(n), len(objects))
    return Touches(
        images[:, None], object=names, order=order, geometry="none", **columns
    )


@pytest.fixture(scope="module")
def week():
    """Five objects on two days, of which the second did not meet "e"."""
    days = [visited("mon", 8, 0), visited("tue", 6, 1, "abcd", "bob")]
    return Touches.concatenate(days)


@pytest.mark.parametrize("split", ["session", "subject"])
def test_each_session_or_person_is_a_fold(week, split):
    figures, _ = evaluate(week, split=split, plan=PLAN)
    assert figures["split"] == split
    assert figures["n_folds"] == 2
    assert figures["left_out"] == ["e"]
    assert figures["n_test_touches"] == 32 + 24


def test_figures_are_of_all_folds_and_their_labels(tmp_path):
    """Without Monday two objects are taught, without another day all four."""
    days = [visited("mon", 6, 0, "abcd"), visited("tue", 6, 1, "a")]
    touches = Touches.concatenate([*days, visited("wed", 8, 2, "ab")])
    kinds = ["x" if name in "ab" else "y" for name in touches.object]
    plan = Plan(preset="liu2014", touches=(1, 7), orders=2)
    figures, trials = evaluate(
        touches.with_columns(category=kinds), split="session", plan=plan
    )
    assert [len(trial.recogniser.classes_) for trial in trials] == [2, 4, 4]
    assert figures["n_labels"] == 4
    assert figures["chance"] == pytest.approx(np.mean([1 / 2, 1 / 4, 1 / 4]))
    # One fold has seven touches of an object: between folds there is no spread.
    assert figures["accuracy_sd"]["7"] is None
    per_fold = []
    for trial in trials:
        names = trial.recogniser.classes_
        best = [
            np.isin(names[b.argmax(axis=1)], ["a", "b"])
            for b in trial.episodes.after(1)[1]
        ]
        per_fold.append(np.mean([right.mean() for right in best]))
    assert per_fold[0] == 1 > min(per_fold)
    assert figures["category_accuracy"]["1"] == pytest.approx(np.mean(per_fold))
    page = write_report(tmp_path / "r.html", figures, trials).read_text()
    assert "<div class=name>c</div>" in page


def test_a_session_of_few_touches_leaves_the_figures_of_the_others(week):
    """As long as one session has as many touches as are asked for."""
    figures, _ = evaluate(week, split="session", plan=Plan(touches=(7,), orders=2))
    assert figures["n_objects"] == {"7": 4}
    with pytest.raises(ValueError, match="a number up to 8"):
        evaluate(week, split="session", plan=Plan(touches=(9,), orders=2))


def test_using_the_touches_of_a_session_without_labels_helps():
    train, test = visited("mon", 12, 0), visited("tue", 12, 1)
    as_it_is, _ = evaluate(train, test, plan=PLAN)
    recentring = Plan(touches=(1, 3), orders=4, remount="recentre")
    recentred, (trial,) = evaluate(train, test, plan=recentring)
    assert recentred["accuracy"]["1"] > as_it_is["accuracy"]["1"] + 0.1
    assert recentred["n_test_touches"] == 60
    assert recentred["remount"] == "recentre"
    assert not trial.recogniser.chosen_["remount"]["labelled"]
    # Labels of the test touches tell it nothing.
    mixed = np.random.default_rng(0).permutation(test.object)
    _, (other,) = evaluate(train, test.with_columns(object=mixed), plan=recentring)
    offsets = trial.recogniser.encoder_.offset, other.recogniser.encoder_.offset
    assert np.array_equal(*offsets)
    recentring_on_ten = Plan(touches=(1, 3), orders=4, remount="recentre:10")
    _, (trial,) = evaluate(train, test, plan=recentring_on_ten)
    assert trial.recogniser.chosen_["remount"]["n_touches"] == 10


def test_touches_of_no_known_session_get_used_to_one_of_their_own():
    train, test = visited("mon", 8, 0), visited("mon", 6, 1)
    days = {n: np.tile([1, 2, none], 10) for n, none in (("nan", np.nan), ("3", 3))}
    figures = [
        evaluate(
            train,
            test.with_columns(session=session),
            plan=Plan(touches=(1,), orders=2, remount="recentre"),
        )[0]["accuracy"]
        for session in days.values()
    ]
    assert figures[0] == figures[1]


def test_for_test_touches_of_another_session_remounting_is_recommended():
    train, test = visited("mon", 12, 0), visited("tue", 12, 1)
    figures, (trial,) = evaluate(train, test, plan=PLAN)
    assert trial.fold.elsewhere
    advice = " ".join(figures["recommendations"])
    assert "try `remount=recentre:10`" in advice
    assert "All was taught in one session" not in advice
    for same in (test.with_columns(session=["mon"] * 60), test.without("session")):
        figures, (trial,) = evaluate(train, same, plan=PLAN)
        assert not trial.fold.elsewhere
        assert "remount=" not in " ".join(figures["recommendations"])


def test_strangers_are_asked_of_what_got_used_to_their_session():
    train = visited("mon", 12, 0, "abcd")
    days = [visited(day, 10, seed, "abcd") for seed, day in enumerate(("tue", "wed"))]
    strangers = [visited(day, 6, 3, "e") for day in ("wed", "tue")]
    unknown = Touches.concatenate(strangers).with_columns(object=[*"xxxxxxyyyyyy"])
    # Without strangers all of them get a name, which the report explains.
    named = {"error": 0.5, "strangers": 0.0}
    plan = Plan(touches=(1,), orders=2, remount="recentre", **named)
    figures, trials = evaluate(
        train, Touches.concatenate(days), unknown=unknown, plan=plan
    )
    (both,) = trials
    assert both.unknown.session.tolist() == ["tue"] * 6 + ["wed"] * 6
    beliefs = dict(zip("xy", both.unknown_episodes.singles.beliefs, strict=True))
    for name, test, stranger in zip("yx", days, strangers[::-1], strict=True):
        _, (alone,) = evaluate(train, test, unknown=stranger, plan=plan)
        assert_array_equal(alone.unknown_episodes.singles.beliefs[0], beliefs[name])
    explained = [e for e in explained_episodes(figures, trials) if e.is_stranger]
    assert {episode.name for episode in explained} == {"x", "y"}
    for episode in explained:
        place, n = both.unknown_episodes.objects.index(episode.name), len(episode.rows)
        order = (both.unknown_episodes.rows[place][:, :n] == episode.rows).all(axis=1)
        met = both.unknown_episodes.beliefs[place][order.argmax(), n - 1]
        belief = both.recogniser.start(strangers=0.0).update(episode.evidence)
        # Up to rounding of sums.
        assert_allclose(belief.log_posterior, met, atol=1e-9)


@pytest.mark.parametrize("remount", ["recentre", "confirm:2"])
def test_a_dome_of_another_resolution_is_asked_once_it_is_remounted(remount):
    def touched(side, n, seed):
        camera = DomeCamera(image_shape=(side, side), n_nodes=24)
        return simulate_touches(["ball", "pen"], n, camera, random_state=seed)

    train, test = touched(48, 8, 0), touched(56, 6, 1)
    plan = Plan(touches=(1,), orders=2, remount=remount)
    figures, (trial,) = evaluate(train, test, plan=plan)
    assert figures["accuracy"]["1"] > 0.7
    assert trial.recogniser.encoder_.image_shape_ == (56, 56)
    with pytest.raises(ValueError, match=r"48 x 48 .* got 56 x 56"):
        evaluate(train, test, plan=PLAN)


def test_each_session_of_the_test_is_recentred_by_itself(tmp_path):
    train = visited("mon", 12, 0)
    test = Touches.concatenate([visited("tue", 10, 1), visited("wed", 10, 2)])
    plan = Plan(touches=(1,), orders=2, remount="recentre")
    figures, trials = evaluate(train, test, plan=plan)
    assert figures["accuracy"]["1"] > 0.9
    # A report explains touches by what they told in their own session.
    page = write_report(tmp_path / "recentred.html", figures, trials).read_text()
    whys = re.findall(r"<p><b>(.)</b> recognised.<br><span class=note>(.*?),", page)
    assert whys
    assert all(why == name for name, why in whys)


def test_confirmed_touches_are_the_first_of_each_object_and_not_tested(tmp_path):
    train, test = visited("mon", 12, 0), visited("tue", 5, 1)
    plan = Plan(touches=(1, 3), orders=4, remount="confirm:2")
    figures, (trial,) = evaluate(train, test, plan=plan)
    assert figures["n_test_touches"] == 15
    assert set(trial.fold.test.order) == {2, 3, 4}
    assert len(trial.recogniser.memory_) == 60 + 10
    assert trial.recogniser.chosen_["remount"]["labelled"]
    # The last rows of the memory are theirs, and may be the nearest ones in a report.
    write_report(tmp_path / "confirmed.html", figures, [trial])
    assert trial.taught(59).order == 11
    theirs = [trial.taught(row) for row in range(60, 70)]
    assert [str(touch.object[0]) for touch in theirs] == list("aabbccddee")
    assert [int(touch.order[0]) for touch in theirs] == [0, 1] * 5
    assert not figures["notes"]
    fewer = test[(test.object != "a") | (test.order < 2)]
    figures, _ = evaluate(train, fewer, plan=plan)
    assert figures["notes"] == [
        "Not asked, as all their test touches were confirmed: a."
    ]
    with pytest.raises(ValueError, match="'confirm:5', which takes all"):
        evaluate(train, test, plan=Plan(touches=(1,), remount="confirm:5"))


def test_the_first_touches_are_those_that_were_made_first():
    """By `time_s` where there is no `order`, as they are split."""
    train, test = visited("mon", 12, 0), visited("tue", 5, 1)
    backwards = test.without("order").with_columns(time_s=-test.order.astype(float))
    plan = Plan(touches=(1,), orders=2, remount="confirm:2")
    _, (trial,) = evaluate(train, backwards, plan=plan)
    assert set(trial.fold.test.columns["time_s"]) == {0, -1, -2}


def test_the_accuracy_expected_in_another_session_is_in_the_figures(week):
    figures, _ = evaluate(week, split="between", plan=Plan(touches=(1,), orders=2))
    sessions = figures["sessions"]
    assert sessions["least"] == 1
    assert sessions["median"] == 2
    assert 0 < sessions["expected"] < figures["accuracy"]["1"]


def test_where_sessions_were_tested_the_measured_accuracy_is_expected(week):
    figures, _ = evaluate(week, split="session", plan=PLAN)
    right = 100 * figures["accuracy"]["1"]
    assert (
        "Each session was left out of learning in turn: "
        f"{right:.1f} % right after 1 touch is what to expect of another session."
    ) in figures.summary()
    assert figures["n_objects"] == {"1": 4, "3": 4}  # tested in two folds
    train, test = visited("mon", 8, 0), visited("tue", 8, 1)
    plan = Plan(touches=(3,), orders=4, remount="recentre")
    elsewhere, _ = evaluate(train, test, plan=plan)
    right = 100 * elsewhere["accuracy"]["3"]
    assert (
        "Nothing was learnt from the sessions of the test touches: "
        f"{right:.1f} % right after 3 touches (remount recentre) is what to expect of "
        "another session."
    ) in elsewhere.summary()
    # The last quarter may be the last day: as good as another set.
    moves = enumerate({"mon": 8, "tue": 8, "wed": 5}.items())
    days = [visited(day, n_touches, n) for n, (day, n_touches) in moves]
    days = [d.with_columns(order=d.order + 8 * n) for n, d in enumerate(days)]
    plan = Plan(touches=(1,), orders=4)
    last_day, _ = evaluate(Touches.concatenate(days), split="last", plan=plan)
    assert (
        "Nothing was learnt from the sessions of the test touches: "
        f"{100 * last_day['accuracy']['1']:.1f} % right after 1 touch is what to "
        "expect of another session."
    ) in last_day.summary()
    here, _ = evaluate(train, split="last", plan=Plan(touches=(1,), orders=4))
    assert sessions_message(here["sessions"]) in here.summary()
