"""Encodings by name, several of them side by side, and the scale they share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isqrt
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin, clone
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import check_count, check_option
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from . import _principal
from ._edges_and_rings import EdgeHistograms, RingPatterns, RingQuantiles
from ._pixels import (
    PAPER_SIDE,
    GridLevels,
    PolarGradients,
    ScaledPixels,
    TaxelVector,
)
from ._principal import Components, OrientedPCA, PrincipalEncoder, ZernikePCA
from ._shape import N_MOMENTS, CentroidMoments, HuMoments, PadShapes
from ._zernike import ZernikeMoments

# Name: (encoder, parameters in which it differs from the encoder's own defaults).
ENCODINGS: dict[str, tuple[type, dict[str, Any]]] = {
    "hu": (HuMoments, {}),
    "log-hu": (HuMoments, {"log": True}),
    "zernike": (ZernikeMoments, {"drop_constant": True}),
    "zernike-noll": (ZernikeMoments, {"drop_constant": True, "output": "noll"}),
    # The sizes of Noll's moments are eq. 6 of Corradi et al. 2014.
    "zernike-noll-abs": (ZernikeMoments, {"drop_constant": True, "output": "noll_abs"}),
    "zernike-pca": (ZernikePCA, {}),
    "oriented-pca": (OrientedPCA, {}),
    "scaled-pixels": (ScaledPixels, {}),
    "centroid-moments": (CentroidMoments, {}),
    "polar-gradients": (PolarGradients, {}),
    "taxels": (TaxelVector, {}),
    "grid-levels": (GridLevels, {}),
    "edge-histograms": (EdgeHistograms, {}),
    "ring-patterns": (RingPatterns, {}),
    "ring-quantiles": (RingQuantiles, {}),
    "pad-shapes": (PadShapes, {}),
}


def encoder_named(
    name: str, n_components: Components | Iterable[Components] = None, **options: Any
) -> Any:
    """Return an unfitted encoder of images by its name.

    Parameters
    ----------
    name : str
        "hu", "log-hu", "zernike", "zernike-noll", "zernike-noll-abs", "zernike-pca",
        "oriented-pca", "scaled-pixels", "centroid-moments", "polar-gradients",
        "taxels", "grid-levels", "edge-histograms", "ring-patterns", "ring-quantiles"
        or "pad-shapes", or several joined by "+": their features side by side.
    n_components : int, float or sequence of these, optional
        How many features, or as many as there are: principal components (or the
        share of the variance), moments from the first, or pixels, of which there
        must be a square number, at most 13 x 13. None keeps the encoder's own number.
        Of a union a sequence gives one for each part (None for its default); one
        number holds for each part as far as it can: pixels are the largest square
        number below, and of a share of the variance parts without principal
        components take no notice.
    **options
        Parameters of the encoder, such as `order` of Zernike moments.

    Raises
    ------
    ValueError
        For an unknown name (the error lists the right ones), or numbers that do not
        fit the encodings.

    Examples
    --------
    >>> from palpate.encodings import encoder_named
    >>> encoder_named("hu", 4)
    HuMoments(n_components=4)
    >>> encoder_named("hu+scaled-pixels", 4)
    EncodingUnion(encoders=[HuMoments(n_components=4), ScaledPixels(side=2)])
    >>> encoder_named("hu+zernike-pca", (7, 0.9)).encoders[1]
    ZernikePCA(n_components=0.9)
    """
    parts = [part.strip() for part in str(name).split("+")]
    for part in parts:
        if part not in ENCODINGS:
            raise ValueError(
                f"name must be one of {', '.join(map(repr, ENCODINGS))}, or several "
                f"joined by '+', got {name!r}."
            )
    counts = _counts_of(parts, n_components)
    encoders = [_make(*chosen, options) for chosen in zip(parts, counts, strict=True)]
    return encoders[0] if len(encoders) == 1 else EncodingUnion(encoders)


def _counts_of(
    parts: list[str], n_components: Components | Iterable[Components]
) -> list[Components]:
    if isinstance(n_components, Iterable):
        counts = list(n_components)
        if len(counts) != len(parts):
            raise ValueError(
                f"n_components must hold one number for each of {'+'.join(parts)}, "
                f"got {len(counts)}: {counts}. Use None for a part's default."
            )
        return counts
    if len(parts) == 1:
        return [n_components]
    count = _principal.check_components(n_components)
    counts = [count] * len(parts)
    for i, part in enumerate(parts):
        principal = issubclass(ENCODINGS[part][0], PrincipalEncoder)
        if isinstance(count, float) and not principal:
            counts[i] = None
        elif isinstance(count, int) and part == "scaled-pixels":
            counts[i] = isqrt(count) ** 2
    return counts


def _make(part: str, n_components: Components, options: dict[str, Any]) -> Any:
    kind, defaults = ENCODINGS[part]
    chosen = {**defaults, **options}
    if n_components is None:
        return kind(**chosen)
    if issubclass(kind, PrincipalEncoder):
        return kind(n_components, **chosen)
    count = check_count("n_components", n_components)
    if kind is HuMoments:
        return HuMoments(min(count, N_MOMENTS), **chosen)
    if kind is ScaledPixels:
        side = isqrt(count)
        if side * side != count and side < PAPER_SIDE:
            raise ValueError(
                "n_components must be a square number for scaled pixels, got "
                f"{count}. Use {side * side} or {(side + 1) ** 2}."
            )
        return ScaledPixels(min(side, PAPER_SIDE), **chosen)
    first = FunctionTransformer(_first, kw_args={"n": count})
    return make_pipeline(kind(**chosen), first.set_output(transform="default"))


def _first(features: ArrayLike, n: int) -> Floats:
    return np.asarray(features)[:, :n]


class EncodingUnion(ImageEstimator, by_channel=False):
    """Encode images by several encoders and join the vectors.

    Parameters
    ----------
    encoders : sequence of estimators
        Encoders of images; their features, real numbers, follow each other in this
        order.
    balanced : bool, default=False
        Bring each encoder's features to signed roots of total variance 1
        (`RootScaler`), so that many features of one do not outweigh few of another.

    Attributes
    ----------
    encoders_ : list of fitted estimators
        One per encoder.
    scalers_ : list of RootScaler
        One per encoder where they are balanced, else none.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import EncodingUnion, FourierDescriptors, ShapeGeometry
    >>> both = EncodingUnion([ShapeGeometry(), FourierDescriptors(n=5)])
    >>> square = np.pad(np.ones((4, 4)), 2)
    >>> both.fit_transform(square[np.newaxis]).shape
    (1, 7)
    """

    _takes = "any"  # which levels are too large, each encoder says itself

    def __init__(self, encoders: Sequence[Any], balanced: bool = False) -> None:
        self.encoders = encoders
        self.balanced = balanced

    @property
    def blind_to(self) -> frozenset[str]:
        """The changes that all of its encoders are blind to."""
        nothing: frozenset[str] = frozenset()
        each = [getattr(part, "blind_to", nothing) for part in self.encoders]
        return frozenset.intersection(*each) if each else nothing

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit every encoder to the images; `y` is passed on."""
        self.fit_transform(X, y)
        return self

    def fit_transform(self, X: ArrayLike, y: object = None, **fixed: Any) -> Floats:
        """Fit every encoder and return the joined vectors of the same images."""
        images = self._checked(X)
        encoders = _check_encoders(self.encoders)
        check_option("balanced", self.balanced, (False, True))
        self.encoders_ = [clone(encoder) for encoder in encoders]
        parts = [encoder.fit_transform(images, y) for encoder in self.encoders_]
        for encoder, part in zip(self.encoders_, parts, strict=True):
            if np.iscomplexobj(part):
                raise ValueError(
                    "encoders must give real features, got complex ones of "
                    f"{encoder!r}. Choose a real output, such as 'abs' or 'noll'."
                )
        self.scalers_ = []
        if self.balanced:
            self.scalers_ = [RootScaler().fit(part) for part in parts]
        self.image_shape_ = images.shape[1:]
        return self._joined(parts)

    def transform_checked(self, images: Array) -> Floats:
        """Return the joined vectors, shape (n_touches, n_features)."""
        parts = []
        for encoder in self.encoders_:
            is_ours = isinstance(encoder, ImageEstimator)
            encode = encoder.transform_checked if is_ours else encoder.transform
            parts.append(encode(images))
        return self._joined(parts)

    def _joined(self, parts: list[Array]) -> Floats:
        return np.hstack([*map(RootScaler.scale, self.scalers_, parts)] or parts)

    def _images(self, X: ArrayLike) -> Array:
        images = super()._images(X)
        for encoder in self.encoders_:
            if isinstance(encoder, ImageEstimator):
                encoder._images(images)
        return images


def _check_encoders(encoders: object) -> list[Any]:
    if isinstance(encoders, str) or not isinstance(encoders, Iterable):
        raise TypeError(
            f"encoders must be a list of encoders, got {encoders!r}. For encodings by "
            "name use encoder_named('hu+zernike')."
        )
    listed = list(encoders)
    if not listed:
        raise ValueError("encoders must hold at least one encoder, got none.")
    methods = ("fit", "transform", "get_params")
    for encoder in listed:
        if isinstance(encoder, type) or not all(hasattr(encoder, m) for m in methods):
            raise TypeError(
                f"encoders must be made of encoders of images, got {encoder!r}. Pass "
                "one such as HuMoments(), or make it by encoder_named('hu')."
            )
    return listed


class RootScaler(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):
    """Signed square root of each feature, then mean 0 and total variance 1.

    Moments of a press differ by orders of magnitude between faint and strong
    contacts; the root brings them closer before a distance is taken. All
    features have equal variance afterwards, and the sum over features is one, so
    that blocks of features of different length weigh the same side by side.
    Features that never change in training become 0.

    Attributes
    ----------
    mean_, scale_ : ndarray of shape (n_features,)
        Mean and divisor of each feature's root.

    Examples
    --------
    >>> from palpate.encodings import RootScaler
    >>> RootScaler().fit_transform([[0.0, 1.0], [4.0, 1.0]])
    array([[-0.70710678,  0.        ],
           [ 0.70710678,  0.        ]])
    """

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn mean and spread of the roots; `y` is ignored."""
        features = validate_data(self, X, dtype=np.float64)
        roots = np.copysign(np.sqrt(np.abs(features)), features)
        self.mean_ = roots.mean(axis=0)
        spread = roots.std(axis=0)
        constant = spread <= 1e-9 * np.abs(roots).max(axis=0)
        root_of_count = np.sqrt(roots.shape[1])
        self.scale_ = np.where(constant, np.inf, spread * root_of_count)
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Return the scaled roots, shape (n_touches, n_features)."""
        check_is_fitted(self)
        features = validate_data(self, X, dtype=np.float64, reset=False)
        return self.scale(features)

    def scale(self, features: Floats) -> Floats:
        """Do what `transform` does, without its checks."""
        roots: Floats = np.abs(features)
        np.sqrt(roots, out=roots)
        np.copysign(roots, features, out=roots)
        roots -= self.mean_
        roots /= self.scale_
        return roots
