"""The episode as a Gymnasium environment, `palpate/Touch-v0`, to compare policies.

    gymnasium.make("palpate.exploration.environment:palpate/Touch-v0")

In every step the agent says where to touch and what it believes so far, and is
rewarded for the belief: actions are {"action": where, "prediction": logits}, and
`info["prediction"]` holds the target and the loss, as the tasks of ap_gym do [1]_. The
prediction of a step is made before its touch.

References
----------
.. [1] T. Schneider et al., "Active Perception Gym",
   https://github.com/TimSchneider42/active-perception-gym
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import log_softmax

from .._checks import check_count, check_number, check_option
from .._extras import missing
from .._types import Array, Floats
from ..simulation import HOUSEHOLD, DomeCamera, find_object, refuse_same_names
from ._guarded import Guard
from ._record import TouchRecord
from ._simulated_objects import Stand, put_down
from ._strategies import Hemisphere

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ImportError(missing("gymnasium", "sim", "The environment")) from error

ID = "palpate/Touch-v0"
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
        By default with pictures of 64 x 64.
    placement_sd_mm : float, default=5.0
        How far from the centre of the hemisphere objects are put down, along x and
        y each.
    random_yaw : bool, default=True
        Whether objects are turned about the vertical.
    guard : Guard, optional
        How touches are made.
    render_mode : None
        Nothing is drawn.

    Attributes
    ----------
    action_space : Dict
        "action": Box(-1, 1, (3,)), the direction from the centre in which the sensor
        stands before it moves in, of any length; what points down is mirrored up.
        "prediction": Box(-inf, inf, (n_objects,)), logits.
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

    Notes
    -----
    The reward is minus the cross-entropy (nats) of the prediction. `reset` takes the
    options "object" (a name) and "yaw_rad".
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  Gymnasium's own.

    def __init__(
        self,
        objects: Sequence[str] | None = None,
        *,
        max_touches: int = 16,
        camera: DomeCamera | None = None,
        placement_sd_mm: float = 5.0,
        random_yaw: bool = True,
        guard: Guard | None = None,
        render_mode: None = None,
    ) -> None:
        names = [thing.name for thing in HOUSEHOLD] if objects is None else objects
        self._things = [find_object(name) for name in names]
        refuse_same_names(self._things)
        self.camera = DomeCamera(image_shape=(64, 64)) if camera is None else camera
        self.max_touches = check_count("max_touches", max_touches)
        self._placement_mm = check_number("placement_sd_mm", placement_sd_mm, low=0.0)
        self._random_yaw = bool(random_yaw)
        self._guard = guard or Guard()
        self.render_mode = render_mode
        n_objects = len(self._things)
        self.inner_action_space = spaces.Box(-1, 1, (3,), np.float32)
        self.prediction_space = spaces.Box(-np.inf, np.inf, (n_objects,), np.float32)
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
        self._target = 0
        self._stand: Stand | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put another object down and return what is known before the first touch."""
        super().reset(seed=seed)
        names = [thing.name for thing in self._things]
        wanted = options or {}
        drawn = int(self.np_random.integers(len(names)))
        turned = self.np_random.uniform(0, 2 * np.pi) if self._random_yaw else 0.0
        name = check_option("object", wanted.get("object", names[drawn]), names)
        self._target = names.index(name)
        self._stand = put_down(
            self._things[self._target],
            self.camera,
            yaw_rad=check_number("yaw_rad", float(wanted.get("yaw_rad", turned))),
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
        x, y, z = _numbers(action, "action", 3)
        loss = float(-log_softmax(logits)[self._target])
        out = np.array([x, y, abs(z)])
        if np.linalg.norm(out) < 1e-6:
            out = np.array([0.0, 0.0, 1.0])
        record = self._stand.touch(self.hemisphere.pose_towards(out), self._guard)
        self.history.append(record)
        info = {
            "prediction": {"target": self._target, "loss": loss},
            "base_reward": 0.0,
            "outcome": record.outcome,
            "message": record.message,
        }
        over = len(self.history) >= self.max_touches
        return self._observation(record), -loss, False, over, info

    def _observation(self, record: TouchRecord | None) -> Observation:
        touched = record is not None and record.touched
        image, place = self.camera.no_contact(), np.zeros(3)
        if record is not None and record.image is not None:
            image = record.image
            place = np.asarray(record.position_mm) - self.hemisphere.centre_mm
        left = 1 - len(self.history) / self.max_touches
        return {
            "image": image[..., np.newaxis],
            "place": np.asarray(place / self.hemisphere.radius_mm, np.float32),
            "touched": np.array([touched], np.float32),
            "touches_left": np.array([left], np.float32),
        }


def _numbers(action: Any, name: str, count: int) -> Floats:
    if not isinstance(action, Mapping) or name not in action:
        found = sorted(action) if isinstance(action, Mapping) else action
        raise ValueError(
            f"An action must hold 'action' and 'prediction', got {found!r}. Give both, "
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


gymnasium.register(ID, entry_point=f"{__name__}:TouchEnv")
