"""Argument checks shared by the whole package; each error names the fix.

Only numpy is imported here, so that `import palpate` stays cheap.
"""

import unicodedata
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from numbers import Integral, Number, Real
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._types import Floats, Indices

# Squares of larger numbers, and sums of them, leave double precision; sums of a few
# larger levels leave single precision.
LARGEST_TO_SQUARE = 1e150
LARGEST_LEVEL = 1e37
# An image of a longer side is a camera's, made of pixels; others are of an array.
ARRAY_SIDE = 48
# Text and whole numbers, which are labels without scikit-learn looking at each.
PLAIN_LABELS = "biuSU"
# The share of episodes with something that was never learnt, unless the user says.
STRANGERS = 0.05


# Line breaks, and what a terminal would obey: control characters.
_NOT_PRINTED = ("Cc", "Cs", "Zl", "Zp")


def one_spelling(text: str) -> str | None:
    """Return a name in its one spelling (NFC), or None where it cannot be printed."""
    if any(unicodedata.category(letter) in _NOT_PRINTED for letter in text):
        return None
    return unicodedata.normalize("NFC", text)


def nearest_path(path: Path) -> str:
    """Return "Did you mean ...?" for a path that is not there, or nothing."""
    try:
        names = {entry.name: entry for entry in path.parent.iterdir()}
    except OSError:
        return nearest_path(path.parent) if path.parent != path.parent.parent else ""
    folded = {name.casefold(): name for name in names}
    close = get_close_matches(path.name.casefold(), folded, n=1, cutoff=0.6)
    if path.name in names or not close:
        return ""
    near = names[folded[close[0]]]
    return f"Did you mean {near}{'/' * near.is_dir()}?"


def check_count(
    name: str, value: object, *, at_least: int = 1, at_most: int | None = None
) -> int:
    """Return `value` as an int, or say what `name` should have been."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {type(value).__name__}.")
    if value < at_least:
        raise ValueError(f"{name} must be at least {at_least}, got {value}.")
    if at_most is not None and int(value) > at_most:
        raise ValueError(f"{name} must be at most {at_most}, got {value}.")
    return int(value)


def check_number(
    name: str, value: object, *, low: float = -np.inf, high: float = np.inf
) -> float:
    """Return `value` as a finite float within [low, high], or explain."""
    number = _as_float(name, value)
    if not (np.isfinite(number) and low <= number <= high):
        raise ValueError(
            f"{name} must be finite and between {low} and {high}, got {value}."
        )
    return number


def check_positive(name: str, value: object) -> float:
    """Return `value` as a float, or say what `name` should have been."""
    number = _as_float(name, value)
    if not 0 < number < float("inf"):
        raise ValueError(f"{name} must be positive and finite, got {value}.")
    return number


def check_strangers(strangers: object) -> float:
    """Return the share of strangers, at least 0 and below 1, or explain."""
    share = check_number("strangers", strangers, low=0, high=1)
    if share == 1:
        raise ValueError(
            "strangers must be below 1, got 1: then nothing could ever be named. Give "
            "the share of episodes with something that was never learnt."
        )
    return share


def _as_float(name: str, value: Any) -> float:
    """Return a number as a float, infinite where none is as large, or explain."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number:
        raise TypeError(f"{name} must be a number, got {type(value).__name__}.")
    try:
        return float(value)
    except OverflowError:
        return float(np.inf if value > 0 else -np.inf)


def check_option(name: str, value: object, options: Iterable[object]) -> Any:
    """Return `value` when it is one of `options`; the error lists them."""
    valid = list(options)
    if not any(value is option or value == option for option in valid):
        listed = ", ".join(map(repr, valid))
        near = did_you_mean(value, valid)
        raise ValueError(f"{name} must be one of {listed}, got {value!r}.{near}")
    return value


def did_you_mean(name: object, names: Iterable[object]) -> str:
    """Return " Did you mean 'mug'?" where one of some names is nearly this one."""
    named = {str(each).casefold(): each for each in names}
    near = get_close_matches(str(name).casefold(), named, 1)
    return f" Did you mean {named[near[0]]!r}?" if near else ""


def is_plain(X: object, n_axes: int) -> TypeGuard[Floats]:
    """Whether `X` is a finite float64 array of so many axes, with something in it.

    Told in a tenth of the time that scikit-learn's checks take, which counts for single
    touches and small problems.
    """
    return (
        type(X) is np.ndarray
        and X.dtype == np.float64
        and X.ndim == n_axes
        and X.size > 0
        and bool(np.isfinite(X).all())
    )


def listed(names: Sequence[str], most: int) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def size_text(shape: Sequence[int]) -> str:
    """Return how large an image is, for people: "480 x 640 pixels"."""
    cells = "pixels" if max(shape[:2]) > ARRAY_SIDE else "taxels"
    return f"{' x '.join(map(str, shape))} {cells}"


def check_images(
    X: ArrayLike,
    *,
    shape: tuple[int, ...] | None = None,
    allow_nan: bool = False,
) -> NDArray[np.float64]:
    """Return `X` as float images (n_touches, n_rows, n_cols), or explain.

    With `shape`, also insist on the image size the encoder was fitted on; NaN
    marks a dead taxel and is refused unless `allow_nan`.
    """
    images = check_image_shape(X, shape=shape)
    return check_finite(images.astype(np.float64, copy=False), allow_nan=allow_nan)


def unmasked(name: str, value: Any) -> Any:
    """Return a masked array with NaN for what is masked, or explain; all else as is."""
    if not isinstance(value, np.ma.MaskedArray):
        return value
    n_masked = int(np.ma.getmaskarray(value).sum())
    if not n_masked:
        return value.data
    if value.dtype.kind != "f":
        raise ValueError(
            f"{name} must have no masked values of {value.dtype}, got {n_masked}. Make "
            "it .astype(float), where what is masked is read as NaN, or fill it with "
            ".filled(value)."
        )
    return value.filled(np.nan)


def as_array(name: str, value: Any, what: str = "one array") -> NDArray[Any]:
    """Return a value as an array, NaN for what is masked, or say what it must be."""
    values = unmasked(name.lower(), value)
    try:
        return np.asarray(values)
    except ValueError as error:
        raise ValueError(
            f"{name} must be {what}, got lists of unequal lengths. Bring all touches "
            "to the same rows and columns."
        ) from error


def check_finite(images: NDArray[Any], *, allow_nan: bool = False) -> NDArray[Any]:
    """Return images that are finite (or NaN, if `allow_nan`), or explain."""
    if images.dtype.kind != "f" or np.isfinite(images).all():
        return images
    bad = np.isinf(images) if allow_nan else ~np.isfinite(images)
    touches = np.flatnonzero(bad.any(axis=tuple(range(1, bad.ndim))))
    if len(touches):
        fix = "" if allow_nan else " Fill dead taxels (NaN) first."
        raise ValueError(
            f"Images must be finite, got NaN or infinity in touch {touches[0]}"
            f" ({len(touches)} of {len(images)} touches).{fix}"
        )
    return images


def check_image_shape(
    X: ArrayLike, *, shape: tuple[int, ...] | None = None, channels: bool = False
) -> NDArray[Any]:
    """Return `X` as real images of its own type, of `shape` if given, or explain."""
    images = as_array("Images", X, "one array of shape (n_touches, n_rows, n_cols)")
    if images.dtype.kind not in "biuf":
        raise TypeError(f"Images must be numbers, got an array of {images.dtype}.")
    if images.ndim not in ((3, 4) if channels else (3,)):
        hints = {2: " For one touch pass X[np.newaxis]."}
        if not channels:
            hints[4] = " Pass one channel, X[..., 0], or their mean, X.mean(axis=-1)."
        raise ValueError(
            "Expected images of shape (n_touches, n_rows, n_cols), "
            f"got an array of shape {images.shape}.{hints.get(images.ndim, '')}"
        )
    if 0 in images.shape:
        raise ValueError(f"Expected at least one touch, got shape {images.shape}.")
    if shape is not None and images.shape[1:] != shape:
        raise ValueError(
            f"Images have {size_text(images.shape[1:])}, but the encoder was fitted on "
            f"{' x '.join(map(str, shape))}; resize them or fit again."
        )
    return images


def check_levels(images: NDArray[Any]) -> NDArray[Any]:
    """Return `images` if single precision holds sums of their levels, or explain."""
    if images.dtype.kind != "f":
        return images
    # As floats: half precision does not hold the limit.
    if max(float(images.max()), -float(images.min())) > LARGEST_LEVEL:
        size = np.abs(images).max(axis=tuple(range(1, images.ndim)))
        touch = int(np.argmax(size > LARGEST_LEVEL))
        raise ValueError(
            f"Images must have levels of at most {LARGEST_LEVEL:g} in size, got "
            f"{size[touch]:.3g} in touch {touch}. Divide all images by one number."
        )
    return images


def check_squarable(X: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return features if sums of their squares are finite, or explain."""
    largest = float(max(X.max(initial=0), -X.min(initial=0)))
    if largest > LARGEST_TO_SQUARE:
        raise ValueError(
            f"X must be at most {LARGEST_TO_SQUARE:g} in size, since distances "
            f"are squared, got {largest:.3g}. Scale the features first."
        )
    return X


def check_width(sigma: object) -> float:
    """Return a kernel's width whose square is an ordinary number, or explain."""
    width = check_positive("sigma", sigma)
    if not 1 / LARGEST_TO_SQUARE <= width <= LARGEST_TO_SQUARE:
        raise ValueError(
            f"sigma must be between {1 / LARGEST_TO_SQUARE:g} and "
            f"{LARGEST_TO_SQUARE:g}, since it is squared, got {sigma}. Choose one near "
            "the distances between touches."
        )
    return width


def check_label_kinds(y: ArrayLike, name: str = "y") -> None:
    """Refuse labels of several kinds, which have no order, and masked ones."""
    if isinstance(y, np.ma.MaskedArray) and (n_masked := int(y.mask.sum())):
        raise ValueError(
            f"{name} must have no masked labels, got {n_masked}. Leave out touches "
            "without a label."
        )
    if isinstance(y, list | tuple):
        listed = list(y)
    else:
        labels = np.asarray(y)
        listed = labels.ravel().tolist() if labels.dtype.kind == "O" else []
    first: dict[str, object] = {}
    for label in listed:
        first.setdefault(_label_kind(label), label)
    if len(first) > 1:
        shown = ", ".join(map(repr, first.values()))
        raise TypeError(
            f"{name} must hold labels of one kind, got {' and '.join(first)}: {shown}. "
            "Make all of them text, and leave out touches without a label."
        )


def check_targets(labels: NDArray[Any]) -> None:
    """Refuse labels (n_touches,) that are no classes, as scikit-learn does."""
    if labels.dtype.kind not in PLAIN_LABELS:
        from sklearn.utils.multiclass import check_classification_targets

        check_classification_targets(labels)


def as_groups(groups: ArrayLike | None, n_touches: int) -> Indices:
    """Return the number of each training touch's group; by default its own."""
    if groups is None:
        return np.arange(n_touches)
    check_label_kinds(groups, "groups")
    numbers = one_each("groups", groups, n_touches)
    return np.asarray(np.unique(numbers, return_inverse=True)[1])


def one_each(
    name: str, values: ArrayLike, n: int, things: str = "touches"
) -> NDArray[Any]:
    """Return values as an array (n,), one for each of some things, or explain."""
    array = np.asarray(values)
    if array.shape != (n,):
        raise ValueError(
            f"{name} must have one entry for each of {n} {things}, got shape "
            f"{array.shape}."
        )
    return array


def _label_kind(label: object) -> str:
    if isinstance(label, str):
        return "text"
    if isinstance(label, Number | np.bool_):
        return "numbers"
    return type(label).__name__
