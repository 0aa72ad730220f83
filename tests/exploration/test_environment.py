"""The Gymnasium environment: Gymnasium's own checker, and what its rewards mean."""

import importlib
import sys
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.exploration import Guard, Raster, SurfaceMap, explore_to_learn
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, find_object

gymnasium = pytest.importorskip("gymnasium")
NAME = "palpate.exploration.environment:palpate/Touch-v0"
CAMERA = DomeCamera(image_shape=(32, 32), n_nodes=20)
OBJECTS = ["ball", "box", "mug"]


def _small(name=NAME, **options):
    options = {"camera": CAMERA, "max_touches": 4, **options}
    return gymnasium.make(name, objects=OBJECTS, **options)


@pytest.fixture
def env():
    environment = _small()
    yield environment
    environment.close()


def _act(out, logits):
    return {
        "action": np.asarray(out, np.float32),
        "prediction": np.asarray(logits, np.float32),
    }


@pytest.mark.parametrize("mode", [None, "rgb_array"])
def test_gymnasium_has_nothing_but_a_wish_for_a_normal_range(mode):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(_small(render_mode=mode).unwrapped)
    # Logits are in -20 to 20; the flat form has them in -1 to 1.
    assert all("normalized space" in str(warning.message) for warning in caught)


def test_the_flat_form_is_the_same_episode_in_vectors(env):
    flat = _small("palpate/TouchFlat-v0")
    assert flat.action_space == gymnasium.spaces.Box(-1, 1, (6,))
    vector, _ = flat.reset(seed=4)
    whole, _ = env.reset(seed=4)
    assert vector.shape == flat.observation_space.shape == (32 * 32 + 3 + 1 + 1,)
    for _ in range(2):
        vector, reward, *_ = flat.step(np.float32([0.3, 0, 1, 0.1, -0.05, 0]))
        whole, expected, *_ = env.step(_act([0.3, 0, 1], [2, -1, 0]))
        assert reward == pytest.approx(expected, rel=1e-6)  # logits as float32
        image, numbers = vector[: 32 * 32], vector[32 * 32 :]
        assert_allclose(image * 255, whole["image"].ravel(), rtol=1e-6)
        assert_array_equal(numbers[:3], whole["place"])
        assert_array_equal(numbers[3:], [whole["touched"][0], whole["touches_left"][0]])
    with pytest.raises(ValueError, match=r"a vector of \(6,\), got \(3,\)"):
        flat.env.step(np.zeros(3))


def test_what_is_rendered_is_the_last_frame():
    env = _small(render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded, match="Call reset first"):
        env.unwrapped.render()
    env.reset(seed=1)
    assert_array_equal(env.render()[..., 0], CAMERA.no_contact())
    observation, *_ = env.step(_act([0, 0, 1], [0, 0, 0]))
    assert_array_equal(env.render(), np.repeat(observation["image"], 3, axis=2))
    with pytest.raises(ValueError, match=r"render_mode must be .*rgb_array"):
        type(env.unwrapped)(render_mode="ansi")


def test_the_reward_is_the_log_probability_of_the_truth(env):
    env.reset(seed=1, options={"object": "box"})
    _, reward, _, _, info = env.step(_act([0, 0, 1], np.log([0.2, 0.7, 0.1])))
    assert reward == pytest.approx(np.log(0.7), abs=1e-6)
    assert info["prediction"]["target"] == 1
    assert info["prediction"]["loss"] == -reward
    assert info["base_reward"] == 0


def test_predictions_never_move_the_world(env):
    images = []
    for logits in ([0, 0, 0], [9, -9, 4]):
        env.reset(seed=3)
        for out in ([0.5, 0, 1], [0, 1, 0.2]):
            observation, *_ = env.step(_act(out, logits))
            images.append(observation["image"])
    assert_array_equal(images[:2], images[2:])


def test_an_episode_ends_with_its_budget(env):
    observation, _ = env.reset(seed=0, options={"object": "ball"})
    assert_array_equal(observation["image"][..., 0], CAMERA.no_contact())
    assert observation["touched"] == 0
    for left in (0.75, 0.5, 0.25, 0.0):
        observation, _, ended, truncated, info = env.step(_act([0, 0, 1], [0, 0, 0]))
        assert observation["touches_left"] == pytest.approx(left)
        assert info["outcome"] == "touched"
        assert observation["touched"] == 1
        assert not ended
    assert truncated


def test_place_is_where_the_ball_is(env):
    env.reset(seed=0, options={"object": "ball"})
    observation, *_ = env.step(_act([0.3, 0.4, 0.5], [0, 0, 0]))
    distance = np.linalg.norm(observation["place"]) * 300
    # The ball has a radius of 36 mm, stands a few mm aside, and is pressed into the
    # dome by some 7 mm.
    assert distance == pytest.approx(36 - 7, abs=6)
    direction = observation["place"] / np.linalg.norm(observation["place"])
    assert_allclose(direction, np.array([3, 4, 5]) / np.sqrt(50), atol=1e-5)


@pytest.mark.parametrize(
    ("out", "like"), [([0, 0, 0], [0, 0, 1]), ([0.6, 0, -0.8], [0.6, 0, 0.8])]
)
def test_every_action_is_a_touch_from_above(env, out, like):
    env.reset(seed=5)
    first, *_ = env.step(_act(out, [0, 0, 0]))
    env.reset(seed=5)
    second, *_ = env.step(_act(like, [0, 0, 0]))
    assert_array_equal(first["image"], second["image"])


def test_strategies_can_play(env):
    env.reset(seed=2, options={"object": "mug", "yaw_rad": 1.0})
    inner = env.unwrapped
    strategy = Raster(inner.hemisphere, 1, 4)
    for _ in range(4):
        pose = strategy.next_pose(None, inner.history)
        env.step(_act(-pose.direction, [0, 0, 0]))
    for number, record in enumerate(inner.history):
        expected = strategy.next_pose(None, inner.history[:number]).direction
        assert_allclose(record.direction, expected, atol=1e-6)


def test_with_a_guard_touches_are_made_step_by_step():
    records = []
    for guard in (None, Guard(lag_readings=0)):
        env = _small(guard=guard)
        env.reset(seed=0)
        env.step(_act([1, -1, 1], [0, 0, 0]))
        records.append(env.unwrapped.history[0])
    at_once, stepped = records
    assert at_once.duration_s == 0 < stepped.duration_s
    # The last step is of a quarter of a millimetre; readings are noisy by 0.005 N,
    # and between solved forces the bench interpolates.
    assert -0.1 <= stepped.travel_mm - at_once.travel_mm < 0.35


@pytest.fixture(scope="module")
def surface_map():
    things = [find_object(name) for name in OBJECTS]
    options = {"n_sessions": 1, "placement_sd_mm": 0, "guarded": False}
    touches = explore_to_learn(things, 12, CAMERA, **options)
    # Of which nobody knows in how many recordings they were made.
    touches = touches.without("session", "no_contact")
    return SurfaceMap(n_turns=8).fit(ObjectRecogniser().fit(touches), touches)


BELIEF = "palpate.exploration.environment:palpate/TouchBelief-v0"


def _places_alone(surface_map, **options):
    options = {"camera": CAMERA, "max_touches": 4, **options}
    return gymnasium.make(BELIEF, surface_map=surface_map, **options)


def test_the_gains_add_up_to_what_is_believed_of_the_truth(surface_map):
    env = _places_alone(surface_map, attempt_nats=0.25, error=0.001)
    observation, _ = env.reset(seed=1, options={"object": "mug"})
    names = [*surface_map.recogniser.classes_, "unknown"]
    assert names == ["ball", "box", "mug", "unknown"]
    # A stranger comes in one of twenty, and none of three objects is likelier.
    assert_allclose(observation["belief"], [0.95 / 3] * 3 + [0.05], rtol=1e-6)
    assert not observation["attempts"].any()
    total = 0.0
    for number, out in enumerate(([1, 0, 1], [0, 1, 1]), start=1):
        observation, reward, *_, info = env.step(np.float32(out))
        total += reward
        assert observation in env.observation_space
        assert observation["touches_left"] == 1 - number / 4
    after = max(float(observation["belief"][2]), np.exp(-5))
    assert total == pytest.approx(np.log(after / (0.95 / 3)) - 2 * 0.25, abs=1e-5)
    rows = observation["attempts"].reshape(4, 4)
    assert_allclose(rows[:2, :3], np.array([[1, 0, 1], [0, 1, 1]]) / np.sqrt(2), 1e-6)
    assert not rows[2:].any()
    assert info["outcome"] == "touched"


def test_an_episode_ends_where_the_belief_decides(surface_map):
    env = _places_alone(surface_map, error=0.2, max_touches=12)
    env.reset(seed=3, options={"object": "ball"})
    ended = False
    for number in range(12):
        angle = 2.4 * number
        action = np.float32([np.cos(angle), np.sin(angle), 0.8])
        observation, _, ended, truncated, info = env.step(action)
        likely = float(observation["belief"].max()) >= 0.8
        # The ball is like no other: it is decided before the budget ends.
        assert (info["decision"] is not None) == ended == likely
        if ended:
            break
    assert ended
    assert not truncated
    assert info["decision"] == "ball"
    assert info["right"]


def test_an_object_that_was_never_learnt_is_unknown(surface_map):
    env = _places_alone(surface_map, objects=["pen"], attempt_nats=0.0)
    before, _ = env.reset(seed=0)
    after, reward, *_, info = env.step(np.float32([0, 0, 1]))
    ratio = max(after["belief"][3], np.exp(-5)) / before["belief"][3]
    assert reward == pytest.approx(float(np.log(ratio)), abs=1e-5)
    assert info["right"] == (info["decision"] == "unknown")


@pytest.mark.parametrize("name", [NAME, "palpate/TouchFlat-v0", BELIEF])
def test_several_in_one_process_are_the_single_ones(surface_map, name):
    from gymnasium.utils.env_checker import data_equivalence
    from gymnasium.vector.utils import iterate

    importlib.import_module("palpate.exploration.environment")  # has these names
    learnt = {"surface_map": surface_map, "error": 1e-6} if name == BELIEF else {}
    options = {"objects": OBJECTS, "camera": CAMERA, "max_touches": 2, **learnt}
    several = gymnasium.make_vec(name, 3, **options)
    several.reset(seed=5)
    several.action_space.seed(1)
    actions = several.action_space.sample()
    observations, rewards, *_ = several.step(actions)
    each_action = iterate(several.action_space, actions)
    each_observation = iterate(several.observation_space, observations)
    for seed, action, reward in zip((5, 6, 7), each_action, rewards, strict=True):
        single = gymnasium.make(name, **options)
        single.reset(seed=seed)
        expected, expected_reward, *_ = single.step(action)
        assert data_equivalence(next(each_observation), expected, exact=True)
        assert reward == pytest.approx(expected_reward)
    # The second step ends every episode; the one after it begins others.
    *_, over, _ = several.step(actions)
    assert over.all()
    *_, over, _ = several.step(actions)
    assert not over.any()


def test_an_unknown_object_is_refused(env):
    with pytest.raises(ValueError, match="object must be one of 'ball', 'box', 'mug'"):
        env.reset(options={"object": "anvil"})


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("prediction", [0, np.nan, 0]),
        ("prediction", [np.inf, 0, 0]),
        ("prediction", [0, -np.inf, 0]),
        ("prediction", [0, 0]),
        ("prediction", [[0, 0, 0]]),
        ("action", [0, 1]),
        ("action", [0, np.nan, 1]),
    ],
)
def test_what_is_no_action_is_refused_and_the_episode_goes_on(env, part, value):
    env.reset(seed=1)
    count = "3 finite numbers"
    action = {**_act([0, 0, 1], [0, 0, 0]), part: np.asarray(value, np.float32)}
    with pytest.raises(ValueError, match=f"{part} must be {count}, got .*Mask or clip"):
        env.unwrapped.step(action)
    assert env.unwrapped.history == []
    _, reward, *_ = env.unwrapped.step(_act([0, 0, 1], [0, 0, 0]))
    assert reward == pytest.approx(-np.log(3))


def test_the_wildest_finite_prediction_has_a_finite_reward(env):
    env.reset(seed=1, options={"object": "box"})
    most = np.finfo(np.float32).max
    _, reward, *_ = env.step(_act([0, 0, 1], [most, -most, 0]))
    assert reward == pytest.approx(-2 * float(most))


def test_half_an_action_is_refused(env):
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"must hold 'action' and .*got \['action'\]"):
        env.unwrapped.step({"action": np.zeros(3)})


def test_steps_outside_an_episode_are_refused(env):
    step = env.unwrapped.step, _act([0, 0, 1], [0, 0, 0])
    with pytest.raises(gymnasium.error.ResetNeeded, match="Call reset first"):
        step[0](step[1])
    env.reset(seed=1)
    for _ in range(4):
        step[0](step[1])
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"of 4 touches.*got step 5"):
        step[0](step[1])


@pytest.mark.parametrize("error", [0.0, 0.6])
def test_an_error_that_no_belief_decides_at_is_refused_at_once(surface_map, error):
    with pytest.raises(ValueError, match="error must be finite and between 1e-06 and"):
        _places_alone(surface_map, error=error)


def test_without_gymnasium_the_refusal_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    # The module is not imported yet where this test runs first.
    monkeypatch.delitem(sys.modules, "palpate.exploration.environment", raising=False)
    with pytest.raises(ImportError, match=r'pip install "palpate\[sim\]"'):
        importlib.import_module("palpate.exploration.environment")
