"""Learning an encoding: which one suits the sensor, and what it makes of touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.base import clone

from .._checks import listed
from .._numbers import with_floor
from .._types import Array, Bools, Floats, Indices
from ..classifiers import EncodingPool, KernelRidgeClassifier
from ..images import NoLivingTaxelError
from ..touches import Touches, TouchSource
from ._contact import ContactCheck, encoded_and_flagged
from ._encoder import Encoder, TouchEncoder, find_geometry
from ._evidence import NO_CONTACT
from ._memory import Memory, rows_of_each
from ._model_file import state_digest
from ._presets import PRESENTATIONS, Preset
from ._sessions import N_LOOKS

_N_IDS_SHOWN = 3
# An encoding is learnt from this many touches of a source, the same number of each
# label where there are enough.
SHOWN = 2000
# Candidates are compared on at most so many touches, whole recipes in so many folds.
AT_MOST = 600
N_FOLDS = 3
# Touches of each label that candidates are compared on, at least.
FEWEST = 4
# Of several encodings those are kept that say this share of what the pool says (their
# weight times the spread of their log posteriors over objects), at most so many.
LEAST_SHARE = 0.05
MOST_KEPT = 5
# Memory of learning, as measured (docs/explanation/speed.md). Where each touch has a
# kernel function: bytes for each touch and label, and for each pair of touches, twice
# as many where what was solved is kept for later touches. Where landmarks stand for
# all: bytes for each label, for each touch, and for what is always there.
_EACH_BYTES, _PAIR_BYTES, _KEPT = 200, 13, 5000
_LABEL_BYTES, _TOUCH_BYTES, _LANDMARK_BYTES = 100_000, 3_000, 500_000_000


@dataclass(frozen=True)
class Encoded:
    """What an encoding makes of touches, one row a touch; see `Memory`."""

    features: Floats
    nothing: Bools
    looks: Floats


def refuse_too_large(labels: Array, max_memory_gb: float) -> None:
    """Refuse labels (n_touches,) of more objects and touches than memory is for."""
    n_touches, n_labels = len(labels), len(np.unique(labels))
    if KernelRidgeClassifier.learns_by_landmarks(n_touches, n_labels):
        by_label, by_touch = _LABEL_BYTES * n_labels, _TOUCH_BYTES * n_touches
        needed_gb = (by_label + by_touch + _LANDMARK_BYTES) / 1e9
    else:
        pairs = n_touches**2 * (2 if n_touches <= _KEPT else 1)
        needed_gb = (_EACH_BYTES * n_touches * n_labels + _PAIR_BYTES * pairs) / 1e9
    if needed_gb > max_memory_gb:
        raise ValueError(
            f"Learning must take at most {max_memory_gb:g} GB of memory, got "
            f"{n_labels} labels and {n_touches} touches, which take up to some "
            f"{needed_gb:.1f} GB. Learn categories first (label='category') and the "
            "objects of each by themselves, use fewer touches of each, or raise "
            "ObjectRecogniser.max_memory_gb."
        )


def learn_encoding(
    preset: Preset,
    touches: Touches | TouchSource,
    labels: Array,
    group: Indices,
    presentation: str,
) -> tuple[TouchEncoder, ContactCheck, dict[str, Any], Encoded]:
    """Choose and learn encodings, and what contact looks like.

    Of a source, some touches of each label are shown to the encoder and the rest only
    pass through it. Returns encoder, contact, the reasons for the encodings, and what
    they make of all the touches.
    """
    if isinstance(touches, Touches):
        rows, shown = np.arange(len(labels)), touches
    else:
        rows = shown_rows(labels)
        shown = touches.touches(rows)
    # What is kept must not change with the arrays that were given.
    names = {"no_contact", "pads"} & shown.whole.keys()
    kept = {name: shown.whole[name].copy() for name in names}
    # What it takes a search for rims to know is found out once.
    geometry = find_geometry(shown)
    shown = shown.with_columns(**kept, geometry=geometry)
    lacks_rest = geometry in ("array", "none") and shown.no_contact is None
    if lacks_rest and (newest := touches.no_contact) is not None:
        # Levels that taxels rest at are mostly theirs: it serves earlier sessions too.
        shown = shown.with_columns(no_contact=newest)
    labels_and_groups = labels[rows], group[rows]
    recipes = preset.encoders(shown, presentation)
    encoder, chosen = choose_encoder(preset, recipes, shown, *labels_and_groups)
    moved = as_rested(encoder, touches, shown.no_contact)
    if moved is not touches:
        shown = touches_of(moved, rows).with_columns(geometry=geometry)
    cleaned, learnt_steps = encoder.fit_clean(shown), dict[str, Any]()
    if len(encoder.encodings) > 1:
        encoder, pooled = choose_encodings(
            encoder, cleaned, *labels_and_groups, learnt_steps
        )
        pooled["encoding"] = f"{chosen['encoding']}: {pooled['encoding']}"
        chosen |= pooled
    blind = [encoder.blind_to(name) for name in encoder.encodings]
    unmet = " and ".join(sorted(PRESENTATIONS[presentation].difference(*blind)))
    if unmet:
        sentence = f"no encoding for this sensor is blind to {unmet}"
        chosen["found"] = [sentence, *chosen.get("found", ())]
    features, novelty = encoder.fit_encode(cleaned, group[rows], learnt_steps)
    contact = ContactCheck().fit(shown, encoder)
    contact.learn_poses(encoder, novelty)
    if isinstance(touches, Touches):
        nothing = contact.no_contact(touches, cleaned)
        result = Encoded(features.copy("K"), nothing, encoder.look(touches))
    else:
        result = encoded(encoder, contact, touches)
    return encoder, contact, chosen, result


def encoded(
    encoder: Encoder, contact: ContactCheck, touches: Touches | TouchSource
) -> Encoded:
    """Return what a learnt encoding makes of all touches."""

    def encode(batch: Touches) -> Floats:
        features, flags = encoded_and_flagged(encoder, contact, batch)
        nothing = np.array(flags) == NO_CONTACT
        return np.column_stack([features, encoder.look(batch), nothing])

    touches = as_rested(encoder, touches, getattr(encoder, "baseline_", None))
    with naming_empty(touches):
        if isinstance(touches, Touches):
            table = encode(touches)
        else:
            key = state_digest(encoder) + state_digest(contact) + "looks"
            table = touches.features(key, encode)
    features, looks, nothing = np.split(table, [-N_LOOKS - 1, -1], axis=1)
    return Encoded(np.ascontiguousarray(features), nothing[:, 0] > 0, looks)


def as_rested(
    encoder: Encoder, touches: Touches | TouchSource, frame: Array | None
) -> Touches | TouchSource:
    """Return touches as an encoder of changes is to see them: as if at rest at a frame.

    Where a source knows at what it rested; `Touches` have their own frame, or none.
    """
    moved = getattr(touches, "resting_at", None)
    if moved is None or frame is None or not getattr(encoder, "as_changes", False):
        return touches
    rested: TouchSource = moved(frame)
    return rested


def memory_of(
    touches: Touches | TouchSource,
    encoding: Encoded,
    labels: Array,
    objects: Array,
    blocks: Indices,
) -> Memory:
    """Return what is kept of touches that were encoded."""

    def texts(column: Array | None) -> Array:
        if column is None:
            return np.full(len(labels), "")
        is_nan = column != column  # as a data frame has what is not known
        return np.where(is_nan, "", column.astype(str))

    return Memory(
        features=encoding.features,
        labels=labels.copy(),
        objects=objects.copy(),
        blocks=blocks,
        sessions=texts(touches.session),
        subjects=texts(touches.subject),
        nothing=encoding.nothing,
        touch_ids=texts(touches.touch_id),
        categories=texts(touches.category),
        looks=encoding.looks,
    )


def shown_rows(labels: Array, n_shown: int = SHOWN) -> Indices:
    """Return all rows, of many about `n_shown`, spread evenly over each label.

    Of more labels than would have `FEWEST` each, only every second, third...
    """
    if len(labels) <= n_shown:
        return np.arange(len(labels))
    by_label = rows_of_each(labels)
    # Of very many labels some, with touches enough to be left out in turn.
    by_label = by_label[:: -(-len(by_label) * FEWEST // n_shown)]
    share = max(2, n_shown // len(by_label))
    chosen = [
        rows[np.unique(np.linspace(0, len(rows) - 1, share).round().astype(int))]
        for rows in by_label
    ]
    return np.sort(np.concatenate(chosen))


def choose_encoder(
    preset: Preset,
    recipes: Mapping[str, TouchEncoder],
    touches: Touches,
    labels: Array,
    group: Indices,
) -> tuple[TouchEncoder, dict[str, Any]]:
    """Return the preset's best recipe for these touches, not fitted, and the reasons.

    With several recipes each learns two thirds of the groups (at most `AT_MOST`
    touches) and is asked about the rest; the least log loss (nats) wins.
    """
    chosen: dict[str, Any] = {"geometry": touches.geometry}
    if len(recipes) == 1:
        ((name, encoder),) = recipes.items()
        chosen |= {"encoding": name, "why": "the one encoding for this geometry"}
        return encoder, chosen
    few = shown_rows(labels, AT_MOST)
    fold = np.unique(group[few], return_inverse=True)[1] % N_FOLDS
    results = {
        name: _left_out_scores(encoder, preset, touches[few], labels[few], fold)
        for name, encoder in recipes.items()
    }
    best = min(results, key=lambda name: results[name]["log_loss"])
    why = "least log loss on touches left out"
    chosen |= {"encoding": best, "why": why, "candidates": results}
    return recipes[best], chosen


def choose_encodings(
    encoder: TouchEncoder,
    cleaned: Array,
    labels: Array,
    group: Indices,
    learnt_steps: dict[str, Any],
) -> tuple[TouchEncoder, dict[str, Any]]:
    """Return the encoder with the encodings that a pool of them needs, and the reasons.

    Each is learnt from about `AT_MOST` of the touches, evenly spread over each label,
    and asked about them as they are, each left out with its group; those that weigh
    little in the pool of least log loss (nats) are dropped. What the steps make of all
    the touches is kept in `learnt_steps`, by the encoding's name.
    """
    few = shown_rows(labels, AT_MOST)
    of_all = learnt_steps if len(few) == len(cleaned) else None
    features, _ = encoder.fit_encode(cleaned[few], learnt_steps=of_all)
    pool = EncodingPool(encoder.parts_, together=False)
    pool.fit(features, labels[few], groups=group[few])
    codes = np.searchsorted(pool.classes_, labels[few][pool.left_out_rows])
    left_out = dict(zip(pool.weights_, pool.left_out_posteriors(), strict=True))
    own_posteriors = {
        name: log_posteriors[np.arange(len(codes)), codes]
        for name, log_posteriors in left_out.items()
    }
    figures: dict[str, dict[str, Any]] = {
        name: {
            "log_loss": float(-own_posteriors[name].mean()),
            "accuracy": float((log_posteriors.argmax(axis=1) == codes).mean()),
            # One that says nothing may weigh much.
            "counts": float(pool.weights_[name] * log_posteriors.std(axis=1).mean()),
            "blind_to": sorted(encoder.blind_to(name)),
        }
        for name, log_posteriors in left_out.items()
    }
    # The encodings to keep, in their order; one at least.
    counts = {name: figure["counts"] for name, figure in figures.items()}
    least = LEAST_SHARE * sum(counts.values())
    most = sorted(counts, key=lambda name: -counts[name])[:MOST_KEPT]
    names = [n for n in counts if n in most and (counts[n] >= least or n == most[0])]
    return encoder.only(names), {
        "encoding": " + ".join(names),
        "why": "pooled by least log loss on touches left out, as they are",
        "candidates": figures,
        "found": [
            sentence
            for change in ("turns", "shifts")
            if (sentence := what_matters(change, figures, own_posteriors))
        ],
    }


def what_matters(
    change: str,
    figures: Mapping[str, Mapping[str, Any]],
    own_posteriors: Mapping[str, Floats],
) -> str | None:
    """Say whether "turns" or "shifts" of a touch tell objects apart.

    Compares the best encoding that is blind to them with the best that is not, by log
    loss; `own_posteriors` (n_touches,) are the log posteriors of the touches' own
    labels. None where all encodings or none are blind to them.
    """
    best = {}
    for blind in (False, True):
        names = [n for n in figures if (change in figures[n]["blind_to"]) == blind]
        if not names:
            return None
        best[blind] = min(names, key=lambda name: figures[name]["log_loss"])
    difference = own_posteriors[best[False]] - own_posteriors[best[True]]
    error = difference.std() / np.sqrt(len(difference))
    accuracies = (100 * figures[best[blind]]["accuracy"] for blind in (False, True))
    seeing, unseeing = (f"{accuracy:.0f} %" for accuracy in accuracies)
    if difference.mean() > 2 * error:
        verdict = f"{change} matter here"
    elif difference.mean() < -2 * error:
        verdict = f"{change} mislead here"
    else:
        verdict = f"whether {change} matter cannot be told here"
    return f"{verdict}: as they come {seeing}, blind to {change} {unseeing}"


def _left_out_scores(
    encoder: TouchEncoder, preset: Preset, touches: Touches, labels: Array, fold: Array
) -> dict[str, float]:
    """Return log loss (nats) and accuracy of a recipe on the folds left out."""
    encoder = clone(encoder)
    features = encoder.fit_encode(encoder.fit_clean(touches))[0]
    classes = np.unique(labels)
    log_posterior = np.full((len(labels), len(classes)), -np.log(len(classes)))
    for k in range(N_FOLDS):
        train, test = fold != k, fold == k
        if not test.any() or len(np.unique(labels[train])) < 2:
            continue
        classifier = preset.classifier(encoder).fit(features[train], labels[train])
        columns = np.searchsorted(classes, classifier.classes_)
        log_likelihood = np.full((int(test.sum()), len(classes)), -np.inf)
        log_likelihood[:, columns] = classifier.log_likelihood(features[test])
        log_posterior[test] = with_floor(log_likelihood, 0.01)
    codes = np.searchsorted(classes, labels)
    hit = log_posterior.argmax(axis=1) == codes
    loss = -log_posterior[np.arange(len(codes)), codes].mean()
    return {"log_loss": float(loss), "accuracy": float(hit.mean())}


class EmptyTouchError(ValueError):
    """Touches hold nothing but NaN; `touch_ids` are their ids."""

    def __init__(self, touch_ids: list[str]) -> None:
        self.touch_ids = touch_ids
        super().__init__(
            "Touches must have at least one living taxel, got only NaN in touch "
            f"{listed(touch_ids, _N_IDS_SHOWN)}. Leave it out: retract it, or "
            f"choose others (id != {touch_ids[0]!r})."
        )


@contextmanager
def naming_empty(touches: Touches | TouchSource) -> Iterator[None]:
    """Name all the touches that hold no number, where learning stumbles over one."""
    try:
        yield
    except NoLivingTaxelError:
        ids = touches.touch_id
        if ids is None:
            raise
        empty = [row for row in range(len(ids)) if _is_empty(touches, row)]
        if not empty:  # the frame of no contact
            raise
        raise EmptyTouchError(ids[empty].tolist()) from None


def _is_empty(touches: Touches | TouchSource, row: int) -> bool:
    """Whether a touch, or one channel of it, is nothing but NaN."""
    images = touches_of(touches, np.array([row])).images
    return bool(np.isnan(images.astype(np.float64)).all(axis=(1, 2)).any())


def touches_of(touches: Touches | TouchSource, rows: Indices) -> Touches:
    """Return some rows of touches, read where they are of a source."""
    return touches[rows] if isinstance(touches, Touches) else touches.touches(rows)
