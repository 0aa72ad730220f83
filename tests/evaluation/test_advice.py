"""Recommendations after an evaluation of touches drawn so that they are right."""

from types import SimpleNamespace

import numpy as np
import pytest

from palpate import Touches
from palpate.evaluation import Plan, evaluate, few_touches
from palpate.evaluation._evaluate import recommendations, verdict

from .conftest import drawn

TAUGHT = drawn(1, [*"abc"], 40, noise=0.5)


def advice_on(recording, split="last"):
    plan = Plan(touches=(1, 3), orders=5)
    return evaluate(recording, split=split, plan=plan)[0]["recommendations"]


def test_one_session_is_named_and_two_are_not():
    assert any("one session" in sentence for sentence in advice_on(TAUGHT))
    twice = TAUGHT.with_columns(session=np.tile(["mon", "tue"], 60))
    assert not any("one session" in sentence for sentence in advice_on(twice))
    assert advice_on(twice, split="session") == []  # all is right: nothing to do


def test_a_control_that_names_the_objects_is_said_first():
    """Two objects of noise alone, one of them brighter."""
    rng = np.random.default_rng(1)
    images = rng.normal(size=(48, 3, 24)) + np.repeat([0, 8], 24)[:, None, None]
    recorded = Touches(images, object=np.repeat(["a", "b"], 24), geometry="none")
    assert "no touch" in advice_on(recorded)[0]


def test_of_many_sentences_the_first_three_are_said(monkeypatch):
    sentences = [f"Sentence {n}." for n in range(6)]
    monkeypatch.setattr("palpate.evaluation._evaluate._all", lambda *_: iter(sentences))
    assert recommendations({}, []) == sentences[:3]


NEW = {"n_test_touches": 40, "n_test_touches_taught": 0}


def figures_of(accuracy=(0.5, 0.6), **more):
    """Return figures that call for no advice, except by what `more` changes."""
    usual = {
        "accuracy": dict(zip(("1", "3"), accuracy, strict=True)),
        "flags": {},
        "chance": 0.25,
        "controls": {},
        "label": "object",
        "split": "last",
        "remount": "none",
        "sessions": {"asked": 2},
        **NEW,
    }
    figures = usual | more
    return {"elsewhere": figures["split"] in ("session", "subject")} | figures


NEVER_CONFUSED = np.eye(4)


def trial_of(n_taught=20, confusion=NEVER_CONFUSED, names="abcd"):
    """Return a trial with `n_taught` touches an object and this confusion."""
    labels = np.repeat(list(names), n_taught)
    memory = SimpleNamespace(labels=labels, objects=labels)
    classes = np.array(list(names))
    recogniser = SimpleNamespace(memory_=memory, classes_=classes, chosen_={})
    scores = SimpleNamespace(confusion=np.asarray(confusion, float))
    return SimpleNamespace(
        recogniser=recogniser,
        episodes=SimpleNamespace(scores=lambda k: scores, objects=list(names)),
        fold=SimpleNamespace(elsewhere=False),
    )


def advised(trial=None, **figures):
    """Return the advice on these figures and one trial, a sentence a line."""
    return "\n".join(recommendations(figures_of(**figures), [trial or trial_of()]))


@pytest.mark.parametrize(("share", "is_said"), [(0.09, False), (0.1, True)])
def test_a_tenth_without_contact_is_worth_saying(share, is_said):
    assert (
        "are without contact: press" in advised(flags={"no contact": share})
    ) == is_said


@pytest.mark.parametrize(
    ("n_taught", "best", "is_said"),
    [(19, 0.94, True), (20, 0.94, False), (19, 0.95, True)],
)
def test_fewer_than_twenty_touches_are_few(n_taught, best, is_said):
    advice = advised(trial_of(n_taught), accuracy=(best, best))
    few = ", ".join(f"{name} ({n_taught})" for name in "abcd")
    sentence = f"Taught with few touches of {few}: 20 are a start, 60 are good."
    assert (sentence in advice.split("\n")) == is_said


def test_few_touches_of_an_object_that_the_first_fold_did_not_meet_are_few():
    trials = [trial_of(20, np.eye(3), "abc"), trial_of(n_taught=9)]
    assert recommendations(figures_of((0.9, 0.9)), trials) == [
        "Taught with few touches of d (9): 20 are a start, 60 are good."
    ]


@pytest.mark.parametrize(
    ("best", "remount", "is_said"),
    [(0.94, "none", True), (0.95, "none", False), (0.94, "recentre", False)],
)
def test_another_mounting_is_helped_by_remounting(best, remount, is_said):
    advice = advised(accuracy=(best, best), split="session", remount=remount)
    assert ("`remount=recentre:10`" in advice) == is_said


@pytest.mark.parametrize("split", ["last", "session"])
def test_a_split_by_session_is_not_advised_once_more(split):
    """Where sessions were left out already, other advice takes its place."""
    controls = {"brightness": {"1": 0.5, "3": 0.6}}
    figures = figures_of(controls=controls, split=split)
    mon, tue = trial_of(), trial_of()
    mon.fold.elsewhere = tue.fold.elsewhere = split == "session"
    tue.episodes.objects = ["a", "b"]
    advice = "\n".join(recommendations(figures, [mon, tue]))
    assert advice.count("no touch") == 1
    assert ("split=session" in advice) == (split == "last")
    assert ("met in every session" in advice) == (split == "session")
    # Nor is it advised to meet each object in every session where each was.
    advice = "\n".join(recommendations(figures, [mon, mon]))
    assert ("no touch" in advice) == (split == "last")


@pytest.mark.parametrize(("after", "is_said"), [(0.54, False), (0.55, True)])
def test_five_points_more_are_worth_more_touches(after, is_said):
    advice = advised(accuracy=(0.5, after))
    assert advice.startswith("More touches help: 50 %") == is_said


@pytest.mark.parametrize(
    ("of_pair", "of_others", "is_said"), [(3, 1, True), (3, 2, False), (6, 3, True)]
)
def test_a_third_of_all_mistakes_is_a_pair(of_pair, of_others, is_said):
    """Four objects; the mistakes of one pair beside four others, in hundredths."""
    mistakes = np.zeros((4, 4))
    mistakes[0, 1] = of_pair
    mistakes[1, 2] = mistakes[2, 3] = mistakes[3, 0] = mistakes[2, 0] = of_others
    confusion = mistakes / 10 + np.diag(1 - mistakes.sum(axis=1) / 10)
    share = of_pair / (of_pair + 4 * of_others)
    assert (share >= 1 / 3) == is_said
    advice = advised(trial_of(confusion=confusion))
    assert (f"{100 * share:.0f} % of the mistakes are a taken" in advice) == is_said


def test_of_two_objects_and_of_few_mistakes_no_pair_is_told():
    two = trial_of(confusion=[[0.5, 0.5], [0.2, 0.8]], names="ab")
    few = np.eye(4)
    few[0, :2] = 0.96, 0.04  # a hundredth of all answers
    for trial in (two, trial_of(confusion=few)):
        assert advised(trial, accuracy=(0.5, 0.5)) == ""
    few[0, :2] = 0.88, 0.12  # three hundredths are half of five, and more
    three = trial_of(confusion=[[0.7, 0.3, 0], [0, 1, 0], [0, 0, 1]], names="abc")
    for trial in (three, trial_of(confusion=few)):
        (advice,) = advised(trial, accuracy=(0.5, 0.5)).split("\n")
        told = "After 3 touches 100 % of the mistakes are a taken for b:"
        assert advice.startswith(told)


def figured(right, control):
    after = {"1": 0.5, "5": right}
    controls = {"brightness": {"1": 0.1, "5": control}, "no contact": {"1": 1, "5": 1}}
    return {"accuracy": after, "controls": controls, "chance": 0.25, **NEW}


def test_the_verdict_is_one_sentence_on_how_good_and_why():
    beside = "where chance is 25 %, and brightness alone, which is no touch, 40 %."
    assert verdict(figured(0.97, 0.4)) == f"Good: 97 % right after 5 touches, {beside}"
    as_good = verdict(figured(0.97, 0.98))
    assert as_good.startswith("This does not show that touch works: 97 % right")
    assert "brightness alone" in as_good
    # Where all are right, a control that was behind before has only come to the end.
    assert verdict(figured(1.0, 1.0)) == (
        "Better than no touch after 1 touch, not after 5: 50 % right after 1, where "
        "chance is 25 %, and brightness alone, which is no touch, 10 %; after 5 both "
        "are 100 %."
    )
    always = {"accuracy": {"1": 1.0, "5": 1.0}, "controls": {"b": {"1": 1, "5": 1}}}
    assert verdict({**always, "chance": 0.25, **NEW}).startswith("This does not show")


def test_mistakes_are_shares_over_objects_and_trials():
    """Less than a fortieth of all answers is not worth a sentence."""
    confusion = np.eye(4)
    confusion[0, :2] = 0.84, 0.16  # of four objects a twenty-fifth
    confused = trial_of(confusion=confusion)
    assert recommendations(figures_of((0.5, 0.5)), [confused])
    faultless = trial_of()
    assert recommendations(figures_of((0.5, 0.5)), [confused, faultless]) == []


@pytest.mark.parametrize(
    ("after", "is_said"), [((0.5, 0.7), True), ((0.42, 0.62), False)]
)
def test_confirming_is_recommended_where_it_is_expected_to_help(after, is_said):
    sessions = {"asked": 2, "rehearsed": (0.4, 0.6), "confirmed": after}
    wanted = (
        "(a, b, c and 1 more): expect about 50 to 70 % right after one touch, not 40"
    )
    for split, remount in (
        ("session", "none"),
        ("session", "recentre"),
        ("last", "none"),
    ):
        figures = {"accuracy": (0.5, 0.5), "split": split, "remount": remount}
        promised = wanted
        if split == "session":  # what was measured stands instead
            promised = wanted.split(":")[0] + "."
        assert (promised in advised(**figures, sessions=sessions)) == is_said
    done = {"accuracy": (0.5, 0.5), "remount": "confirm:1", "sessions": sessions}
    assert advised(**done) == ""


def test_one_number_of_touches_has_no_gain():
    figures = figures_of() | {"accuracy": {"1": 0.99}}
    assert recommendations(figures, [trial_of()]) == []
    several = figures_of() | {"accuracy": {"1": 0.2, "3": 0.8, "5": 0.82}}
    assert recommendations(several, [trial_of()]) == []
    several["accuracy"]["5"] = 0.9
    (gain,) = recommendations(several, [trial_of()])
    assert gain.startswith("More touches help: 80 % right after 3, 90 % after 5.")


@pytest.mark.parametrize(
    ("right", "control", "begin"),
    [
        (0.95, 0.1, "Good: 95 % right after 5 touches"),
        (0.949, 0.1, "Fair: 95 %"),
        (0.8, 0.1, "Fair: 80 %"),
        (0.79, 0.1, "Not good yet: 79 %"),
        (0.375, 0.1, "Not better than guessing: 38 %"),
        (0.38, 0.1, "Not good yet: 38 %"),
        (0.9, 0.89, "Fair"),
        (0.9, 0.9, "This does not show"),
        (0.375, 0.5, "Not better than guessing"),
    ],
)
def test_where_good_and_fair_begin_and_a_control_is_as_good(right, control, begin):
    assert verdict(figured(right, control)).startswith(begin)


def test_after_one_touch_the_sentences_are_in_the_singular():
    figures = figured(0.9, 0.1) | {"accuracy": {"1": 0.9}}
    assert verdict(figures).startswith("Fair: 90 % right after 1 touch, where")


@pytest.mark.parametrize("split", ["session", "subject"])
def test_advice_on_mountings_needs_a_split_by_session_or_person(split):
    figures = {"accuracy": (0.5, 0.5), "sessions": {"asked": 0}}
    advice = advised(**figures, split=split)
    assert advice.startswith("Another mounting costs accuracy")
    assert "\n" not in advice
    assert "one session" in advised(**figures)
    # Of several folds all must be elsewhere, not the first alone.
    trial = trial_of()
    trial.fold.elsewhere = True
    assert "one session" in advised(trial, **figures)


def test_objects_with_few_touches_are_named_alike_by_check_learn_and_evaluate():
    assert few_touches({"a": 9, "b": 20, "c": 60}) == (
        "few touches of a (9): 20 are a start, 60 are good"
    )
    assert few_touches({"a": 20}) == ""
    assert few_touches(dict.fromkeys("abcdefg", 3)).startswith(
        "few touches of a (3), b (3), c (3), d (3), e (3) and 2 more: "
    )


def with_strangers(n_named, n_labels=5, expected=0.05):
    """Figures of five objects that are told apart, and strangers' 20 episodes."""
    ends = {"error": 0.05, "strangers": expected, "n_episodes": 20, "refused": 0}
    ends |= {"right": 20, "wrong": 0, "refusal": 0.05}
    more = {"decision": ends, "unknown_decision": ends | {"wrong": n_named}}
    return figures_of((0.9, 0.97), n_labels=n_labels, **more)


def test_strangers_that_were_named_are_said_first_and_what_to_do():
    figures = with_strangers(20)
    (sentence,) = recommendations(figures, [trial_of()])  # and not to touch on
    assert sentence == (
        "In 20 of 20 episodes a stranger was given a name: teach at least 6 things, "
        "not 5; expect more strangers (`strangers=0.2`); accept fewer wrong names "
        "(`error=0.005`). Each makes that rarer, none impossible, and takes more "
        "touches."
    )
    assert verdict(figures) == (
        "Good with known objects alone: 97 % right after 3 touches, where chance is "
        "25 %. Things that were never learnt, in 20 episodes: 20 got a name, 0 were "
        "called unknown, 0 stayed undecided."
    )
    (other_sentence,) = recommendations(with_strangers(2, 6, 0.2), [trial_of()])
    assert "name: accept fewer" in other_sentence


def test_where_no_stranger_ended_as_unknown_more_touches_may_help():
    figures = with_strangers(1)  # as often as was accepted
    assert verdict(figures).startswith("Good: 97 %")
    assert verdict(figures).endswith(
        "in 20 episodes: 1 got a name, 0 were called unknown, 19 stayed undecided."
    )
    none, gain = recommendations(figures, [trial_of()])
    assert none == (
        "None of 20 episodes with strangers ended as unknown. What may help, and is "
        "not measured here: teach at least 6 things, not 5; touch more often; say that "
        "more strangers come (`strangers=0.2`), which needs less evidence for unknown, "
        "also where a known object is touched."
    )
    assert gain.startswith("More touches help")
    figures["unknown_decision"]["refused"] = 3
    assert "0 were" not in verdict(figures)
    (gain,) = recommendations(figures, [trial_of()])
    assert gain.startswith("More touches help")


@pytest.mark.parametrize("split", ["last", "session"])
def test_known_objects_called_unknown_are_said_and_what_to_do(split):
    ends = {"error": 0.01, "strangers": 0.05, "n_episodes": 160, "refused": 160}
    ends |= {"right": 0, "wrong": 0, "refusal": 0.01}
    figures = figures_of((1.0, 1.0), decision=ends, split=split)
    (sentence,) = recommendations(figures, [trial_of()])
    assert sentence.startswith(
        "In 160 of 160 episodes a known object was called unknown"
    )
    assert sentence.endswith("where nothing else can come, say `strangers=0`.")
    assert ("remount=recentre:10" in sentence) == (split == "session")
    assert verdict(figures).endswith(
        "That counts the most probable object, strangers aside. To decide at an error "
        "of 0.01, with 5 % strangers expected: of 160 episodes with known objects 0 "
        "ended with the right name, 0 with a wrong one, 160 as unknown, 0 undecided."
    )
    # As of one day of three; six in a hundred are five more than were accepted.
    figures["decision"] = ends | {"refused": 53}
    assert recommendations(figures, [trial_of()])[0].startswith("In 53 of 160 episodes")
    figures["decision"] = ends | {"refused": 9}
    assert recommendations(figures, [trial_of()]) == []
