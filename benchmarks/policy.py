"""A policy that a public agent learnt, beside random places, a raster and chosen ones.

    make policy                                    # in an environment of its own
    python benchmarks/policy.py --out benchmarks/policy.json

Ten simulated objects are taught, 60 touches each on the usual face, and `SurfaceMap`
learns them. PPO of stable-baselines3 then learns where to touch in
`palpate/TouchBelief-v0`, with its usual settings, from the belief, the pose and the
places tried. All meet the same placements afterwards: an unknown yaw, 5 mm (sd) aside,
14 attempts at most, decided at an error of 5 %, four of each object and seed. A seed
has a teaching and a training of its own; no placement of a training is asked about.

"attempts" is the mean number until it is decided rightly, 15 where it never is.
"""

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from palpate._durable import write_text
from palpate.exploration import (
    Hemisphere,
    InformativeTouch,
    RandomHemisphere,
    Raster,
    SurfaceMap,
)
from palpate.exploration.environment import BeliefObservations
from palpate.recognition import ObjectRecogniser
from places import BUDGET, CAMERA, seed_of, taught

# Few steps an update, as beliefs are slow to make.
N_ENVS, N_STEPS = 4, 64
Row = dict[str, Any]
# Takes an environment, its observation and a seed; returns the next action.
Player = Callable[[BeliefObservations, Any, int], np.ndarray]


def touch_env(surface_map: SurfaceMap) -> gymnasium.Env[Any, Any]:
    """Return the environment in which all play."""
    name, options = "palpate/TouchBelief-v0", {"max_touches": BUDGET, "camera": CAMERA}
    return gymnasium.make(name, surface_map=surface_map, **options)


def trained(surface_map: SurfaceMap, n_steps: int, seed: int) -> tuple[Any, Row]:
    """Let PPO learn for so many steps, in four environments of this process.

    Also return the CPU seconds, and the mean return of its first and last episodes.
    """
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env(partial(touch_env, surface_map), N_ENVS, seed=seed_of(7, seed))
    options = {"n_steps": N_STEPS, "batch_size": N_STEPS, "gamma": 1.0, "seed": seed}
    began = time.process_time()
    model = PPO("MultiInputPolicy", envs, **options).learn(n_steps)
    cpu_s = round(time.process_time() - began)
    returns = [
        np.array(env_returns) for env_returns in envs.env_method("get_episode_rewards")
    ]
    quarters = [np.array_split(env_returns, 4) for env_returns in returns]
    first, *_, last = (np.concatenate(part) for part in zip(*quarters, strict=True))
    means = {"first": round(first.mean(), 2), "last": round(last.mean(), 2)}
    return model, {"cpu_s": cpu_s, "episodes": sum(map(len, returns)), **means}


def by_strategy(make: Callable[[Hemisphere, int], Any]) -> Player:
    """Return a player that does as a `Strategy` of the episode says."""
    playing: dict[int, Any] = {}

    def play(env: BeliefObservations, observation: Any, seed: int) -> np.ndarray:
        inner = env.unwrapped
        if not inner.history:
            playing.clear()
            playing[seed] = make(inner.hemisphere, seed)
        pose = playing[seed].next_pose(env.belief, inner.history)
        return np.asarray(-pose.direction, np.float32)

    return play


def by_policy(model: Any, deterministic: bool) -> Player:
    """Return a player that does as a trained model says, by its mean or drawn."""
    return lambda env, observation, seed: model.predict(
        observation, deterministic=deterministic
    )[0]


def strategies(surface_map: SurfaceMap) -> dict[str, Player]:
    """Return the players that need no training."""
    return {
        "random": by_strategy(RandomHemisphere),
        "raster": by_strategy(lambda hemisphere, _: Raster(hemisphere)),
        "chosen": by_strategy(
            lambda hemisphere, _: InformativeTouch(surface_map, hemisphere)
        ),
    }


def episode(env: Any, player: Player, thing: str, seed: int) -> Row:
    """Play one episode; return its row."""
    observation, _ = env.reset(seed=seed, options={"object": thing})
    inner = env
    while not isinstance(inner, BeliefObservations):
        inner = inner.env
    over, total, began = False, 0.0, time.process_time()
    while not over:
        observation, reward, ended, truncated, info = env.step(
            player(inner, observation, seed)
        )
        over, total = ended or truncated, total + reward
    n_attempts = len(inner.unwrapped.history)
    return {
        "object": thing,
        "attempts": n_attempts if info["right"] else BUDGET + 1,
        "right": info["right"],
        "wrong": info["decision"] is not None and not info["right"],
        "return": total,
        "cpu_ms": 1e3 * (time.process_time() - began) / n_attempts,
    }


def episodes(env: Any, player: Player, seed: int, n_rounds: int = 4) -> list[Row]:
    """Play all objects in turn, from placements that the seed alone decides."""
    things = env.unwrapped.object_names
    return [
        {"seed": seed, **episode(env, player, thing, seed_of(8, seed, number, code))}
        for number in range(n_rounds)
        for code, thing in enumerate(things)
    ]


def summary(rows: list[Row], beside: list[Row]) -> Row:
    """Return means over episodes; attempts less those of `beside`, with spread."""
    seeds = np.array([row["seed"] for row in rows])
    each = np.array([row["attempts"] for row in rows], float)
    saved = each - np.array([row["attempts"] for row in beside], float)
    names = "right", "wrong", "return", "cpu_ms"
    means = {name: float(np.mean([row[name] for row in rows])) for name in names}
    return {
        "episodes": len(rows),
        "attempts": round(float(each.mean()), 2),
        "attempts_sd": round(float(_by_seed(each, seeds).std()), 2),
        "less_random": round(float(saved.mean()), 2),
        "less_random_error": round(float(saved.std() / np.sqrt(len(saved))), 2),
        **{name: round(mean, 3) for name, mean in means.items()},
    }


def _by_seed(values: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    return np.array([values[seeds == seed].mean() for seed in np.unique(seeds)])


def main() -> None:
    """Run, print a table, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=12288)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--cache", type=Path, help="a folder for taught touches")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    kept: dict[str, list[Row]] = {}
    trainings: list[Row] = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        touches = taught(seed, "usual", options.cache)
        recogniser = ObjectRecogniser(random_state=seed).fit(touches)
        surface_map = SurfaceMap(random_state=seed).fit(recogniser, touches)
        model, training = trained(surface_map, options.steps, seed)
        trainings.append(training)
        players = strategies(surface_map)
        players["PPO, drawn"] = by_policy(model, deterministic=False)
        players["PPO, its mean"] = by_policy(model, deterministic=True)
        env = touch_env(surface_map)
        for name, player in players.items():
            rows = episodes(env, player, seed, options.rounds)
            kept.setdefault(name, []).extend(rows)
        table = {name: summary(rows, kept["random"]) for name, rows in kept.items()}
        for name, row in table.items():
            print(f"up to seed {seed}: {name:14s} {json.dumps(row)}", flush=True)
        if options.out:
            kinds = {"steps": options.steps, "trainings": trainings}
            whole = {**kinds, "rows": table}
            write_text(options.out, json.dumps(whole, indent=1) + "\n")


if __name__ == "__main__":
    main()
