"""What a model file may ask for before anything is built from it, and whether it works.

A checksum tells damage, not intent: who forges a model computes it anew. So whatever
sizes something has a limit, and what would take seconds to try is refused. A model that
was read is tried on a blank touch before anyone relies on it.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import prod
from types import UnionType
from typing import Any

import numpy as np

from .._checks import check_count, check_number
from .._types import Array, Floats
from ..images import PressPose
from ._belief import Belief, BeliefModel
from ._encoder import TouchEncoder
from ._evidence import Evidence, SequenceCalibration
from ._learnt import AnyEncoder, RemountedEncoder
from ._memory import Memory
from ._sessions import N_LOOKS
from ._strangers import Curve, StrangerModel
from ._user_parts import Modality, UserEncoding

MB = 2**20
MAX_PIXELS = 50_000_000
# A blank touch of larger images is not tried.
MOST_TRIED = 800_000
MOST_CELLS = 1024
_LARGEST_PARAMETER = {
    **dict.fromkeys(("degree", "order", "n_orientations", "n_partitions"), 60),
    **dict.fromkeys(("n_points", "n_rings", "radii", "n_harmonics", "cell"), 32),
    **dict.fromkeys(("shape", "side", "cells"), MOST_CELLS),
    **dict.fromkeys(("n", "resample", "n_quantiles"), 1024),
    **dict.fromkeys(("size", "size_"), 2048),
}


@dataclass
class Budget:
    """What one file of `n_bytes` holds, and what reading it has used so far."""

    n_bytes: int
    tensors: Mapping[str, Array]
    classes: Mapping[str, type]
    foreign: Mapping[str, UserEncoding] = field(default_factory=dict)
    objects: int = 0
    text: float = 0.0
    repeated: float = 0.0
    used: Counter[str] = field(default_factory=Counter)

    def check_document(self, document: str) -> None:
        """Refuse a document that would become too many values."""
        if not document.isascii():
            raise ValueError("letters beyond ASCII, which are written as \\uXXXX")
        n_values = sum(map(document.count, ",[{"))
        if n_values > 1_000_000 + self.n_bytes / 50:
            raise ValueError(f"{n_values} values are too many for its size")

    def check_texts(self, items: Sequence[Any], n_repeated: int = 0) -> None:
        """Refuse texts that would take too much memory, some `n_repeated` times."""
        longest = max(map(len, items), default=0)
        self.text += 4 * longest * len(items)
        self.repeated += 4 * longest * n_repeated
        too_many = self.text > 32 * MB + self.n_bytes / 2
        if longest > 1000 or too_many or self.repeated > 32 * MB + 2 * self.n_bytes:
            raise ValueError(f"{len(items)} texts of up to {longest} letters")

    def array(self, name: str, shape: list[int]) -> Array:
        """Return an array of its own shape, unless it was used again and again."""
        array = self.tensors[name]
        self.used[name] += 1
        if self.used[name] > 4 or list(array.shape) != (shape or [1]):
            raise ValueError(f"the array {name} has shape {array.shape}, not {shape}")
        return array.reshape(shape)

    def check_object(self, values: Mapping[str, Any]) -> None:
        """Refuse attributes of one object that would size or repeat too much."""
        self.objects += 1
        for name, value in values.items():
            most = _LARGEST_PARAMETER.get(name, 2**53)
            for item in value if isinstance(value, list | tuple) else (value,):
                if isinstance(item, int) and abs(item) > most:
                    raise ValueError(f"{name} must be at most {most}, got {item}")
        levels, order = prod(values.get("image_shape_", ())), values.get("order", 0)
        n_kernels = len(values.get("kernels_", ())) * len(values.get("touches_", ()))
        # Zernike moments of high order keep tables for each level.
        costly = order > 20 and levels * order**2 > 2e7
        if costly or n_kernels > 5_000_000 or self.objects > 500:
            raise ValueError(f"{self.objects} parts, too much for one touch")
        counts, n_points = values.get("counts_"), len(values.get("points_", ()))
        if counts is not None and not 0 <= counts.min() <= counts.max() <= n_points:
            raise ValueError("counts_ are more touches than there are")
        pairs, n_classes = values.get("pairs_"), len(values.get("classes_", ()))
        if pairs is not None and not 0 <= np.min(pairs) <= np.max(pairs) < n_classes:
            raise ValueError("pairs_ are of more classes than there are")
        pads = values.get("pads_")
        if pads is not None and np.asarray(pads).dtype.kind not in "iu":
            raise ValueError("pads_ are no whole numbers")
        if "down_" in values:
            _check_grid(values)


def _check_grid(values: Mapping[str, Any]) -> None:
    """Refuse a grid of cells that makes far more levels than its file holds."""
    cells, most = (len(values["down_"]), len(values["across_"])), MOST_CELLS
    if max(cells) > most:
        raise ValueError(f"a grid must have at most {most} cells, got {max(cells)}")
    if "baseline_" not in values:
        return
    blurs = [np.shape(values[name]) for name in ("smooth_down_", "smooth_across_")]
    baselines = (1,), (*cells, *values["image_shape_"][2:])
    fits = blurs == [(n, n) for n in cells]
    if not fits or np.shape(values["baseline_"]) not in baselines:
        raise ValueError("the parts of a grid do not fit together")


def check_parts(model: BeliefModel, encoder: AnyEncoder, pose: object) -> None:
    """Refuse a model whose parts are of the wrong kind, or do not fit together."""
    image_shape = encoder.image_shape_
    if len(image_shape) not in (2, 3) or not 0 < prod(image_shape) <= MAX_PIXELS:
        raise ValueError(f"images of {' x '.join(map(str, image_shape))} are none")
    memory = model.memory
    _check_kind("memory_", memory, Memory)
    columns = [getattr(memory, f.name) for f in fields(memory) if f.name != "sensor"]
    if {len(column) for column in columns} != {len(memory)} or not len(memory):
        raise ValueError("its sizes do not agree")
    if memory.looks.shape[1:] != (N_LOOKS,):
        raise ValueError(f"its looks have {memory.looks.shape[1:]} values")
    if not np.isfinite(memory.features).all() or np.isinf(memory.looks).any():
        raise ValueError("its features hold NaN or infinity")
    if not ((memory.weights > 0) & np.isfinite(memory.weights)).all():
        raise ValueError("its weights are no positive numbers")
    _check_encoder(encoder, memory.features.shape[1])
    if not np.array_equal(model.classes, memory.classes.astype(str)):
        raise ValueError("its objects are not those of its touches")
    _check_calibration(model.sequence_calibration)
    _check_strangers(model.strangers, len(model.classes))
    check_number("floor_", model.floor, low=0, high=0.5)
    _check_kind("pose_", pose, PressPose | None)
    for name, sense in model.senses.items():
        _check_kind(name, sense, Modality)
        _check_calibration(sense.sequence_calibration_)


def _check_kind(name: str, part: object, kind: type | UnionType) -> None:
    if not isinstance(part, kind):
        raise TypeError(f"{name} is a {type(part).__name__}")


def _check_encoder(encoder: AnyEncoder, n_features: int) -> None:
    image_shape = tuple(encoder.image_shape_)
    radius = getattr(encoder.clean_up_, "disc_radius_", 0.0)
    check_number("disc_radius_", radius, low=0, high=min(image_shape[:2]))
    if isinstance(encoder, RemountedEncoder):
        check_number("gain", encoder.gain, low=1e-6, high=1e6)
        _check_shape("drift", encoder.drift, image_shape)
        _check_shape("broken", encoder.broken, image_shape)
        _check_shape("offset", encoder.offset, (n_features,))
        _check_shape("weighing", encoder.weighing, (n_features, n_features))
        _check_shape("look_offset", encoder.look_offset, (N_LOOKS,))
        encoder = encoder.encoder
    _check_kind("encoder_", encoder, TouchEncoder)
    _check_shape("still_", encoder.still_, image_shape)
    _check_shape("baseline_", encoder.baseline_, image_shape)


def _check_shape(name: str, array: Array | None, shape: tuple[int, ...]) -> None:
    if array is not None and array.shape != shape:
        raise ValueError(f"its {name} has shape {array.shape}, not {shape}")


def try_one_touch(belief: Belief, blank: Evidence, log_likelihood: Floats) -> None:
    """Take in a blank touch twice, so that a model that cannot work is found now.

    A blank touch may count as no contact, whose row is zeros whatever the classifier:
    so `log_likelihood` (1, n_objects) is what the classifier itself says of it.
    """
    if not np.isfinite(log_likelihood).all():
        raise ValueError("its parts do not fit together")
    for _ in range(2):
        belief.update(blank._replace(log_likelihood=log_likelihood))
    if not 0 <= belief.unknown <= 1:
        raise ValueError("its probability of a stranger is no number")
    belief.decide()
    belief.explain()


def _check_calibration(calibration: SequenceCalibration) -> None:
    _check_kind("a sequence calibration", calibration, SequenceCalibration)
    check_number("strength", calibration.strength, low=0, high=100)
    check_number("correlation", calibration.correlation, low=0, high=1)


def _check_strangers(model: StrangerModel, n_objects: int) -> None:
    _check_kind("strangers_", model, StrangerModel)
    shapes = {
        "weights": model.weights.shape[:1],
        "usual": (n_objects,),
        "far": (*model.far.shape[:1], 2),
        "high": (*model.high.shape[:1], 2),
        "exceeded": model.exceeded.shape[:1],
    }
    for name, shape in shapes.items():
        _check_table(f"{name} of its strangers_", getattr(model, name), shape)
    if not (model.weights >= 0).all():
        raise ValueError("weights of its strangers_ are below 0")
    if not ((model.far[:, 1] > 0).all() and (model.high[:, 1] > 0).all()):
        raise ValueError("far and high of its strangers_ have no spread")
    for curve in (model.low_curve, model.low_category_curve, model.high_curve):
        _check_kind("a curve of its strangers_", curve, Curve)
        n_levels = curve.levels.shape[:1]
        _check_table("a curve of its strangers_", curve.levels, n_levels)
        n_names = curve.log_ratios.shape[:1]
        shape = (*n_names, *n_levels)
        _check_table("a curve of its strangers_", curve.log_ratios, shape)
        if n_names not in ((1,), (n_objects,)):
            raise ValueError("a curve of its strangers_ is of other objects")
        if any((np.diff(v) < 0).any() for v in (curve.levels, curve.log_ratios)):
            raise ValueError("a curve of its strangers_ falls")
    check_count("n_units", model.n_units)
    if not isinstance(model.population, str):
        raise TypeError("population of its strangers_ is no text")


def _check_table(name: str, values: Array, shape: tuple[int, ...]) -> None:
    """Refuse what is no table of finite numbers of a shape."""
    if values.shape != shape or not values.size:
        raise ValueError(f"{name} is no such table")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds NaN or infinity")
