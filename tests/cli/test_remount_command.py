"""`palpate remount`, `palpate sensor learn-nuisance` and what `recognise` says."""

import json
import shutil

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import OTHER_SESSION, ObjectRecogniser

CENTRES = 4 * np.random.default_rng(7).normal(size=(4, 8))
MOVE = np.array([6.0, -5, 4, 0, 7, -3, 5, 4])


def visited(moved, n_each, seed, session):
    rng = np.random.default_rng(seed)
    names = np.repeat(list("abcd"), n_each)
    images = CENTRES[["abcd".index(name) for name in names]] + moved
    images = images + rng.normal(size=images.shape)
    labels = {"object": names, "session": [session] * len(names)}
    return Touches(images[:, None], geometry="none", **labels)


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    path = tmp_path_factory.mktemp("learnt") / "m.palpate"
    return ObjectRecogniser().fit(visited(0, 12, 0, "mon")).save(path)


@pytest.fixture
def files(learnt, tmp_path):
    shutil.copy(learnt, tmp_path)
    visited(MOVE, 6, 1, "tue").save(tmp_path / "tue.npz")
    visited(0, 6, 2, "mon").save(tmp_path / "mon.npz")
    return tmp_path


@pytest.fixture
def remounted(palpate, files):
    """Return what `palpate remount` prints of a file of touches."""

    def remount(touches, *options):
        words = ("remount", files / "m.palpate", files / touches)
        return palpate.printed(*words, "-o", files / "o.palpate", *options)

    return remount


@pytest.mark.parametrize("unlabelled", [True, False])
def test_remount_writes_a_model_for_the_session(remounted, files, unlabelled):
    options = ["--unlabelled"] if unlabelled else []
    answer = json.loads(remounted("tue.npz", "--json", *options))
    assert answer["changed"]
    assert answer["labelled"] != unlabelled
    assert set(answer["confirm"]) == set("abcd")
    tuesday = visited(MOVE, 10, 3, "tue")
    assert ObjectRecogniser.load(files / "o.palpate").score(tuesday) > 0.95
    assert ObjectRecogniser.load(files / "m.palpate").score(tuesday) < 0.9


def test_what_was_not_learnt_is_remounted_without_labels(palpate, files):
    """The refusal names what to type, and a model so made can be extended."""
    tuesday = Touches.load(files / "tue.npz")
    names = np.where(tuesday.object == "d", "new", tuesday.object)
    tuesday.with_columns(object=names).save(files / "new.npz")
    words = "remount", files / "m.palpate", files / "new.npz", "-o"
    refusal = palpate.refusal(*words, files / "o.palpate")
    assert "got 'new', which was not learnt. Say --unlabelled, and add it" in refusal
    palpate.printed(*words, files / "o.palpate", "--unlabelled")
    extended = "learn", files / "new.npz", "--extend", files / "o.palpate", "-o"
    assert palpate.answer(*extended, files / "p.palpate")["n_labels"] == 5


def test_remount_says_that_the_mounting_differs_and_what_to_confirm(remounted, files):
    tuesday = Touches.load(files / "tue.npz")
    few = np.concatenate([np.flatnonzero(tuesday.object == n)[:2] for n in "abcd"])
    tuesday[few].save(files / "few.npz")
    printed = remounted("few.npz")
    assert "show another mounting or light" in printed
    assert "confirm 1 to 5 touches of each" in printed
    assert printed.count(OTHER_SESSION) == 1
    assert printed.rstrip().endswith("o.palpate")


def test_of_objects_with_five_confirmed_touches_no_more_are_asked_for(remounted):
    assert "confirm" not in remounted("tue.npz")


@pytest.fixture
def doubted(files):
    """Let the model trust a quarter of what one confirmed object tells of a session."""
    learnt = ObjectRecogniser.load(files / "m.palpate")
    learnt.chosen_["rehearsal"] = {"share": 0.0, "trust": 0.25}
    learnt.save(files / "m.palpate")


def test_where_each_object_is_confirmed_no_other_is_asked_for(
    remounted, files, doubted
):
    """More touches of each object still help, so the number so far is printed."""
    tuesday = Touches.load(files / "tue.npz")
    tuesday[[0, 6, 12, 18]].save(files / "four.npz")
    unlabelled = remounted("four.npz", "--unlabelled")
    assert "confirm 1 to 5 touches of each" in unlabelled
    printed = remounted("four.npz")
    assert "By their labels" in printed
    assert "of more objects" not in printed
    assert "so far there are 4 of 4 objects" in printed


def test_objects_without_a_confirmed_touch_are_named(remounted, files):
    tuesday = Touches.load(files / "tue.npz")
    tuesday[np.isin(tuesday.object, ["a", "c"])].save(files / "some.npz")
    lines = remounted("some.npz").splitlines()
    (sentence,) = [line for line in lines if "none yet" in line]
    assert set(sentence.rstrip(".").split("none yet: ")[1].split(", ")) == {"b", "d"}


def test_remount_says_that_one_object_is_trusted_in_part(
    palpate, remounted, files, doubted
):
    Touches.load(files / "tue.npz")[:1].save(files / "one.npz")
    printed = remounted("one.npz")
    assert "By their labels, 1 touch tells what" in printed
    assert "tell of the others 25 % is believed, as rehearsed sessions" in printed
    again = palpate.printed("recognise", files / "o.palpate", files / "tue.npz")
    assert "a few touches more, with labels; see palpate remount." in again


def test_recognise_warns_of_another_mounting(palpate, files):
    model = files / "m.palpate"
    warned = palpate.printed("recognise", model, files / "tue.npz")
    assert "see palpate remount" in warned
    assert OTHER_SESSION in warned
    calm = palpate.printed("recognise", model, files / "mon.npz")
    assert "palpate remount" not in calm
    answer = palpate.answer("recognise", model, files / "tue.npz")
    assert answer["mounting"]["changed"]
    assert all(OTHER_SESSION in episode["why"] for episode in answer["episodes"])


def test_nuisance_is_learnt_from_other_objects(palpate, files):
    days = [visited(k * MOVE / 4, 2, 10 + k, f"day {k}") for k in range(6)]
    renamed = Touches.concatenate(days)
    names = np.char.add("other ", renamed.object)
    renamed.with_columns(object=names).save(files / "others.npz")
    learn = ("sensor", "learn-nuisance", files / "m.palpate", "-o", files / "n.palpate")
    assert palpate.answer(*learn, files / "others.npz")["n_differences"] == 24
    few = palpate.refusal(*learn, files / "tue.npz")
    assert "at least 20 things in several sessions" in few


def test_learn_and_evaluate_say_what_to_expect_of_another_day(palpate, files):
    both = files / "both.npz"
    days = [visited(0, 6, 0, "mon"), visited(MOVE, 6, 1, "tue")]
    Touches.concatenate(days).save(both)
    learnt = palpate.printed("learn", both, "-o", files / "two.palpate")
    assert "Taught in 2 sessions an object: expect" in learnt
    monday = palpate.printed("learn", files / "mon.npz", "-o", files / "one.palpate")
    assert "Taught in 1 session an object, and none in two" in monday
    split = ["--split", "session", "--touches", "1", "--remount", "recentre"]
    assert palpate.answer("evaluate", "--train", both, *split)["remount"] == "recentre"
