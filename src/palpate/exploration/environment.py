"""The episode as a Gymnasium environment, `palpate/Touch-v0`, to compare policies.

    import palpate.exploration.environment  # registers all

    gymnasium.make("palpate/Touch-v0")
    gymnasium.make("palpate/TouchFlat-v0")  # one vector in, one vector out
    gymnasium.make("palpate/TouchBelief-v0", surface_map=surface_map)  # where alone
    gymnasium.make_vec("palpate/Touch-v0", num_envs=8)  # several in one process

Since its version 1.0 Gymnasium looks into no installed package by itself; where only
a name can be given, "palpate.exploration.environment:palpate/Touch-v0" imports it.

In every step the agent says where to touch and what it believes so far, and is
rewarded for the belief: actions are {"action": where, "prediction": logits}, and
`info["prediction"]` holds the target and the loss, as the tasks of ap_gym do [1]_. The
prediction of a step is made before its touch. Where ap_gym is installed,
`active_perception_env` makes it one of its own tasks.

References
----------
.. [1] T. Schneider et al., "Active Perception Gym",
   https://github.com/TimSchneider42/active-perception-gym
"""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from .._checks import check_count, check_number, check_option
from .._extras import missing
from .._numbers import log_softmax
from .._types import Array, Floats
from ..simulation import DomeCamera, find_objects
from ._guarded import Guard
from ._record import TouchRecord
from ._simulated_objects import Stand, put_down
from ._strategies import Hemisphere
from ._surface_map import SurfaceMap

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ImportError(missing("gymnasium", "sim", "The environment")) from error

MOST_LOGIT = 20.0
"""Bound of the logits in `action_space`: a probability of 1 - 2e-9."""
_LEAST = float(np.exp(-5))
_OFFSET_MM = 50.0
UNKNOWN = "unknown"  # as beliefs call what was never learnt
_ATTEMPT = 4  # numbers that tell of one
Observation = dict[str, Array]
_MOST = float(np.finfo(np.float32).max)


class TouchEnv(gymnasium.Env[Any, Any]):
    """Touch a simulated object that stands somewhere, turned somehow, and name it.

    Parameters
    ----------
    objects : sequence of str, optional
        Names of built-in objects; by default the ten household objects.
    max_touches : int, default=16
        Touches in an episode, after which it is truncated.
    camera : DomeCamera, optional
        By default with pictures of 64 x 64 and 24 nodes.
    placement_sd_mm : float, default=5.0
        How far from the centre of the hemisphere objects are put down, along x and
        y each.
    random_yaw : bool, default=True
        Whether objects are turned about the vertical.
    guard : Guard, optional
        Makes touches step by step, with the simulated arm and its force sensor. By
        default each is solved in one step: the same contact, many times faster.
    render_mode : {"rgb_array"}, optional
        `render` returns the last frame, uint8 (n_rows, n_cols, 3).

    Attributes
    ----------
    action_space : Dict
        "action": Box(-1, 1, (3,)), the direction from the centre in which the sensor
        stands before it moves in, of any length; what points down is mirrored up.
        "prediction": Box(-20, 20, (n_objects,)), logits; larger finite ones are taken
        as they are.
    observation_space : Dict
        "image": the last frame, uint8 (n_rows, n_cols, 1), of no contact at first;
        "place": where the tip met something, from the centre, over the radius;
        "touched": 1 if it did; "touches_left": share of the budget.
    inner_action_space, prediction_space, prediction_target_space : Space
        Parts of the above, and Discrete(n_objects).
    hemisphere : Hemisphere
        Of this episode; a `Strategy` made with it can play.
    history : list of TouchRecord
        Attempts of this episode.
    object_names : list of str
        What may be put down.
    target : int
        Number of the object of this episode.
    share_left : float
        Share of the budget that is left.

    Notes
    -----
    The reward is minus the cross-entropy (nats) of the prediction. `reset` takes the
    options "object" (a name) and "yaw_rad".
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  Gymnasium's own.
        "render_modes": ["rgb_array"],
        "render_fps": 2,
    }

    def __init__(
        self,
        objects: Sequence[str] | None = None,
        *,
        max_touches: int = 16,
        camera: DomeCamera | None = None,
        placement_sd_mm: float = 5.0,
        random_yaw: bool = True,
        guard: Guard | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._things = find_objects(objects)
        self.object_names = [thing.name for thing in self._things]
        self.camera = DomeCamera((64, 64), n_nodes=24) if camera is None else camera
        self.max_touches = check_count("max_touches", max_touches)
        self._placement_mm = check_number("placement_sd_mm", placement_sd_mm, low=0.0)
        self._random_yaw = bool(random_yaw)
        self._guard = guard
        if render_mode is not None:
            check_option("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        n_objects = len(self._things)
        self.inner_action_space = spaces.Box(-1, 1, (3,), np.float32)
        bounds = -MOST_LOGIT, MOST_LOGIT
        self.prediction_space = spaces.Box(*bounds, (n_objects,), np.float32)
        self.prediction_target_space = spaces.Discrete(n_objects)
        self.action_space = spaces.Dict(
            {"action": self.inner_action_space, "prediction": self.prediction_space}
        )
        self.observation_space = spaces.Dict(
            {
                "image": spaces.Box(0, 255, (*self.camera.image_shape, 1), np.uint8),
                "place": spaces.Box(-1, 1, (3,), np.float32),
                "touched": spaces.Box(0, 1, (1,), np.float32),
                "touches_left": spaces.Box(0, 1, (1,), np.float32),
            }
        )
        self.hemisphere = Hemisphere()
        self.history: list[TouchRecord] = []
        self.target = 0
        self._stand: Stand | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put another object down and return what is known before the first touch."""
        super().reset(seed=seed)
        names, chosen = self.object_names, options or {}
        drawn = int(self.np_random.integers(len(names)))
        turned = self.np_random.uniform(0, 2 * np.pi) if self._random_yaw else 0.0
        name = check_option("object", chosen.get("object", names[drawn]), names)
        self.target = names.index(name)
        self._stand = put_down(
            self._things[self.target],
            self.camera,
            yaw_rad=check_number("yaw_rad", float(chosen.get("yaw_rad", turned))),
            placement_sd_mm=self._placement_mm,
            random_state=int(self.np_random.integers(2**31)),
        )
        self.hemisphere = self._stand.hemisphere
        self.history = []
        return self._observation(None), {"object": name}

    def step(
        self, action: dict[str, Array]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Judge the prediction, then touch where the action says.

        Raises
        ------
        ValueError
            The action or the prediction is of another shape, or not finite.
        gymnasium.error.ResetNeeded
            No episode has begun, or it is over.
        """
        if self._stand is None or len(self.history) >= self.max_touches:
            raise gymnasium.error.ResetNeeded(
                f"An episode of {self.max_touches} touches must have begun and go on, "
                f"got step {len(self.history) + 1}. Call reset first."
            )
        logits = _numbers(action, "prediction", len(self._things))
        way = _numbers(action, "action", 3)
        loss = float(-log_softmax(logits)[self.target])
        record = self._touched(self._stand, way)
        self.history.append(record)
        info = {
            "prediction": {"target": self.target, "loss": loss},
            "base_reward": 0.0,
            "outcome": record.outcome,
            "message": record.message,
        }
        over = len(self.history) >= self.max_touches
        return self._observation(record), -loss, False, over, info

    def _touched(self, stand: Stand, way: Floats) -> TouchRecord:
        """Touch from the direction of an action, mirrored up."""
        out = np.array([*way[:2], abs(way[2])])
        if np.linalg.norm(out) < 1e-6:
            out = np.array([0.0, 0.0, 1.0])
        pose = self.hemisphere.pose_towards(out)
        if self._guard is None:
            return stand.touch_at_once(pose)
        return stand.touch(pose, self._guard)

    @property
    def share_left(self) -> float:
        """Share of the budget that is left."""
        return 1 - len(self.history) / self.max_touches

    def render(self) -> Array | None:
        """Return the last frame in grey as three channels, or None without a mode."""
        if self.render_mode is None:
            return None
        if self._stand is None:
            raise gymnasium.error.ResetNeeded(
                "An episode must have begun to be rendered. Call reset first."
            )
        return np.repeat(self._last_image()[..., np.newaxis], 3, axis=2)

    def _last_image(self) -> Array:
        if self.history and (image := self.history[-1].image) is not None:
            return np.asarray(image)
        return self.camera.no_contact()

    def _observation(self, record: TouchRecord | None) -> Observation:
        touched = record is not None and record.touched
        image, place = self._last_image(), np.zeros(3)
        if record is not None and record.image is not None:
            place = np.asarray(record.position_mm) - self.hemisphere.centre_mm
        return {
            "image": image[..., np.newaxis],
            "place": np.asarray(place / self.hemisphere.radius_mm, np.float32),
            "touched": np.array([touched], np.float32),
            "touches_left": np.array([self.share_left], np.float32),
        }


def _numbers(action: Any, name: str, count: int) -> Floats:
    if not isinstance(action, Mapping) or name not in action:
        keys = sorted(action) if isinstance(action, Mapping) else action
        raise ValueError(
            f"An action must hold 'action' and 'prediction', got {keys!r}. Give both, "
            "as in action_space."
        )
    values = np.asarray(action[name], dtype=np.float64)
    # float32 is what the spaces hold; beyond it a loss would be infinite.
    if values.shape != (count,) or not (np.abs(values) <= _MOST).all():
        raise ValueError(
            f"{name} must be {count} finite numbers, got {values.tolist()} of shape "
            f"{values.shape}. Mask or clip what the policy gives."
        )
    return values


def flat_touch_env(**options: Any) -> gymnasium.Env[Any, Any]:
    """Return a `TouchEnv` of vectors alone, for agents that take no dictionaries.

    An observation is image, place, touched and touches_left one after another, the
    image over 255; an action is direction, then logits over `MOST_LOGIT`, in -1 to 1.
    `options` are those of `TouchEnv`.
    """
    env = TouchEnv(**options)
    vector = spaces.Box(-1, 1, (3 + len(env.object_names),), np.float32)

    def parts(action: Any) -> dict[str, Array]:
        values = np.asarray(action, dtype=np.float32)
        if values.shape != vector.shape:
            raise ValueError(
                f"An action must be a vector of {vector.shape}, got {values.shape}."
            )
        return {"action": values[:3], "prediction": values[3:] * MOST_LOGIT}

    inner = cast(spaces.Dict, env.observation_space).spaces
    image = spaces.Box(0, 1, inner["image"].shape, np.float32)
    scaled = gymnasium.wrappers.TransformObservation(
        gymnasium.wrappers.TransformAction(env, parts, vector),
        lambda whole: {**whole, "image": (whole["image"] / 255).astype(np.float32)},
        spaces.Dict({**inner, "image": image}),
    )
    return gymnasium.wrappers.FlattenObservation(scaled)


class BeliefObservations(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Let a `SurfaceMap` believe and decide, so that a policy chooses places alone.

    Parameters
    ----------
    env : gymnasium.Env
        Made of a `TouchEnv`.
    surface_map : SurfaceMap
        Of its objects. One that was never learnt is "unknown".
    error : float, default=0.05
        The episode ends where the belief decides at this error, see `Belief.decide`.
    attempt_nats : float, default=0.1
        What an attempt costs.

    Attributes
    ----------
    action_space : Box
        (3,), from -1 to 1: "action" of `TouchEnv`.
    observation_space : Dict
        "belief": the posterior of each learnt object, in their order, then of
        "unknown"; "pose": how the most probable one stands: cosine and sine of its
        turn, each times how well it is known, and its offset over 50 mm, (5,);
        "attempts": for each so far the direction of its place and 1 where something
        was met, 0 where not, then zeros, (4 * max_touches,); "touches_left".
    belief : PlaceBelief
        Of this episode.

    Notes
    -----
    The reward is by how much the logarithm of the truth's probability has grown
    (nats), less `attempt_nats`. Probabilities below exp(-5) count as that. `info` has
    "decision", a name, "unknown" or None, and "right".
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        surface_map: SurfaceMap,
        *,
        error: float = 0.05,
        attempt_nats: float = 0.1,
    ) -> None:
        super().__init__(env)
        self.surface_map = surface_map
        self.error = check_number("error", error, low=1e-6, high=0.5)
        self.attempt_nats = check_number("attempt_nats", attempt_nats, low=0.0)
        self._touch = cast(TouchEnv, env.unwrapped)
        self._names = [*surface_map.recogniser.classes_.tolist(), UNKNOWN]
        n_numbers = _ATTEMPT * self._touch.max_touches
        self.action_space = self._touch.inner_action_space
        self.observation_space = spaces.Dict(
            {
                "belief": spaces.Box(0, 1, (len(self._names),), np.float32),
                "pose": spaces.Box(-1, 1, (5,), np.float32),
                "attempts": spaces.Box(-1, 1, (n_numbers,), np.float32),
                "touches_left": spaces.Box(0, 1, (1,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put another object down; see `TouchEnv.reset`."""
        _, info = self.env.reset(seed=seed, options=options)
        self.belief = self.surface_map.start_before(self._touch.hemisphere)
        name = info["object"]
        self._truth = name if name in self._names else UNKNOWN
        self._shares = self._believed()
        return self._observation(), info

    def step(
        self, action: Array
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Touch where the action says, and take in what came of it."""
        no_prediction = np.zeros(self._touch.prediction_space.shape or ())
        parts = {"action": action, "prediction": no_prediction}
        *_, truncated, info = self.env.step(parts)
        self.belief.update_from_record(self._touch.history[-1])
        before, self._shares = self._shares, self._believed()
        truth = self._names.index(self._truth)
        ratio = max(self._shares[truth], _LEAST) / max(before[truth], _LEAST)
        gain = float(np.log(ratio))
        decision = self.belief.decide(self.error)
        info |= {"decision": decision, "right": decision == self._truth}
        over = decision is not None
        return self._observation(), gain - self.attempt_nats, over, truncated, info

    def _believed(self) -> list[float]:
        """Return the probability of each learnt object, then of "unknown"."""
        return [*self.belief.posterior.values(), self.belief.unknown]

    def _observation(self) -> Observation:
        best = self._names[int(np.argmax(self._shares[:-1]))]
        pose = self.belief.pose(best)
        length = np.exp(-(pose.turn_sd_rad**2) / 2)
        turn = length * np.array([np.cos(pose.turn_rad), np.sin(pose.turn_rad)])
        offset = np.clip(np.array(pose.offset_mm) / _OFFSET_MM, -1, 1)
        attempts = np.zeros((self._touch.max_touches, _ATTEMPT))
        for row, record in zip(attempts, self._touch.history, strict=False):
            row[:] = [*-record.direction, record.touched]
        values = {
            "belief": np.clip(self._shares, 0, 1),
            "pose": np.concatenate([turn, offset]),
            "attempts": attempts.ravel(),
            "touches_left": np.array([self._touch.share_left]),
        }
        return {name: np.asarray(v, np.float32) for name, v in values.items()}


def belief_touch_env(
    surface_map: SurfaceMap,
    objects: Sequence[str] | None = None,
    *,
    error: float = 0.05,
    attempt_nats: float = 0.1,
    **options: Any,
) -> gymnasium.Env[Any, Any]:
    """Return a `TouchEnv` in which a policy chooses places, with `BeliefObservations`.

    `objects` are by default those that `surface_map` knows, built-in names all;
    `options` are those of `TouchEnv`. Its camera has to be that of the learnt touches.
    """
    learnt = surface_map.recogniser.classes_.tolist()
    env = TouchEnv(learnt if objects is None else objects, **options)
    how = {"error": error, "attempt_nats": attempt_nats}
    return BeliefObservations(env, surface_map, **how)


def active_perception_env(**options: Any) -> Any:
    """Return the task as an `ActiveClassificationEnv` of ap_gym, for its wrappers.

    `options` are those of `TouchEnv`. Its predictions have no bounds and its loss is
    ap_gym's.

    Raises
    ------
    ImportError
        ap_gym is not installed.
    """
    try:
        import ap_gym
    except ImportError as error:
        raise ImportError(
            "active_perception_env needs ap_gym, which is not installed: "
            "pip install ap_gym"
        ) from error

    class ActiveTouch(ap_gym.ActiveClassificationEnv):  # type: ignore[misc]
        metadata = TouchEnv.metadata

        def __init__(self) -> None:
            self._touch = TouchEnv(**options)
            n_objects = int(self._touch.prediction_target_space.n)
            super().__init__(n_objects, self._touch.inner_action_space)
            self.observation_space = self._touch.observation_space
            self.render_mode = self._touch.render_mode

        def reset(
            self, *, seed: int | None = None, options: dict[str, Any] | None = None
        ) -> Any:
            super().reset(seed=seed)
            observation, info = self._touch.reset(seed=seed, options=options)
            return observation, {
                **info,
                "prediction": {"target": np.int64(self._touch.target)},
            }

        def _step(self, action: Any, prediction: Any) -> Any:
            whole = {"action": action, "prediction": prediction}
            observation, _, ended, truncated, info = self._touch.step(whole)
            target = np.int64(self._touch.target)
            return observation, 0.0, ended, truncated, info, target

        def render(self) -> Any:
            return self._touch.render()

    return ActiveTouch()


gymnasium.register("palpate/Touch-v0", f"{__name__}:TouchEnv")
gymnasium.register("palpate/TouchFlat-v0", f"{__name__}:flat_touch_env")
gymnasium.register("palpate/TouchBelief-v0", f"{__name__}:belief_touch_env")
