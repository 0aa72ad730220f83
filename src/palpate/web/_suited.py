"""Whether an image from outside is one that the sensor could have given."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
