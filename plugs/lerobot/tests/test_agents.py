"""Agents that others wrote learn in the environment; ap_gym's wrapper logs it."""

import gymnasium
import numpy as np
import pytest

import palpate.exploration.environment  # noqa: F401  registers the environments
from palpate.exploration import SurfaceMap, explore_to_learn
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, find_object

pytest.importorskip("stable_baselines3")
pytestmark = pytest.mark.filterwarnings("default")
OPTIONS = {
    "objects": ["ball", "box", "mug"],
    "camera": DomeCamera(image_shape=(32, 32), n_nodes=20),
    "max_touches": 4,
}


def flat():
    return gymnasium.make("palpate/TouchFlat-v0", **OPTIONS)


def test_stable_baselines_objects_to_nothing(recwarn):
    from stable_baselines3.common.env_checker import check_env

    check_env(flat())
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize(
    ("package", "agent", "policy", "n_steps"),
    [
        ("stable_baselines3", "PPO", "MlpPolicy", 256),
        ("sb3_contrib", "RecurrentPPO", "MlpLstmPolicy", 128),
    ],
)
def test_an_agent_learns_for_some_steps(package, agent, policy, n_steps):
    agent_class = getattr(pytest.importorskip(package), agent)
    model = agent_class(policy, flat(), n_steps=64, batch_size=32, seed=0)
    before = [part.detach().clone() for part in model.policy.parameters()]
    model.learn(n_steps)
    after = list(model.policy.parameters())
    assert model.num_timesteps == n_steps
    assert all(np.isfinite(part.detach().numpy()).all() for part in after)
    assert any((a != b).any() for a, b in zip(before, after, strict=True))


@pytest.fixture(scope="module")
def surface_map():
    things = [find_object(name) for name in OPTIONS["objects"]]
    touches = explore_to_learn(things, 12, OPTIONS["camera"], n_sessions=2)
    return SurfaceMap(n_turns=8).fit(ObjectRecogniser().fit(touches), touches)


def test_an_agent_learns_where_to_touch_from_a_belief(surface_map, recwarn):
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env

    env = gymnasium.make("palpate/TouchBelief-v0", surface_map=surface_map, **OPTIONS)
    check_env(env)
    assert [str(warning.message) for warning in recwarn] == []
    model = PPO("MultiInputPolicy", env, n_steps=32, batch_size=32, seed=0)
    before = [part.detach().clone() for part in model.policy.parameters()]
    model.learn(64)
    after = list(model.policy.parameters())
    assert any((a != b).any() for a, b in zip(before, after, strict=True))


def test_ap_gym_logs_an_episode():
    ap_gym = pytest.importorskip("ap_gym")
    from palpate.exploration.environment import active_perception_env

    env = active_perception_env(**OPTIONS)
    assert isinstance(env, ap_gym.ActiveClassificationEnv)
    logged = ap_gym.ActiveClassificationLogWrapper(env)
    logged.reset(seed=1, options={"object": "box"})
    for logits in ([0, 0, 0], [0, 0, 0], [0, 0, 0], np.log([0.2, 0.7, 0.1])):
        action = {"action": [0, 0, 1], "prediction": np.float32(logits)}
        _, reward, _, over, info = logged.step(action)
    assert over
    # ap_gym divides the cross-entropy by that of a guess, log(3).
    assert reward == pytest.approx(np.log(0.7) / np.log(3), abs=1e-5)
    assert info["stats"]["scalar"]["final_accuracy"] == 1
