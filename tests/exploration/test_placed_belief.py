"""A belief with places shares flags, prior, costs and reasons with the plain one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration import TouchMap


@pytest.fixture(scope="module")
def touch_map(recogniser, taught):
    return TouchMap(n_turns=4).fit(recogniser, taught)


@pytest.fixture(scope="module")
def nothing(taught):
    """The sensor touching nothing, from above."""
    image = np.asarray(taught.no_contact)[np.newaxis]
    return Touches(image, direction=[[0.0, 0.0, -1.0]], geometry="dome")


def _of(taught, name, n_touches):
    return taught[np.flatnonzero(taught.object == name)[:n_touches]]


def test_a_touch_of_nothing_is_flagged_and_moves_nothing(touch_map, taught, nothing):
    box = _of(taught, "box", 2)
    belief, without = touch_map.start().update(box), touch_map.start().update(box)
    belief.update(nothing)
    assert belief.flags[-1] == "no contact"
    plain = touch_map.recogniser.start().update(box)
    assert belief.flags[:-1] == plain.flags
    assert_allclose(belief.log_joint, without.log_joint, atol=1e-12)
    assert belief.touches_used == 3
    # The next touch is worth no less after a touch of nothing.
    assert_allclose(
        belief.update(box).log_joint, without.update(box).log_joint, atol=1e-12
    )


def test_touches_count_as_in_the_plain_belief(touch_map, taught):
    evidence = _of(taught, "pen", 5)
    placed, plain = touch_map.start().update(evidence), touch_map.recogniser.start()
    plain.update(evidence)
    assert placed.promise(0.1) == plain.promise(0.1)
    assert placed.flags == plain.flags
    # Touches are floored one by one, and together: the same but for rounding.
    for placed_touch, plain_touch in zip(
        placed.explain(2, 1), plain.explain(2, 1), strict=True
    ):
        assert placed_touch.pop("nats") == pytest.approx(plain_touch.pop("nats"))
        assert placed_touch == plain_touch


def test_a_belief_starts_at_its_prior(touch_map, taught):
    prior = {"box": 0.2, "mug": 0.5, "pen": 0.3}
    belief = touch_map.start(prior, strangers=0)
    assert belief.posterior == pytest.approx(prior)
    evidence = _of(taught, "pen", 3)
    evenly = touch_map.start(strangers=0).update(evidence)
    weighed = belief.update(evidence)
    odds = {name: np.log(weighed.posterior[name] / prior[name]) for name in prior}
    even = {name: np.log(evenly.posterior[name]) for name in prior}
    # Bayes: the prior's odds and the evidence's add up, whatever the touches say.
    assert odds["pen"] - odds["mug"] == pytest.approx(even["pen"] - even["mug"])
    with pytest.raises(ValueError, match="prior must name every object"):
        touch_map.start({"box": 1.0})


def test_costs_decide_as_worked_out_by_hand(touch_map, monkeypatch):
    belief = touch_map.start(strangers=0)
    belief.log_joint = np.log(np.outer([0.1, 0.6, 0.3], np.full(4, 0.25)))
    monkeypatch.setattr(type(belief), "touches_used", 1)
    assert belief.decide(0.45) == "mug"
    assert belief.decide(0.35) is None
    # Naming the mug costs 0.1 x 1 + 0.3 x 5, the pen 0.1 x 1 + 0.6 x 0.2, the box
    # 0.6 + 0.3.
    costs = {"pen": {"mug": 5}, "mug": {"pen": 0.2}}
    assert belief.decide(0.23, costs) == "pen"
    assert belief.decide(0.21, costs) is None
    with pytest.raises(ValueError, match="costs must be one of 'box', 'mug', 'pen'"):
        belief.decide(0.1, {"ball": {"box": 1}})
    with pytest.raises(ValueError, match="costs must be finite and between 0"):
        belief.decide(0.1, {"pen": {"box": -1}})


def test_an_image_alone_is_refused(touch_map, taught):
    with pytest.raises(TypeError, match=r"got ndarray. Write Touches\(images, direc"):
        touch_map.start().update(taught.images[0])


@pytest.mark.parametrize("length", [0.0, 0.98, 1.02, 2.0])
def test_a_direction_that_is_none_is_refused(touch_map, taught, length):
    touch = Touches(taught.images[:1], direction=[[0, 0, -length]], geometry="dome")
    belief = touch_map.start()
    message = rf"unit vectors of approach, got \[0.0, 0.0, -{length}\] in touch 0"
    with pytest.raises(ValueError, match=message):
        belief.update(touch)
    assert belief.touches_used == 0
