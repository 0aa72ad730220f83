"""Presets: named recipes from image to log-likelihood, in one table."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sklearn.decomposition import PCA
from sklearn.preprocessing import StandardScaler

from .._checks import check_option
from ..classifiers import (
    MKLSVC,
    FromProbabilities,
    KernelDensityBayes,
    KernelRidgeClassifier,
    TouchClassifier,
)
from ..encodings import (
    CentroidMoments,
    EncodingUnion,
    FourierDescriptors,
    KernelPCA,
    PolarGradients,
    PrincipalShare,
    RootScaler,
    ShapeGeometry,
    TaxelVector,
    ZernikeMoments,
)
from ..images import ArrayCleanUp, DomeCrop
from ..touches import Touches
from ._encoder import TouchEncoder, find_geometry

# With fewer taxels on a side, gradients along rings have too few places.
FINE_TAXELS = 24


@dataclass(frozen=True)
class Preset:
    """A recipe for a recogniser, with a `summary` for people.

    `encoders` gives unfitted encoders by name, of which the best is chosen on altered
    validation touches; `classifier` an unfitted classifier; `floor` is the least
    probability that one touch leaves to all objects together. It may calibrate how
    touches add up, and skip those that look like the no-contact frame.
    """

    summary: str
    encoders: Callable[[Touches], dict[str, TouchEncoder]]
    classifier: Callable[[], TouchClassifier]
    floor: float
    calibrates_sequence: bool
    skips_no_contact: bool


def find_preset(name: str) -> Preset:
    """Return the preset called `name`; the error lists the valid names."""
    check_option("preset", name, PRESETS)
    return PRESETS[name]


def _corradi2015_encoders(touches: Touches) -> dict[str, TouchEncoder]:
    moments = ZernikeMoments(order=15, repeat_negative=True, drop_constant=True)
    principal = PCA(n_components=0.95, svd_solver="full")
    return {"Zernike-PCA": TouchEncoder(DomeCrop(), [moments, principal])}


def _liu2014_encoders(touches: Touches) -> dict[str, TouchEncoder]:
    """One chain for each number of Otsu partitions, width and number of components."""
    shape = EncodingUnion([ShapeGeometry(), FourierDescriptors(n=40)])
    return {
        f"{n} x {n} partitions, {share:.0%} of the variance": TouchEncoder(
            ArrayCleanUp(n_partitions=n),
            [shape, StandardScaler(), KernelPCA(n_components=share)],
        )
        for n in (1, 2)
        for share in (0.9, 0.99)
    }


def _default_encoders(touches: Touches) -> dict[str, TouchEncoder]:
    geometry = find_geometry(touches)
    if geometry == "none":
        return {"taxels": TouchEncoder(None, [TaxelVector(), RootScaler()])}
    disc = TouchEncoder(DomeCrop(missing="inscribed"), _disc_steps(touches))
    if geometry == "dome":
        return {"moments and gradients on the rim's disc": disc}
    centred = TouchEncoder(None, [CentroidMoments(), RootScaler()])
    return {
        "moments about the centroid": centred,
        "moments and gradients on the inscribed disc": disc,
    }


def _disc_steps(touches: Touches) -> list[Any]:
    """Zernike moments, and gradients along rings where there are taxels enough."""
    if min(touches.images.shape[1:]) < FINE_TAXELS:
        return [ZernikeMoments(order=15, drop_constant=True), RootScaler()]
    moments = ZernikeMoments(order=30, drop_constant=True, precision="single")
    both = [moments, PolarGradients()]
    # Of 1683 features the first principal components tell nearly the same distances.
    return [EncodingUnion(both, balanced=True), PrincipalShare(0.9)]


PRESETS: dict[str, Preset] = {
    "default": Preset(
        summary="Our best: encoding chosen for the sensor, kernel ridge posterior, "
        "calibrated sequences of touches.",
        encoders=_default_encoders,
        classifier=KernelRidgeClassifier,
        floor=0.01,
        calibrates_sequence=True,
        skips_no_contact=True,
    ),
    "corradi2015": Preset(
        summary="Corradi et al. 2015 as written: Zernike-PCA, kernel density per "
        "object, naive Bayes over touches.",
        encoders=_corradi2015_encoders,
        classifier=KernelDensityBayes,
        floor=0.0,
        calibrates_sequence=False,
        skips_no_contact=False,
    ),
    "liu2014": Preset(
        summary="Liu et al. 2014: one press on an array, cleaned up; area, edges and "
        "Fourier descriptors fused by kernel PCA; multiple kernel learning SVM.",
        encoders=_liu2014_encoders,
        classifier=lambda: FromProbabilities(MKLSVC()),
        floor=0.01,
        calibrates_sequence=True,
        skips_no_contact=True,
    ),
}
