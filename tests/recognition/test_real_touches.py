"""The main job on real touches: figures that must not be lost again."""

import numpy as np
import pytest

from palpate import Touches
from palpate.evaluation import Plan, evaluate

pytestmark = pytest.mark.realdata
PLAN = Plan(touches=(1, 5, 15), orders=10)


@pytest.fixture(scope="module")
def ten_objects(data_folder):
    """The second object of every category, about 70 touches each."""
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    names = [
        np.unique(touches.object[touches.category == category])[1]
        for category in np.unique(touches.category)
    ]
    return touches[np.isin(touches.object, names)]


@pytest.mark.slow
@pytest.mark.parametrize(("split", "least"), [("between", 0.79), ("last", 0.70)])
def test_ten_objects_are_recognised_better_than_by_brightness(
    ten_objects, split, least
):
    figures, _ = evaluate(ten_objects, split=split, plan=PLAN)
    assert figures["accuracy"]["5"] > least
    assert figures["accuracy"]["5"] > figures["controls"]["brightness"]["5"]
    assert figures["ece"]["1"] < 0.15
    assert "rim" in figures["chosen"]["encoding"]


@pytest.mark.slow
def test_three_objects_of_few_touches_are_recognised_better_than_by_brightness(
    ten_objects,
):
    three_objects = ten_objects[
        np.isin(ten_objects.object, np.unique(ten_objects.object)[:3])
    ]
    plan = Plan(touches=(1, 5), orders=5)
    figures, _ = evaluate(three_objects[::2], split="last", plan=plan)
    # After one touch, for of three objects brightness is often right after five.
    assert figures["accuracy"]["1"] > figures["controls"]["brightness"]["1"]
    assert "rim" in figures["chosen"]["encoding"]


@pytest.mark.slow
def test_the_preset_of_the_paper_is_as_accurate_as_is_known_of_it(ten_objects):
    plan = Plan(preset="corradi2015", touches=(1, 5, 15), orders=10)
    figures, trials = evaluate(ten_objects, split="between", plan=plan)
    # About 69 % after 5 touches is known of such sets; objects differ much.
    assert 0.5 < figures["accuracy"]["5"] < 0.9
    # 16 to 22 components hold 95 % of the variance of real touches.
    assert 14 <= trials[0].recogniser.memory_.features.shape[1] <= 24


@pytest.mark.slow
def test_pins_are_recognised_without_a_rim(data_folder):
    """Touches of a TacTip do not say what kind of sensor it is."""
    pins = Touches.load(data_folder / "tactip4" / "tactip4.npz")
    figures, _ = evaluate(pins[::4], split="between", plan=Plan(touches=(1,)))
    assert figures["accuracy"]["1"] > 0.9
