"""Maps of touches and the next touch, on objects made up so that the answer is known.

Two objects are the same all over but for one side: `plain` shows there what it
shows elsewhere, `marked` another pattern. Both have a landmark, a quarter turn from
that side, by which one can tell how they are turned.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp

from palpate import Touches
from palpate.exploration import Hemisphere, InformativeTouch, TouchMap, TouchRecord
from palpate.recognition import ObjectRecogniser, SequenceCalibration
from recorded_choice import (
    InformativeRecorded,
    RandomRecorded,
    RasterRecorded,
    look_at_recorded,
)

# What is left to be had a width away from where it was touched.
ONE_WIDTH = 1 - np.exp(-0.5)
N_TURNS = 12
STEP = 2 * np.pi / N_TURNS
PATTERNS = np.random.default_rng(42).normal(size=(3, 3, 3))
ELSEWHERE, MARK, LANDMARK = range(3)


def _out(azimuth, elevation=0.3):
    flat = np.cos(elevation) * np.ones_like(azimuth)
    height = np.sin(elevation) * np.ones_like(azimuth)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=-1)


def _images(name, azimuth, rng):
    """Images at azimuths of an object that is not turned."""
    away = np.abs((azimuth + np.pi) % (2 * np.pi) - np.pi)
    pattern = np.where((away < 0.4) & (name == "marked"), MARK, ELSEWHERE)
    quarter = np.abs((azimuth - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi)
    pattern = np.where(quarter < 0.4, LANDMARK, pattern)
    return PATTERNS[pattern] + 0.1 * rng.normal(size=(len(azimuth), 3, 3))


def _touches(seed=0, n_touches=120):
    rng = np.random.default_rng(seed)
    images, names, directions = [], [], []
    for name in ("marked", "plain"):
        azimuth = rng.uniform(-np.pi, np.pi, n_touches)
        images.append(_images(name, azimuth, rng))
        directions.append(-_out(azimuth, rng.uniform(0, 0.8, n_touches)))
        names += [name] * n_touches
    return Touches(
        np.concatenate(images),
        object=names,
        direction=np.concatenate(directions),
        geometry="none",
    )


@pytest.fixture(scope="module")
def touches():
    return _touches()


@pytest.fixture(scope="module")
def recogniser(touches):
    return ObjectRecogniser().fit(touches)


@pytest.fixture(scope="module")
def touch_map(recogniser, touches):
    return TouchMap(n_turns=N_TURNS).fit(recogniser, touches)


@pytest.fixture(scope="module")
def strategy(touch_map):
    return InformativeTouch(touch_map, Hemisphere(lowest_rad=0.05), n_rings=3)


def _touch_at(name, azimuth, turn=0.0, seed=1):
    """A touch at an azimuth of the world on an object turned by an angle."""
    rng = np.random.default_rng(seed)
    at = np.array([azimuth])
    return Touches(_images(name, at - turn, rng), direction=-_out(at), geometry="none")


def _record(touch):
    start = Hemisphere().pose_towards(-touch.columns["direction"][0])
    return TouchRecord("touched", start, (0.0, 0.0, 0.0), image=touch.images[0])


def _azimuth(pose):
    x, y, _ = -np.asarray(pose.direction)
    return np.arctan2(y, x)


def test_a_place_tells_its_own_pattern_from_others(touch_map, recogniser):
    code = list(recogniser.classes_).index("marked")
    mark = _touch_at("marked", 0.0)
    features = recogniser.encoder_.transform(mark)
    at_mark = touch_map.placed_ratio(features, _out(np.array([0.0])))[0, code, 0]
    at_back = touch_map.placed_ratio(features, _out(np.array([np.pi])))[0, code, 0]
    # 0.8 of 2 pi, an eighth of the touches, show the mark: at its place the density
    # is up to 8 times that of anywhere (log 8 = 2.1), at the back far below it.
    assert 1.0 < at_mark < 2.1
    assert at_back < -2


def test_a_landmark_tells_the_turn_but_not_the_object(touch_map):
    turn = 5 * STEP
    belief = touch_map.start().update(_touch_at("plain", np.pi / 2 + turn, turn))
    for log_turns in belief.log_joint:
        assert abs(int(log_turns.argmax()) - 5) <= 1
    assert belief.doubt > 0.3


def test_a_belief_without_weight_on_places_is_the_plain_one(
    recogniser, touches, monkeypatch
):
    single = TouchMap(n_turns=1).fit(recogniser, touches)
    single.touch_weight_, single.placed_weight_ = 1.0, 0.0
    single.correlation_ = 0.25
    evidence = Touches.concatenate(
        [_touch_at("marked", a, seed=7) for a in (0.1, 0.2, 2.0)]
    )
    calibration = SequenceCalibration(1.0, 0.25)
    monkeypatch.setattr(recogniser, "sequence_calibration_", calibration)
    plain = recogniser.start().update(evidence).posterior
    belief = single.start().update(evidence)
    assert belief.posterior == pytest.approx(plain, abs=1e-12)


def test_touches_one_by_one_or_at_once(touch_map):
    evidence = [_touch_at("marked", a, seed=7) for a in (0.1, 1.2, 2.0)]
    one_by_one = touch_map.start()
    for touch in evidence:
        one_by_one.update(touch)
    at_once = touch_map.start().update(Touches.concatenate(evidence))
    assert_allclose(at_once.log_joint, one_by_one.log_joint, atol=1e-9)
    assert at_once.touches_used == one_by_one.touches_used == 3


def test_the_belief_decides(touch_map):
    belief = touch_map.start()
    assert belief.log_joint.shape == (touch_map.n_objects, touch_map.n_turns)
    assert belief.decide() is None
    belief.update(_touch_at("marked", 0.0))
    assert belief.best == "marked"
    assert sum(belief.posterior.values()) + belief.unknown == pytest.approx(1)
    for seed in range(20):
        belief.update(_touch_at("marked", [0.0, np.pi / 2][seed % 2], seed=seed))
    assert belief.decide(0.2) == "marked"


def test_before_any_touch_all_turns_are_alike(strategy):
    gain = strategy.expected_gain(None, [])
    rings = gain.reshape(3, N_TURNS)
    assert_allclose(rings, np.repeat(rings[:, :1], N_TURNS, axis=1), rtol=1e-4)
    assert (gain > 0).all()


def test_gain_is_the_mutual_information_worked_out_slowly(touch_map, strategy):
    belief = (
        touch_map.start()
        .update(_touch_at("marked", 1.6))
        .update(_touch_at("marked", 0.5))
    )
    gain = strategy.expected_gain(belief, [])
    places = strategy._candidates
    nearness, allowed = touch_map.left_out()
    closeness = touch_map.closeness(places)
    ratio = touch_map.station_ratio(nearness, allowed, closeness)
    log_belief = logsumexp(belief.log_joint, axis=1)
    for candidate in (0, 7, 20):
        stations = [
            int(np.argmin(((places - turned) ** 2).sum(axis=1)))
            for turned in _turned_back(places[candidate])
        ]
        total = 0.0
        for touch, code in enumerate(touch_map.codes_):
            chance = np.exp(belief.log_joint[code]) @ closeness[stations, touch]
            evidence = touch_map.weighed(
                touch_map.left_out_[touch], ratio[stations, :, touch].T
            )
            after = (
                belief.log_joint + touch_map.sequence_calibration.weight(3) * evidence
            )
            after = logsumexp(after, axis=1) - logsumexp(after)
            total += chance * (after[code] - log_belief[code])
        # The strategy computes in single precision.
        assert gain[candidate] == pytest.approx(total, rel=1e-4, abs=1e-6)


def _turned_back(place):
    for turn in np.arange(N_TURNS) * STEP:
        cos, sin = np.cos(turn), np.sin(turn)
        yield np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) @ place


@pytest.mark.parametrize("turn_steps", [0, 5, 8])
def test_knowing_the_turn_it_goes_to_the_side_that_differs(strategy, turn_steps):
    turn = turn_steps * STEP
    belief, history = strategy.touch_map.start(), []
    for seed in range(3):
        touch = _touch_at("plain", np.pi / 2 + turn, turn, seed=seed)
        belief.update(touch)
        history.append(_record(touch))
    pose = strategy.next_pose(belief, history)
    away = (_azimuth(pose) - turn + np.pi) % (2 * np.pi) - np.pi
    # The mark is 0.4 rad to either side, and candidates are 0.52 rad apart.
    assert abs(away) < 0.4


def test_a_plain_belief_is_helped_by_the_attempts(strategy, recogniser):
    turn = 5 * STEP
    history = [
        _record(_touch_at("plain", np.pi / 2 + turn, turn, seed=seed))
        for seed in range(3)
    ]
    belief = recogniser.start()
    for record in history:
        belief.update(record.image)
    away = _azimuth(strategy.next_pose(belief, history)) - turn
    assert abs((away + np.pi) % (2 * np.pi) - np.pi) < 0.4
    # For another episode the strategy forgets this one.
    assert_allclose(
        strategy.expected_gain(recogniser.start(), []), strategy.expected_gain(None, [])
    )


@pytest.mark.slow
def test_chosen_touches_need_fewer_than_random_ones(touch_map, strategy):
    def n_needed(choose, seed):
        rng = np.random.default_rng(seed)
        name, turn = ["marked", "plain"][seed % 2], rng.uniform(0, 2 * np.pi)
        belief, history = touch_map.start(), []
        while belief.posterior[name] < 0.95 and len(history) < 40:
            azimuth = choose(belief, history, rng)
            touch = _touch_at(name, azimuth, turn, seed=rng.integers(1000))
            belief.update(touch)
            history.append(_record(touch))
        return len(history)

    def random(belief, history, rng):
        return rng.uniform(0, 2 * np.pi)

    def chosen(belief, history, rng):
        return _azimuth(strategy.next_pose(belief, history))

    numbers = {f: [n_needed(f, seed) for seed in range(16)] for f in (random, chosen)}
    # An eighth of random touches meet the mark's side; chosen ones look for the
    # landmark, then for it. The medians are 16.5 and 10 for these seeds.
    assert np.median(numbers[chosen]) <= 0.6 * np.median(numbers[random])


def test_a_place_already_tried_is_not_chosen_again(strategy):
    pose = strategy.next_pose(None, [])
    nothing = TouchRecord("nothing", pose, (0.0, 0.0, 0.0))
    again = strategy.next_pose(None, [nothing])
    distance = np.linalg.norm(np.asarray(pose.direction) - np.asarray(again.direction))
    assert distance > strategy.touch_map.width_


@pytest.mark.parametrize(
    ("gain", "fresh", "best"),
    [
        pytest.param([0.2, 0.5], [1, 1], 1, id="the larger gain"),
        pytest.param([0.2, 0.5], [1, 0.1], 0, id="unless it is stale"),
        pytest.param([0.2, -0.5], [0.1, 1], 0, id="never what misleads"),
        pytest.param([0.2, -0.5], [0.001, 1], 1, id="when nothing is left, the new"),
        pytest.param([0.2001, 0.2 * ONE_WIDTH], [ONE_WIDTH, 1], 0, id="just as much"),
        pytest.param([0.1999, 0.2 * ONE_WIDTH], [ONE_WIDTH, 1], 1, id="a little less"),
    ],
)
def test_the_promise_of_a_place(height_map, monkeypatch, gain, fresh, best):
    """Two places lie beside a touched one, as far away as they are fresh.

    At a distance of d the share 1 - exp(-d^2 / (2 width^2)) is still to be had.
    """
    widths = np.sqrt(-2 * np.log1p(-np.minimum(fresh, 1 - 1e-12)))
    places = np.zeros((3, 2))
    places[1:, 1] = height_map.width_ * widths
    chooser = InformativeRecorded(height_map, places)
    gains = np.array([9.0, *gain])
    monkeypatch.setattr(chooser, "expected_gain", lambda belief: gains)
    assert chooser.next_touch(None, [0]) == 1 + best


def test_being_sure_leaves_nothing_to_learn(touch_map, strategy):
    belief = touch_map.start()
    log_joint = np.full((2, N_TURNS), -60.0)
    log_joint[0, 3] = 0.0
    belief.log_joint = log_joint - logsumexp(log_joint)
    assert_allclose(strategy.expected_gain(belief, []), 0, atol=1e-5)


def test_objects_of_alike_touches_promise_next_to_nothing():
    rng = np.random.default_rng(3)
    azimuth = rng.uniform(-np.pi, np.pi, 160)
    alike = Touches(
        _images("plain", azimuth, rng),
        object=np.repeat(["one", "other"], 80),
        direction=-_out(azimuth),
        geometry="none",
    )
    touch_map = TouchMap(n_turns=N_TURNS).fit(ObjectRecogniser().fit(alike), alike)
    gain = InformativeTouch(touch_map, n_rings=2).expected_gain(None, [])
    # A sure answer between two would be worth log 2 = 0.69.
    assert np.abs(gain).max() < 0.1


def test_the_repr_of_a_strategy_names_hemisphere_and_speed(strategy):
    assert repr(strategy).startswith("InformativeTouch(hemisphere=Hemisphere(")
    slower = InformativeTouch(strategy.touch_map, strategy.hemisphere, speed_mm_s=50.0)
    faster = InformativeTouch(strategy.touch_map, strategy.hemisphere, speed_mm_s=99.0)
    assert repr(slower) != repr(faster)


# Recorded touches: heights and radii, nothing turns.


@pytest.fixture(scope="module")
def recorded():
    """Two objects that differ above a height of 1 alone; training and test touches."""

    def drawn(seed):
        rng = np.random.default_rng(seed)
        places = np.column_stack([rng.uniform(-2, 2, 120), rng.uniform(0, 1, 120)])
        names = np.repeat(["cone", "post"], 60)
        pattern = np.where((places[:, 0] > 1) & (names == "cone"), MARK, ELSEWHERE)
        images = PATTERNS[pattern] + 0.3 * rng.normal(size=(120, 3, 3))
        return Touches(images, object=names, geometry="none"), places

    return drawn(0), drawn(1)


@pytest.fixture(scope="module")
def height_map(recorded):
    touches, places = recorded[0]
    return TouchMap(n_turns=1).fit(ObjectRecogniser().fit(touches), touches, places)


def test_recorded_touches_are_taken_where_objects_differ(height_map, recorded):
    touches, places = recorded[1]
    chooser = InformativeRecorded(height_map, places[:60])
    order, by_touch, by_place = look_at_recorded(
        height_map, touches[:60], places[:60], chooser, 6
    )
    assert len(set(order)) == 6
    assert (places[order[:3], 0] > 0.8).all()
    assert by_touch[-1] == by_place[-1] == "cone"


def test_every_order_has_each_touch_once(height_map, recorded):
    touches, places = recorded[1]
    for chooser in (RandomRecorded(60, 1), RasterRecorded(places[:60])):
        order, *_ = look_at_recorded(height_map, touches[:60], places[:60], chooser)
        assert sorted(order) == list(range(60))
    assert (np.diff(np.round(places[order, 0] / 0.2)) >= 0).all()


# Refusals.


def test_other_touches_are_refused(recogniser, touches):
    with pytest.raises(ValueError, match="must be those that the recogniser learnt"):
        TouchMap().fit(recogniser, touches[10:])


def test_touches_without_places_are_refused(recogniser, touches):
    bare = touches.without("direction")
    with pytest.raises(ValueError, match="must have a column 'direction'"):
        TouchMap().fit(recogniser, bare)
    with pytest.raises(ValueError, match="places must be x, y, z to be turned, got 2"):
        TouchMap().fit(recogniser, bare, np.zeros((len(bare), 2)))
    with pytest.raises(ValueError, match="places must be finite"):
        TouchMap().fit(recogniser, bare, np.full((len(bare), 3), np.nan))


def test_places_that_are_no_directions_are_refused(height_map):
    with pytest.raises(ValueError, match="places of x, y, z, got 2 numbers each"):
        InformativeTouch(height_map)


def test_recorded_places_do_not_turn(touch_map):
    with pytest.raises(ValueError, match="must have n_turns=1, got 12"):
        InformativeRecorded(touch_map, np.zeros((3, 3)))


def test_stations_are_places_of_their_own(height_map):
    places = np.array([[1.5, 0.5], [-1.5, 0.5]])
    belief = height_map.start()
    assert_allclose(np.exp(belief.log_posterior), 0.5)
    above, below = InformativeRecorded(height_map, places).expected_gain(belief)
    assert above > 0.3
    assert below < 0.05
