"""Touches for PyTorch: what a `DataLoader` takes, whole sets or pieces of a library.

Nothing of torch is imported before the first touch is asked for
(`pip install "palpate[cnn]"`).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ._checks import check_option
from ._extras import needed
from ._types import Indices
from .touches import Touches, TouchSource

__all__ = ["TouchDataset"]
_LABELS = ("object", "category", "session", "subject")


class TouchDataset:
    """Pairs of image and number of label, for `torch.utils.data.DataLoader`.

    Parameters
    ----------
    touches : Touches or selection of a library
        Of a library, images are read a batch at a time.
    label : {"object", "category", "session", "subject"}, default="object"
        What the numbers stand for.
    classes : sequence of str, optional
        Labels in the order of their numbers; by default those that occur, sorted. Give
        those of the training set with the test set.
    transform : callable, optional
        Takes an image as a float32 tensor (n_channels, n_rows, n_cols) and returns what
        is used in its place.

    Attributes
    ----------
    classes : list of str
        Labels; a number is a place in it.
    targets : ndarray of int of shape (n_touches,)
        The number of each touch.

    Raises
    ------
    ValueError
        The touches have no such labels, or one that `classes` do not hold.

    Notes
    -----
    Images have the unit of the sensor, NaN for dead taxels included. Shuffled batches
    of a library are read in the order of its rows.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.torch import TouchDataset
    >>> touches = Touches(np.ones((2, 10, 10)), object=["pen", "cup"])
    >>> TouchDataset(touches).targets
    array([1, 0])
    """

    def __init__(
        self,
        touches: Touches | TouchSource,
        label: str = "object",
        *,
        classes: Sequence[str] | None = None,
        transform: Callable[[Any], Any] | None = None,
    ) -> None:
        check_option("label", label, _LABELS)
        labels = getattr(touches, label)
        if labels is None:
            raise ValueError(
                f"touches must have the label {label}, got touches without. Give it: "
                f"touches.with_columns({label}=...)."
            )
        texts = np.asarray(labels).astype(np.str_)
        self.classes = np.unique(texts).tolist() if classes is None else [*classes]
        numbers = {name: number for number, name in enumerate(self.classes)}
        if missing := sorted({*texts.tolist()} - {*numbers}):
            raise ValueError(
                f"classes must hold every {label}, got none for {missing[0]!r}. Add "
                "it, or leave its touches out."
            )
        self.targets: Indices = np.array([numbers[t] for t in texts.tolist()], np.intp)
        self.transform = transform
        self._touches = touches

    def __len__(self) -> int:
        return len(self.targets)

    def __getitem__(self, index: int) -> tuple[Any, int]:
        """Return one image, a float32 tensor with channels first, and its number."""
        return self.__getitems__([index])[0]

    def __getitems__(self, rows: Sequence[int]) -> list[tuple[Any, int]]:
        """Return the pairs of a batch, whose images are read at once."""
        n_touches = len(self)
        wanted = np.array(rows, dtype=np.intp)
        if ((wanted < -n_touches) | (wanted >= n_touches)).any():
            raise IndexError(f"rows must be below {n_touches}, got {wanted.tolist()}.")
        rising, places = np.unique(wanted % n_touches, return_inverse=True)
        if isinstance(self._touches, Touches):
            images = self._touches.images[rising]
        else:
            images = self._touches.touches(rising).images
        planes = images[:, None] if images.ndim == 3 else np.moveaxis(images, 3, 1)
        torch = needed("torch", "cnn", "A dataset for PyTorch")
        tensors = torch.from_numpy(np.array(planes, dtype=np.float32, order="C"))
        if self.transform is not None:
            tensors = [self.transform(tensor) for tensor in tensors]
        return [
            (tensors[place], int(self.targets[rising[place]]))
            for place in places.tolist()
        ]
