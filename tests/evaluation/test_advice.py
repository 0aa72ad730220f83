"""What is recommended after an evaluation, from touches made so that it is true."""

import numpy as np

from palpate import Touches
from palpate.evaluation import Plan, evaluate
from palpate.evaluation._advice import verdict

RNG = np.random.default_rng(0)
BASE = dict(zip("abcd", RNG.normal(size=(4, 3, 24)), strict=True))


def touches(n=24, names="abc", noise=0.5, alike=(), **more):
    """Vectors about a pattern of each object; `alike` share one pattern."""
    objects = np.repeat(list(names), n)
    base = [BASE["a" if name in alike else name] for name in objects]
    rng = np.random.default_rng(1)
    images = np.array(base) + noise * rng.normal(size=(len(base), 3, 24))
    return Touches(images, object=objects, geometry="none", **more)


def said(found, **more):
    plan = Plan(touches=(1, 3), orders=5)
    return evaluate(found, split=more.pop("split", "last"), plan=plan, **more)[0][
        "recommendations"
    ]


def test_no_more_than_three_and_each_a_sentence():
    found = said(touches(6, noise=9))
    assert 1 <= len(found) <= 3
    assert all(one.endswith(".") for one in found)


def test_few_touches_are_named():
    assert any("taught with 5 touches" in one for one in said(touches(6, noise=9)))
    assert not any("was taught with" in one for one in said(touches(24)))


def test_what_is_alike_is_named():
    found = said(touches(names="abcd", alike="ab", noise=1))
    assert any("a taken for b" in one or "b taken for a" in one for one in found)


def test_one_session_is_named_and_two_are_not():
    assert any("one session" in one for one in said(touches()))
    twice = touches(session=np.tile(["mon", "tue"], 36))
    assert not any("one session" in one for one in said(twice))
    assert said(twice, split="session") == []  # all is right: nothing to do


def test_a_recording_that_gives_it_away_is_named():
    """Two objects of noise alone, one of them brighter."""
    rng = np.random.default_rng(1)
    images = rng.normal(size=(48, 3, 24)) + np.repeat([0, 8], 24)[:, None, None]
    recorded = Touches(images, object=np.repeat(["a", "b"], 24), geometry="none")
    assert "no touch" in said(recorded)[0]


def test_more_touches_are_recommended_where_they_help():
    found = said(touches(40, noise=4))
    assert any(one.startswith("More touches help") for one in found)


def figured(right, control, chance=0.25):
    after = {"1": 0.5, "5": right}
    controls = {"brightness": {"1": 0.1, "5": control}, "no contact": {"1": 1, "5": 1}}
    return {"accuracy": after, "controls": controls, "chance": chance}


def test_one_sentence_says_whether_it_is_good_and_why():
    beside = "where chance is 25%, and brightness alone, which is no touch, 40%."
    assert verdict(figured(0.97, 0.4)) == f"Good: 97% right after 5 touches, {beside}"
    assert verdict(figured(0.85, 0.4)).startswith("Fair: 85%")
    assert verdict(figured(0.6, 0.4)).startswith("Not good yet: 60%")
    assert verdict(figured(0.3, 0.4)).startswith("Not better than guessing: 30%")
    as_good = verdict(figured(0.97, 0.98))
    assert as_good.startswith("This does not show that touch works: 97% right")
    assert "brightness alone" in as_good
    assert verdict({**figured(0.9, 0.1), "accuracy": {}}).startswith("Nothing can be")


def test_the_sentence_stands_in_the_figures():
    plan = Plan(touches=(1, 3), orders=5)
    figures, _ = evaluate(touches(), split="last", plan=plan)
    assert figures["verdict"] == verdict(figures)
    assert "3 touches" in figures["verdict"]
