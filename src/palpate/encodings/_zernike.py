"""Zernike moments: a tactile image as weights of smooth patterns on a disc.

Turning the image only turns the phases of its complex moments, so their magnitudes
describe a touch whatever the angle of the sensor.

Conventions: positions are (row, col) in taxels with taxel centres at integers;
x points along the columns, y along the rows (downwards in a picture), and the angle
turns from x towards y.
"""

from __future__ import annotations

from functools import lru_cache
from math import hypot, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from .. import _checks
from .._checks import check_count, check_finite, check_number, check_option
from .._image_estimator import ImageEstimator
from .._types import Array, Floats, Indices
from ._zernike_tables import (
    HIGHEST_SEPARABLE_ORDER,
    Disc,
    Grid,
    noll_degrees,
    signed_degrees,
    zernike_degrees,
    zernike_moments,
)

# As far as the recurrence has been compared with exact arithmetic.
_HIGHEST_ORDER = 100


class ZernikeMoments(ImageEstimator):
    """Encode tactile images by their Zernike moments.

    Parameters
    ----------
    order : int, default=15
        Highest order n, at most 100. To 20 the encoding needs only small tables.
        Above, it needs the polynomials at a quarter of the taxels (disc in the middle
        of the frame) or at all, and is some ten or thirty times slower; where they
        exceed 256 MB they are built anew in each call: encode many touches in one.
    method : {"exact", "sample"}, default="exact"
        "exact" integrates the polynomials over each taxel's part of the disc;
        "sample" takes them at the taxel centres that lie inside, as most packages do.
    output : {"abs", "complex", "noll", "noll_abs"}, default="abs"
        "abs": magnitudes, which stay when the image turns. "complex": the moments
        themselves, as complex numbers (scikit-learn's own estimators refuse these:
        `moments.view(float)` has real and imaginary parts as columns). "noll": one
        real moment for each polynomial of Noll's list (cosines and sines apart).
        "noll_abs": their sizes, as in Corradi et al. 2014, eq. 6; not the same when
        the image turns.
    weight : {"n+1", "noll", "none"}, default="n+1"
        Factor of a moment of order n: (n + 1) / pi, the usual one; sqrt(n + 1) / pi,
        times sqrt(2) unless m = 0, Noll's orthonormal one; or 1.
    disc : {"inscribed", "circumscribed"}, default="inscribed"
        The disc touches the longer sides of the frame, or passes through its corners.
    centre : tuple of float, optional
        (row, col) of the disc's centre, in taxels; the frame's centre by default.
    radius : float, optional
        Radius of the disc, in taxels; replaces `disc`. Half a side of the frame is
        n_rows / 2, as the outer taxels reach half a taxel beyond their centres.
    drop_constant : bool, default=False
        Leave out (0, 0), which is only rounding error in standardised images.
    repeat_negative : bool, default=False
        Also give m < 0. For magnitudes this counts every m != 0 twice, as in the
        first author's code of Corradi et al. 2015. Not with Noll's list.
    precision : {"double", "single"}, default="double"
        Of the sums above order 20, where reading the basis takes the time: "single"
        takes half of it, with errors of about 1e-6 of the largest moment.

    Attributes
    ----------
    centre_ : tuple of float
        (row, col) of the disc's centre, in taxels.
    radius_ : float
        Radius of the disc, in taxels.
    indices_ : ndarray of int of shape (n_features, 2)
        (n, m) of each column: by n, then m; in the order of Noll's index for his
        list, where m < 0 means a sine.

    Notes
    -----
    With f the image and V(n, m) = R(n, m) exp(i m phi), the moment is the integral of
    f conj(V) over the unit disc times the weight. The image counts as constant over
    each taxel, and as zero where the disc reaches beyond the frame. Turning it by an
    angle a, from columns towards rows, multiplies moments by exp(-i m a).

    At a diameter of 300 taxels, magnitudes of moments of smooth images change by
    less than 1e-4 when the image turns, against 1e-3 with "sample" and 1e-2 with a
    centre that is off by half a taxel.

    References
    ----------
    .. [1] R. J. Noll, "Zernike polynomials and atmospheric turbulence",
       J. Opt. Soc. Am. 66(3), 1976. doi:10.1364/JOSA.66.000207
    .. [2] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0
    .. [3] B. H. Shakibaei, R. Paramesran, "Recursive formula to compute Zernike
       radial polynomials", Opt. Lett. 38(14), 2013. doi:10.1364/OL.38.002487

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import ZernikeMoments
    >>> touches = np.ones((2, 10, 10))
    >>> ZernikeMoments(order=2).fit_transform(touches).round(6) + 0.0
    array([[1., 0., 0., 0.],
           [1., 0., 0., 0.]])
    """

    _takes = "any"  # NaN shows in the moments, which are sooner looked through

    def __init__(
        self,
        order: int = 15,
        *,
        method: str = "exact",
        output: str = "abs",
        weight: str = "n+1",
        disc: str = "inscribed",
        centre: tuple[float, float] | None = None,
        radius: float | None = None,
        drop_constant: bool = False,
        repeat_negative: bool = False,
        precision: str = "double",
    ) -> None:
        self.order, self.method = order, method
        self.output, self.weight = output, weight
        self.disc, self.centre, self.radius = disc, centre, radius
        self.drop_constant, self.repeat_negative = drop_constant, repeat_negative
        self.precision = precision

    @property
    def blind_to(self) -> frozenset[str]:
        """Turns: magnitudes of moments in the inscribed disc."""
        magnitudes = self.output == "abs" and self.disc == "inscribed"
        return frozenset({"turns"}) if magnitudes else frozenset()

    def transform_checked(self, images: Array) -> Array:
        """Return the moments, shape (n_touches, n_features).

        Sums that are not finite are refused.
        """
        _, n_rows, n_cols = images.shape
        disc = Disc(n_rows, n_cols, *self.centre_, self.radius_)
        exact, single = self.method == "exact", self.precision == "single"
        moments = zernike_moments(images, Grid(disc, int(self.order), exact, single))
        if not np.isfinite(moments).all():
            check_finite(images)
            raise ValueError(
                "Images must have levels whose sums stay finite, got "
                f"{np.abs(images).max()}. Divide them by a constant first."
            )
        layout = self._layout()
        if self.output == "abs":
            return np.abs(moments).take(layout.columns, axis=1) * layout.weights
        weighted = moments.take(layout.columns, axis=1) * layout.weights
        negative = layout.degrees[:, 1] < 0
        if self.output == "complex":
            return np.where(negative, weighted.conj(), weighted)
        parts = np.where(negative, -weighted.imag, weighted.real)
        return parts if self.output == "noll" else np.abs(parts)

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "zernike<n>,<m>" for each column."""
        check_is_fitted(self, "image_shape_")
        return self._columns_named(f"zernike{n},{m}" for n, m in self.indices_)

    def _images(self, X: ArrayLike) -> Array:
        images = super()._images(X)
        # Beyond this order it may not show, and moments count channels as touches.
        if self.order > HIGHEST_SEPARABLE_ORDER or images.ndim > 3:
            check_finite(images)
        return images

    def _learn(self, images: Array) -> None:
        least = 1 if self.drop_constant else 0
        check_count("order", self.order, at_least=least, at_most=_HIGHEST_ORDER)
        check_option("method", self.method, ("exact", "sample"))
        check_option("output", self.output, ("abs", "complex", "noll", "noll_abs"))
        check_option("weight", self.weight, ("n+1", "noll", "none"))
        check_option("disc", self.disc, ("inscribed", "circumscribed"))
        check_option("precision", self.precision, ("double", "single"))
        if self.repeat_negative and self.output in ("noll", "noll_abs"):
            raise ValueError(
                f"repeat_negative must be False with output={self.output!r}, got "
                f"{self.repeat_negative!r}. Noll's list already has both signs of m."
            )
        check_finite(images)
        n_rows, n_cols = images.shape[1:]
        row, col = _check_centre(self.centre, n_rows, n_cols)
        inscribed = self.disc == "inscribed"
        radius = min(n_rows, n_cols) / 2 if inscribed else hypot(n_rows, n_cols) / 2
        if self.radius is not None:
            radius = _checks.check_positive("radius", self.radius)
        disc = Disc(n_rows, n_cols, row, col, radius)
        counted = disc.touches() if self.method == "exact" else disc.holds_centre()
        if not counted.any():
            raise ValueError(
                f"centre and radius must give a disc with taxels of the {n_rows} x "
                f"{n_cols} frame in it, got centre ({row}, {col}) and radius {radius}."
                " Both are in taxels, the first taxel's centre at (0, 0)."
            )
        self.centre_, self.radius_ = (row, col), radius
        self.indices_ = self._layout().degrees.copy()

    def _layout(self) -> _Layout:
        noll, skip = self.output in ("noll", "noll_abs"), bool(self.drop_constant)
        both = bool(self.repeat_negative)
        return _layout(int(self.order), noll, self.weight, skip, both)


class _Layout(NamedTuple):
    """Degrees of the columns, where they are among m >= 0, and their weights."""

    degrees: Indices
    columns: Indices
    weights: Floats


@lru_cache(maxsize=32)
def _layout(
    order: int, noll: bool, weight: str, drop_constant: bool, repeat_negative: bool
) -> _Layout:
    listed = noll_degrees if noll else zernike_degrees
    if repeat_negative:
        listed = signed_degrees
    degrees = np.array(listed(order))[int(drop_constant) :].reshape(-1, 2)
    n, m = degrees.T
    # (n + 1)**2 // 4 pairs (n, m >= 0) come before order n.
    columns = (n + 1) ** 2 // 4 + np.abs(m) // 2
    weights = {
        "n+1": (n + 1) / pi,
        "noll": np.sqrt((n + 1) * np.where(m == 0, 1, 2)) / pi,
        "none": np.ones(len(n)),
    }[weight]
    for array in (degrees, columns, weights):
        array.flags.writeable = False
    return _Layout(degrees, columns, weights)


def _check_centre(centre: object, n_rows: int, n_cols: int) -> tuple[float, float]:
    if centre is None:
        return (n_rows - 1) / 2, (n_cols - 1) / 2
    place = np.asarray(centre)
    if place.shape != (2,):
        raise ValueError(
            f"centre must be a pair (row, col) in taxels, got {centre!r}. "
            "Leave it out for the frame's centre."
        )
    row, col = place.tolist()
    return check_number("centre[0]", row), check_number("centre[1]", col)
