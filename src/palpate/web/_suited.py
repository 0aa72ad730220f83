"""Whether images, sensor and model suit one another."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recognition import ObjectRecogniser
from ..sensors import LiveSensor


def suited(
    image: NDArray[Any], shape: Sequence[int], dtype: np.dtype[Any] | None
) -> NDArray[Any]:
    """Return an image of the right size as the right type, or explain.

    Raises
    ------
    ValueError
        It has another size, or values that the type cannot hold.
    """
    if image.shape != tuple(shape):
        got = " x ".join(map(str, image.shape))
        raise ValueError(
            f"The image must have {shape[0]} x {shape[1]} taxels, got {got}."
        )
    if dtype is None or dtype == image.dtype:
        return image
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        whole = bool(np.isfinite(image).all() and (np.rint(image) == image).all())
        if not whole or image.min() < limits.min or image.max() > limits.max:
            raise ValueError(
                f"The image must hold whole numbers from {limits.min} to "
                f"{limits.max}, as the touches before it do."
            )
    return image.astype(dtype)


def suited_to(
    image: NDArray[Any],
    sensor: LiveSensor | None,
    stored: tuple[tuple[int, int], np.dtype[Any]] | None,
    recogniser: ObjectRecogniser | None,
) -> NDArray[Any]:
    """Return an image as the sensor gives them, else as the newest stored touch is.

    Raises
    ------
    ValueError
        It has another size, or values that those cannot hold.
    """
    if sensor is not None:
        return suited(image, sensor.image_shape, sensor.dtype)
    if stored is not None:
        return suited(image, *stored)
    if recogniser is not None:
        return suited(image, recogniser.encoder_.image_shape_, None)
    return image


def misfit(recogniser: ObjectRecogniser | None, sensor: LiveSensor | None) -> str:
    """Return why a model cannot recognise a sensor's touches, or nothing."""
    if recogniser is None or sensor is None:
        return ""
    learnt, given = recogniser.encoder_.image_shape_, sensor.image_shape
    if tuple(learnt) == tuple(given):
        return ""
    return (
        f"The model must be of images of {given[0]} x {given[1]} taxels, which "
        f"{sensor.name} gives, got one of {learnt[0]} x {learnt[1]}. Learn from "
        "touches of this sensor, or start with the sensor that the model learnt from."
    )


def model_state(
    recogniser: ObjectRecogniser | None, file: Path | None
) -> dict[str, Any] | None:
    """Return what a page tells of a model, as plain values."""
    if recogniser is None:
        return None
    return {
        "objects": recogniser.classes_.tolist(),
        "n_touches": len(recogniser.memory_),
        "encoding": str(recogniser.chosen_.get("encoding", "")),
        "file": str(file),
    }
