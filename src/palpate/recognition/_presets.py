"""Presets: named recipes from image to log-likelihood, in one table."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.decomposition import PCA
from sklearn.preprocessing import StandardScaler

from .. import classifiers
from .._checks import check_option
from .._types import Array
from ..classifiers import FromProbabilities, TouchClassifier
from ..encodings import (
    CentroidMoments,
    EdgeHistograms,
    EncodingUnion,
    FourierDescriptors,
    GridLevels,
    KernelPCA,
    PadShapes,
    PolarGradients,
    PrincipalShare,
    RingPatterns,
    RingQuantiles,
    RootScaler,
    ShapeGeometry,
    TaxelVector,
    ZernikeMoments,
)
from ..images import ArrayCleanUp, ChannelMean, DomeCrop
from ..touches import Touches
from ._encoder import FEW_TAXELS, TouchEncoder, find_geometry, living
from ._user_parts import Encoding, UserEncoding, user_encodings

# With fewer taxels on a side, gradients along rings have too few places.
FINE_TAXELS = 24
# Of the spectrum of an array: it has twice as many numbers as cells.
FEW_CELLS = 16
# Principal components keep this share of the variance of a large encoding.
KEPT_SHARE = 0.99
# Taxels vary along directions that hold this share and count alike, also the least of
# them, where there are so many touches for each taxel.
DIRECTIONS_SHARE = 0.9999
TOUCHES_EACH = 8

# How objects come, and what an encoding for that must be blind to.
PRESENTATIONS = {
    "auto": frozenset[str](),
    "any": frozenset({"turns", "shifts"}),
    "turned": frozenset({"turns"}),
    "shifted": frozenset({"shifts"}),
    "fixed": frozenset[str](),
}


@dataclass(frozen=True)
class Preset:
    """A recipe for a recogniser.

    `encoders` gives unfitted encoders by name for touches and a presentation, of which
    the best is chosen on touches left out; `classifier` an unfitted classifier of what
    a fitted encoder makes of touches; `floor` is the least probability that one touch
    leaves to all objects together. It may calibrate how touches add up, and skip those
    that look like the no-contact frame.
    """

    encoders: Callable[..., dict[str, TouchEncoder]]
    classifier: Callable[[TouchEncoder], classifiers.TouchClassifier]
    floor: float
    calibrates_sequence: bool
    skips_no_contact: bool


def find_preset(name: str | None) -> Preset:
    """Return the preset called `name`; the error lists the valid names.

    None has no encodings of its own, and is otherwise like "default".
    """
    if name is None:
        return replace(PRESETS["default"], encoders=_no_encoders)
    check_option("preset", name, PRESETS)
    return PRESETS[name]


def resolved_preset(
    name: str | None, encodings: Mapping[str, Encoding] | None, classifier: Any
) -> Preset:
    """Return a preset with encodings of the user's own beside its, or alone.

    And perhaps with another classifier, in place of its own.
    """
    preset, from_user = find_preset(name), user_encodings(encodings)
    if name is None and not from_user:
        raise ValueError(
            "encodings must name at least one encoding with preset=None, got "
            f"{encodings!r}. Give one, or leave preset as it is."
        )
    if from_user and name not in (None, "default"):
        raise ValueError(
            f"encodings must be None with the preset {name!r}, whose encoding is the "
            f"paper's, got {', '.join(from_user)}. Use the preset 'default', or None."
        )
    if classifier is not None:
        learns = _touch_classifier(classifier)
        preset = replace(preset, classifier=lambda encoder: clone(learns))
    if not from_user:
        return preset

    def encoders(touches: Touches, presentation: str) -> dict[str, TouchEncoder]:
        # A user's own take images as they are read.
        recipes = preset.encoders(touches, presentation, as_read=True)
        return {name: _joined(recipes[name], from_user) for name in recipes}

    return replace(preset, encoders=encoders)


def _touch_classifier(classifier: Any) -> TouchClassifier:
    """Return a classifier, not learnt, that a belief can be built on, or explain."""
    required = [name for name in vars(TouchClassifier) if not name.startswith("_")]
    if not isinstance(classifier, type):
        if all(hasattr(type(classifier), name) for name in required):
            return clone(classifier)  # type: ignore[no-any-return]
        if hasattr(classifier, "predict_proba"):
            return FromProbabilities(classifier)
    raise TypeError(
        "classifier must be a TouchClassifier or have predict_proba, got "
        f"{classifier!r}. Give an instance, or wrap it in CalibratedClassifierCV."
    )


def _joined(
    encoder: TouchEncoder, from_user: Mapping[str, UserEncoding]
) -> TouchEncoder:
    """Return a recipe with more encodings, of the same cleaned images."""
    if taken := sorted(from_user.keys() & encoder.encodings.keys()):
        raise ValueError(
            f"encodings must have names of their own, got {taken[0]!r}, which is one "
            "of the preset's. Choose another name."
        )
    chains = {name: [encoding] for name, encoding in from_user.items()}
    joined = copy(encoder)
    joined.encodings = {**encoder.encodings, **chains}
    return joined


def _no_encoders(
    touches: Touches, presentation: str, *, as_read: bool
) -> dict[str, TouchEncoder]:
    return {"images as they are": TouchEncoder(None, {})}


def _corradi2015_encoders(
    touches: Touches, presentation: str
) -> dict[str, TouchEncoder]:
    _check_auto("corradi2015", presentation)
    moments = ZernikeMoments(order=15, repeat_negative=True, drop_constant=True)
    principal = PCA(n_components=0.95, svd_solver="full")
    chain = {"Zernike-PCA": [moments, principal]}
    return {"Zernike-PCA": TouchEncoder(DomeCrop(), chain)}


def _liu2014_encoders(touches: Touches, presentation: str) -> dict[str, TouchEncoder]:
    """One chain for each number of Otsu partitions, width and number of components."""
    _check_auto("liu2014", presentation)
    shape = EncodingUnion([ShapeGeometry(), FourierDescriptors(n=40)])
    return {
        f"{n} x {n} partitions, {share:.0%} of the variance": TouchEncoder(
            ArrayCleanUp(n_partitions=n),
            {"shape": [shape, StandardScaler(), KernelPCA(n_components=share)]},
        )
        for n in (1, 2)
        for share in (0.9, 0.99)
    }


def _check_auto(preset: str, presentation: str) -> None:
    if presentation != "auto":
        raise ValueError(
            f"presentation must be 'auto' with the preset {preset!r}, whose encoding "
            f"is the paper's, got {presentation!r}. Use the preset 'default'."
        )


def _default_encoders(
    touches: Touches, presentation: str, *, as_read: bool = False
) -> dict[str, TouchEncoder]:
    """One encoder of all encodings that the presentation allows.

    Where it is known at what levels taxels rest, of what changes, unless they are to
    take images `as_read`: levels of rest are those of the day. Not of a gel or pins:
    less the frame of another day, their pictures show the edges of both.
    """
    geometry = find_geometry(touches)
    if geometry == "dome":
        principal = PrincipalShare(KEPT_SHARE)
        quantiles = [RingQuantiles(), StandardScaler(), principal]
        on_disc = {
            "moments and gradients": _moments(touches),
            "patterns on rings": [RingPatterns(), principal],
            "quantiles on rings": quantiles,
        }
        if colours := touches.images.ndim == 4:
            on_disc = {name: [ChannelMean(), *on_disc[name]] for name in on_disc}
            on_disc["colours on rings"] = quantiles
        candidates = TouchEncoder(DomeCrop(), on_disc, channels=colours)
        return {"disc about the rim": _allowed(candidates, presentation)}
    rest = touches.no_contact
    if rest is not None:  # as the touches are looked at: without dead taxels
        rest = living(rest[None], touches.pads)[0]
    name, encodings = {
        "none": ("taxels", _taxel_encodings),
        "array": ("whole picture", _array_encodings),
        "plane": ("whole picture", _plane_encodings),
    }[geometry]
    as_changes = rest is not None and geometry != "plane" and not as_read
    if as_changes:
        name, rest = "change from rest", np.zeros_like(rest)
    encoder = TouchEncoder(None, encodings(touches, rest), as_changes=as_changes)
    return {name: _allowed(encoder, presentation)}


def _allowed(encoder: TouchEncoder, presentation: str) -> TouchEncoder:
    """Return an encoder by what is blind to what a presentation changes.

    Where none is blind to all of it (a dome's know no shifts), those that are blind to
    most.
    """
    changes = PRESENTATIONS[presentation]
    blind = {name: len(encoder.blind_to(name) & changes) for name in encoder.encodings}
    return encoder.only(n for n in blind if blind[n] == max(blind.values()))


def _taxel_encodings(
    touches: Touches, rest: Array | None = None
) -> dict[str, list[Any]]:
    """Encodings of taxels that have no places."""
    encodings: dict[str, list[Any]] = {
        "taxels": [TaxelVector(), StandardScaler()],
        "roots of taxels": [TaxelVector(), RootScaler()],
    }
    columns = [c for c in (touches.session, touches.subject) if c is not None]
    # What several sessions differ in would be one direction of many, for which left-out
    # sessions would then promise too much.
    alike = all(len(np.unique(column)) == 1 for column in columns)
    if alike and len(touches) >= TOUCHES_EACH * touches.images[0].size:
        directions = [StandardScaler(), PrincipalShare(DIRECTIONS_SHARE)]
        whitened = [TaxelVector(), *directions, StandardScaler()]
        encodings["directions of taxels"] = whitened
    return encodings


def _array_encodings(touches: Touches, rest: Array | None) -> dict[str, list[Any]]:
    """Encodings of an array: those of a plane, and what holds wherever it is pressed.

    Of the latter nothing is taken off where `rest`, what it reads untouched, is not
    known: a median of touches would not move with them.
    """
    has_axes = touches.images.ndim == 4
    encodings = _plane_encodings(touches, rest, has_axes)
    principal = PrincipalShare(KEPT_SHARE)
    spectrum = GridLevels(FEW_CELLS, spectrum=True, baseline=rest, pads=touches.pads)
    encodings["levels apart from place"] = [spectrum, principal]
    if has_axes:
        spectrum = GridLevels(FEW_CELLS, spectrum=True, pads=touches.pads)
        sizes = [ChannelMean(squared=True), spectrum, principal]
        encodings["sizes apart from place"] = sizes
    if min(touches.images.shape[1:3]) < FEW_TAXELS:
        encodings |= _taxel_encodings(touches)
    return encodings


def _plane_encodings(
    touches: Touches, rest: Array | None, has_axes: bool = False
) -> dict[str, list[Any]]:
    """Encodings of a gel, pins or an array, whose picture is looked at as it is.

    Where its channels are the axes of a force, shapes are told by how large that is: it
    points another way wherever it is turned, and in the mean of axes it cancels.
    """
    size = [ChannelMean(squared=True)] if has_axes else []
    grey = size or [ChannelMean()]
    principal = PrincipalShare(KEPT_SHARE)
    baseline = "median" if rest is None else rest
    levels = {
        "levels": GridLevels(baseline=baseline),
        "blurred levels": GridLevels(blur=1.0, baseline=baseline),
        "levels apart from force": GridLevels(unit=True, baseline=baseline),
    }
    encodings = {name: [grid, principal] for name, grid in levels.items()}
    pads = touches.pads
    if pads is not None and len(pads) > 1:
        shapes = [*size, PadShapes(pads), StandardScaler()]
        return encodings | {"shapes on the pads": shapes}
    about_centroid = [CentroidMoments(), RootScaler(), principal]
    encodings |= {
        "edges": [EdgeHistograms(), principal],
        "moments about the centroid": [*size, *about_centroid],
        "moments on the disc": [*grey, DomeCrop(), *_moments(touches)],
    }
    if min(touches.images.shape[1:3]) >= FINE_TAXELS:
        encodings["patterns on rings"] = [*grey, RingPatterns(), principal]
    return encodings


def _moments(touches: Touches) -> list[Any]:
    """Zernike moments, and gradients along rings where there are taxels enough."""
    if min(touches.images.shape[1:3]) < FINE_TAXELS:
        few = ZernikeMoments(order=15, drop_constant=True)
        return [few, RootScaler(), PrincipalShare(KEPT_SHARE)]
    moments = ZernikeMoments(order=30, drop_constant=True, precision="single")
    both = [moments, PolarGradients()]
    # Of 1683 features the first principal components tell nearly the same distances.
    return [EncodingUnion(both, balanced=True), PrincipalShare(0.9)]


PRESETS: dict[str, Preset] = {
    "default": Preset(
        # Our best: encodings weighed for the sensor, a kernel ridge posterior of each,
        # calibrated sequences of touches.
        encoders=_default_encoders,
        classifier=lambda encoder: classifiers.EncodingPool(encoder.parts_),
        floor=0.01,
        calibrates_sequence=True,
        skips_no_contact=True,
    ),
    "corradi2015": Preset(
        # Corradi et al. 2015 as written: Zernike-PCA, kernel density per object, naive
        # Bayes over touches.
        encoders=_corradi2015_encoders,
        classifier=lambda encoder: classifiers.KernelDensityBayes(),
        floor=0.0,
        calibrates_sequence=False,
        skips_no_contact=False,
    ),
    "liu2014": Preset(
        # Liu et al. 2014: one press on an array, cleaned up; area, edges and Fourier
        # descriptors fused by kernel PCA; multiple kernel learning SVM.
        encoders=_liu2014_encoders,
        classifier=lambda encoder: classifiers.FromProbabilities(classifiers.MKLSVC()),
        floor=0.01,
        calibrates_sequence=True,
        skips_no_contact=True,
    ),
}
