"""A model that was read is tried on a blank touch before anyone relies on it."""

from math import prod

import numpy as np

from .._checks import check_count, check_number
from .._types import Floats
from ..images import PressPose
from ._belief import Belief, Judge
from ._evidence import Evidence, SequenceCalibration
from ._memory import Memory
from ._modality import Modality
from ._unknown import LEVELS, DecisionLimits

MAX_PIXELS = 50_000_000


def check_parts(judge: Judge, image_shape: tuple[int, ...], pose: object) -> None:
    """Refuse a model whose parts are of the wrong kind, or do not fit together."""
    if len(image_shape) not in (2, 3) or not 0 < prod(image_shape) <= MAX_PIXELS:
        raise ValueError(f"images of {' x '.join(map(str, image_shape))} are none")
    _check_memory(judge.memory)
    if not np.array_equal(judge.classes, judge.memory.classes.astype(str)):
        raise ValueError("its objects are not those of its touches")
    _check_calibration(judge.sequence_calibration)
    _check_limits(judge.limits)
    check_number("floor_", judge.floor, low=0, high=0.5)
    if not isinstance(pose, PressPose | None):
        raise TypeError(f"pose_ is a {type(pose).__name__}")
    for name, sense in judge.senses.items():
        if not isinstance(sense, Modality):
            raise TypeError(f"{name} is a {type(sense).__name__}")
        _check_calibration(sense.sequence_calibration_)


def try_one_touch(belief: Belief, blank: Evidence, log_likelihood: Floats) -> None:
    """Take in a blank touch twice, so that a model that cannot work is found now.

    A blank touch may count as no contact, whose row is zeros whatever the classifier:
    so `log_likelihood` (1, n_objects) is what the classifier itself says of it.
    """
    if not np.isfinite(log_likelihood).all():
        raise ValueError("its parts do not fit together")
    for _ in range(2):
        belief.update(blank._replace(log_likelihood=log_likelihood))
    if abs(sum(belief.posterior.values()) - 1) > 1e-6:
        raise ValueError("its belief does not sum to one")
    if not 0 <= belief.unknown <= 1:
        raise ValueError("its unknown score is no number")
    belief.decide()
    belief.explain()


def _check_memory(memory: object) -> None:
    if not isinstance(memory, Memory):
        raise TypeError(f"memory_ is a {type(memory).__name__}")
    columns = [v for k, v in vars(memory).items() if k != "sensor"]
    if {len(column) for column in columns} != {len(memory)} or not len(memory):
        raise ValueError("its sizes do not agree")
    if not np.isfinite(memory.features).all():
        raise ValueError("its features hold NaN or infinity")


def _check_calibration(calibration: object) -> None:
    if not isinstance(calibration, SequenceCalibration):
        raise TypeError(f"a sequence calibration is a {type(calibration).__name__}")
    check_number("strength", calibration.strength, low=0, high=100)
    check_number("correlation", calibration.correlation, low=0, high=1)


def _check_limits(limits: object) -> None:
    if not isinstance(limits, DecisionLimits):
        raise TypeError(f"limits_ is a {type(limits).__name__}")
    n_levels, n_lengths = len(LEVELS), len(limits.quantiles)
    shapes = {
        "weights": limits.weights.shape[:1],
        "naming": (n_levels,),
        "naming_category": (n_levels,),
        "refusing": (n_levels,),
        "wrong": (n_levels,),
        "quantiles": (n_lengths, n_levels),
    }
    for name, shape in shapes.items():
        values = getattr(limits, name)
        if values.shape != shape or not values.size:
            raise ValueError(f"{name} of its limits is no such table")
        if not ((values >= 0) & (values <= 1)).all():
            raise ValueError(f"{name} of its limits is not between 0 and 1")
    check_count("n_units", limits.n_units)
    if not isinstance(limits.population, str):
        raise TypeError("population of its limits is no text")
