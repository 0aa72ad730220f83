"""Encodings by name: one table, so that a study or a user can swap them."""

from collections.abc import Callable, Iterable
from math import isqrt
from typing import Any, NamedTuple

from .._checks import check_count
from ._first_features import FirstFeatures
from ._hu import N_MOMENTS, HuMoments
from ._moments import CentroidMoments
from ._oriented_pca import OrientedPCA
from ._polar_gradients import PolarGradients
from ._principal import Components, check_components
from ._scaled_pixels import PAPER_SIDE, ScaledPixels
from ._taxel_vector import TaxelVector
from ._union import EncodingUnion
from ._zernike import ZernikeMoments
from ._zernike_pca import ZernikePCA


class Encoding(NamedTuple):
    """An encoding's summary, and what makes its encoder.

    `make(n_components, **options)` returns an unfitted encoder of images.
    """

    summary: str
    make: Callable[..., Any]


def encoder_named(
    name: str,
    n_components: Components | Iterable[Components] = None,
    **options: Any,
) -> Any:
    """Return an unfitted encoder of images by its name.

    Parameters
    ----------
    name : str
        One of `ENCODINGS`, or several joined by "+": their features side by side.
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
    chosen = zip(parts, counts, strict=True)
    made = [ENCODINGS[part].make(count, **options) for part, count in chosen]
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
    return [_as_far_as_it_can(part, known) for part in parts]


def _as_far_as_it_can(part: str, n_components: Components) -> Components:
    if isinstance(n_components, float) and part not in _WITH_SHARES:
        return None
    if isinstance(n_components, int) and part == "scaled-pixels":
        return isqrt(n_components) ** 2
    return n_components


def _hu(n_components: Components, **options: Any) -> HuMoments:
    kept = N_MOMENTS if n_components is None else _count(n_components)
    return HuMoments(min(kept, N_MOMENTS), **options)


def _log_hu(n_components: Components, **options: Any) -> HuMoments:
    return _hu(n_components, log=True, **options)


def _zernike(n_components: Components, **options: Any) -> Any:
    moments = ZernikeMoments(**{"drop_constant": True, **options})
    if n_components is None:
        return moments
    return FirstFeatures(moments, _count(n_components))


def _noll(n_components: Components, **options: Any) -> Any:
    return _zernike(n_components, output="noll", **options)


def _noll_sizes(n_components: Components, **options: Any) -> Any:
    return _zernike(n_components, output="noll_abs", **options)


def _zernike_pca(n_components: Components, **options: Any) -> ZernikePCA:
    return ZernikePCA(0.95 if n_components is None else n_components, **options)


def _oriented_pca(n_components: Components, **options: Any) -> OrientedPCA:
    return OrientedPCA(0.95 if n_components is None else n_components, **options)


def _scaled_pixels(n_components: Components, **options: Any) -> ScaledPixels:
    if n_components is None:
        return ScaledPixels(**{"side": PAPER_SIDE, **options})
    count = _count(n_components)
    side = isqrt(count)
    if side * side != count and side < PAPER_SIDE:
        raise ValueError(
            "n_components must be a square number for scaled pixels, got "
            f"{count}. Use {side * side} or {(side + 1) ** 2}."
        )
    return ScaledPixels(min(side, PAPER_SIDE), **options)


def _centroid_moments(n_components: Components, **options: Any) -> Any:
    moments = CentroidMoments(**options)
    if n_components is None:
        return moments
    return FirstFeatures(moments, _count(n_components))


def _polar_gradients(n_components: Components, **options: Any) -> Any:
    gradients = PolarGradients(**options)
    if n_components is None:
        return gradients
    return FirstFeatures(gradients, _count(n_components))


def _taxels(n_components: Components, **options: Any) -> Any:
    if n_components is None:
        return TaxelVector(**options)
    return FirstFeatures(TaxelVector(**options), _count(n_components))


def _count(n_components: Components) -> int:
    return check_count("n_components", n_components)


# Of these a share of the variance may be asked.
_WITH_SHARES = ("zernike-pca", "oriented-pca")

ENCODINGS: dict[str, Encoding] = {
    "hu": Encoding("Hu's seven moments", _hu),
    "log-hu": Encoding("signed logarithms of Hu's moments", _log_hu),
    "zernike": Encoding("magnitudes of Zernike moments", _zernike),
    "zernike-noll": Encoding("real Zernike moments in Noll's order", _noll),
    "zernike-noll-abs": Encoding("their sizes, Corradi 2014 eq. 6", _noll_sizes),
    "zernike-pca": Encoding("principal components of Zernike moments", _zernike_pca),
    "oriented-pca": Encoding("principal components of turned images", _oriented_pca),
    "scaled-pixels": Encoding("turned image averaged to few pixels", _scaled_pixels),
    "centroid-moments": Encoding("moments about the centroid", _centroid_moments),
    "polar-gradients": Encoding("harmonics of gradients on rings", _polar_gradients),
    "taxels": Encoding("every taxel as it is", _taxels),
}
