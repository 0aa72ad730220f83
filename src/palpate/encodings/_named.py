"""Encodings by name: one table, so that a study or a user can swap them."""

from __future__ import annotations

from collections.abc import Iterable
from math import isqrt
from typing import Any

from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from .._checks import check_count
from .._types import Floats
from ._edge_histograms import EdgeHistograms
from ._hu import N_MOMENTS, HuMoments
from ._moments import CentroidMoments
from ._pad_shapes import PadShapes
from ._pixels import PAPER_SIDE, GridLevels, ScaledPixels, TaxelVector
from ._polar_gradients import PolarGradients
from ._principal import (
    Components,
    OrientedPCA,
    PrincipalEncoder,
    ZernikePCA,
    check_components,
)
from ._rings import RingPatterns, RingQuantiles
from ._union import EncodingUnion
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
        must be a square number, at most 13 x 13. By default what the encoder itself
        does. Of a union a sequence gives one for each part (None for its default); one
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
    made = [_make(*chosen, options) for chosen in zip(parts, counts, strict=True)]
    return made[0] if len(made) == 1 else EncodingUnion(made)


def _counts_of(
    parts: list[str], n_components: Components | Iterable[Components]
) -> list[Components]:
    """Return the number of components of each part of a union."""
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
    known = check_components(n_components)
    counts = [known] * len(parts)
    for i, part in enumerate(parts):
        principal = issubclass(ENCODINGS[part][0], PrincipalEncoder)
        if isinstance(known, float) and not principal:
            counts[i] = None
        elif isinstance(known, int) and part == "scaled-pixels":
            counts[i] = isqrt(known) ** 2
    return counts


def _make(part: str, n_components: Components, options: dict[str, Any]) -> Any:
    """Return the encoder of one name with that many features."""
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
    return make_pipeline(
        kind(**chosen), FunctionTransformer(_first, kw_args={"n": count})
    )


def _first(features: Floats, n: int) -> Floats:
    return features[:, :n]
