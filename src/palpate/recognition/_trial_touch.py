"""A model that was read is tried on a blank touch before anyone relies on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._checks import check_number, check_option
from ..images import PressPose
from ..touches import Touches
from ._modality import Modality
from ._presets import find_preset
from ._sequence import SequenceCalibration
from ._unknown import UnknownScale

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

MAX_PIXELS = 50_000_000


def try_one_touch(recogniser: ObjectRecogniser) -> None:
    """Recognise blank touches, so that a model that cannot work is found now."""
    _check_kept(recogniser)
    _check_trust(recogniser.sequence_calibration_)
    _check_scale(recogniser.unknown_scale_, len(recogniser.classes_))
    _check_others(recogniser)
    blank = Touches(np.zeros((1, *recogniser.encoder_.image_shape_)))
    evidence = recogniser.evidence(blank)
    # A blank touch may count as no contact, whose row is zeros whatever the classifier.
    row = recogniser.feature_log_likelihood(evidence.features)
    if row.shape != (1, len(recogniser.classes_)) or not np.isfinite(row).all():
        raise ValueError("its parts do not fit together")
    belief = recogniser.start()
    for _ in range(2):
        belief.update_from_log_likelihood(
            row, features=evidence.features, novelty=evidence.novelty
        )
    if abs(sum(belief.posterior.values()) - 1) > 1e-6:
        raise ValueError("its belief does not sum to one")
    if not 0 <= belief.unknown <= 1:
        raise ValueError("its unknown score is no number")
    belief.decide()
    belief.explain()


def _check_kept(recogniser: ObjectRecogniser) -> None:
    n_rows, n_cols = recogniser.encoder_.image_shape_
    kept = (
        recogniser.features_,
        recogniser.labels_,
        recogniser.objects_,
        recogniser.nothing_,
        recogniser.unexplained_,
    )
    rows = {len(array) for array in kept}
    if not (0 < n_rows * n_cols <= MAX_PIXELS and rows == {len(recogniser.blocks_)}):
        raise ValueError("its sizes do not agree")
    if not np.isfinite(recogniser.features_).all():
        raise ValueError("its features hold NaN or infinity")


def _check_trust(trust: object) -> None:
    if not isinstance(trust, SequenceCalibration):
        raise TypeError(f"trust is a {type(trust).__name__}")
    check_number("strength", trust.strength, low=0, high=100)
    check_number("correlation", trust.correlation, low=0, high=1)


def _check_scale(scale: object, n_objects: int) -> None:
    if not isinstance(scale, UnknownScale):
        raise TypeError(f"unknown_scale_ is a {type(scale).__name__}")
    n = len(scale.lengths)
    shapes = {
        "usual": (n_objects,),
        "spread": (n_objects,),
        "mean": (n, 3),
        "deviation": (n, 3),
        "together": (n,),
        "limits": (n, scale.limits.shape[-1]),
        "levels": (scale.limits.shape[-1],),
    }
    for name, shape in shapes.items():
        values = getattr(scale, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(f"{name} of its unknown scale is no such table")


def _check_others(recogniser: ObjectRecogniser) -> None:
    find_preset(recogniser.preset)
    check_option("label", recogniser.label, ("object", "category"))
    check_option("prior", recogniser.prior, ("uniform", "counts"))
    check_number("floor_", recogniser.floor_, low=0, high=0.5)
    if not isinstance(recogniser.pose_, PressPose | None):
        raise TypeError(f"pose_ is a {type(recogniser.pose_).__name__}")
    for name, sense in recogniser.modalities_.items():
        if not isinstance(sense, Modality):
            raise TypeError(f"{name} is a {type(sense).__name__}")
        _check_trust(sense.sequence_calibration_)
