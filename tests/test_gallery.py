"""What the gallery says of its pictures holds for the numbers that are drawn."""

import runpy
from pathlib import Path

import numpy as np
import pytest

plt = pytest.importorskip("matplotlib.pyplot", reason='pip install "palpate[plot]"')
pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs a program of the gallery; gives its names."""
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    yield lambda name: runpy.run_path(str(EXAMPLES / f"plot_{name}.py"))
    plt.close("all")


def test_the_bar_stays_unknown_and_the_disc_is_taken_for_a_hexagon(run):
    names = run("03_unknown")
    strangers, curves = {*names["strangers"]}, names["curves"]
    known = [curve for name, curve in curves.items() if name not in strangers]
    assert all(curve[-1] <= curve[0] + 0.01 for curve in known)  # falls
    assert min(curves["bar35"]) > 0.5 > max(curve[-1] for curve in known)
    assert max(curves["disc13"]) < 0.2
    assert names["decisions"]["disc13"] == "hexagon13"


def test_those_blind_to_turns_are_right_more_often_but_for_hu(run):
    names = run("04_encodings")
    right = {name: values.mean() for name, values in names["right"].items()}
    blind = {"ring-quantiles", "zernike", "centroid-moments"}
    others = [right[name] for name in {*right} - blind - {"hu"}]
    assert min(right[name] for name in blind) > max(others)
    assert right["hu"] < min(right[name] for name in blind)


def test_those_blind_to_turns_move_at_most_a_quarter(run):
    drawn = {
        line.get_label(): line.get_ydata() for line in run("05_turns")["axes"].lines
    }
    for name in ("ring-quantiles", "zernike", "centroid-moments"):
        assert max(drawn[name]) < 26
    for name in ("taxels", "grid-levels"):
        assert max(drawn[name]) > 90


def test_a_smaller_error_costs_touches_and_leaves_some_undecided(run):
    names = run("07_error")
    touches = names["used"] / names["outcome"].sum(axis=1)
    assert (np.diff(touches) > 0).all()
    undecided = names["outcome"][:, 2]
    assert undecided[-1] > undecided[0]


def test_remounting_helps_with_labels_and_without(run):
    right = run("12_remount")["right"]
    assert right["as it is"] < right["20 touches, no labels"]
    assert right["20 touches, no labels"] < right["1 confirmed each"]


def test_touch_is_below_all_three_controls(run):
    curves = run("14_controls")["curves"]
    for name in ("disc centre", "brightness", "sorted pixels"):
        assert all(curves[name][k] > curves["touch"][k] for k in curves["touch"])


def test_more_days_are_worth_more(run):
    right = run("15_two_days")["right"]
    assert right["1 x 24"] < right["2 x 12"] < right["3 x 8"]


def test_each_pad_alone_sees_half(run):
    alone, both = [], run("16_pads")["right"]
    alone = [value for name, value in both.items() if name != "both"]
    assert all(40 < np.mean(value) < 60 for value in alone)
    assert np.mean(both["both"]) > 95


def test_more_training_touches_help_much_then_little(run):
    for curve in run("21_learning_curve")["curves"].values():
        assert (np.diff(curve) > 0).all()
        assert curve[1] - curve[0] > curve[3] - curve[2]


def test_two_senses_are_better_than_each(run):
    names = run("23_sight")
    sure = {
        what: belief.posterior["hexagon13-hole8"]
        for what, belief in names["beliefs"].items()
    }
    assert sure["both"] > max(sure["touch"], sure["sight"])
