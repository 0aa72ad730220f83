"""A learnt recogniser on another day: mounted anew, in other light, on another device.

Another camera sees the dome elsewhere and larger or smaller, which can be found and
undone; what else a session does to touches is taken off their features: of a whole
session at once, or touch by touch (`Recentring`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from scipy.special import softmax
from sklearn.base import clone

from .._checks import STRANGERS
from .._numbers import log_softmax
from .._parallel import on_one_thread
from .._types import Array, Bools, Floats, Indices
from ..touches import Touches
from . import _sessions
from ._belief import Belief
from ._calibration import left_out_log_likelihood
from ._contact import ContactCheck
from ._evidence import Evidence
from ._learning import encoded, memory_of
from ._learnt import Learnt, RemountedEncoder, wrapped
from ._memory import Memory, blocks_in_order, n_met
from ._sessions import SessionSums, shift_unlabelled

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

# Fewer differences between sessions than this do not tell a covariance.
LEAST_PAIRS = 20
# A loss (nats) that is smaller by no more than this is smaller by rounding.
LEAST_GAIN = 1e-6
# What confirmed touches count is 1, or less by this factor, once or several times.
WEIGHT_STEP, N_WEIGHTS = 4.0, 4
# Of more sessions than this several are left out at a time, each time choosing anew; of
# more touches all choices stay: it would take longer than learning.
MOST_TURNS, MOST_CHOOSING = 5, 1000


def remounted(
    learnt: Learnt, new: Touches, labels: Array | None, trust: float = 1.0
) -> tuple[Learnt, dict[str, Any]]:
    """Return what was learnt as it serves in the session of `new`, and what was found.

    `labels` (n_touches,) where they are confirmed; of one object alone `trust` is what
    is believed of what they tell. See `ObjectRecogniser.remount`.
    """
    if labels is not None:
        unknown = np.setdiff1d(labels, learnt.classes)
        if len(unknown):
            raise ValueError(
                f"touches must be of known objects, got {str(unknown[0])!r}, which was "
                "not learnt. Remount first, then add it with add_object; or leave the "
                "labels out to remount without them."
            )
    # Each more object tells of the session by itself.
    trust = 1.0 if labels is None else 1 - (1 - trust) / len(np.unique(labels))
    encoder, gain = _as_taught(learnt, new, labels, trust)
    other_kind = new.images.shape[1:] != tuple(learnt.encoder.image_shape_)
    contact = learnt.contact
    if new.no_contact is not None or other_kind:
        poses = contact.blind_, contact.usual_
        contact = ContactCheck().fit(new, encoder)
        contact.blind_, contact.usual_ = poses
    learnt = replace(learnt, encoder=encoder, contact=contact)
    learnt, report = without_sessions(learnt)
    encoding = encoded(learnt.encoder, contact, new)
    counts = ~encoding.nothing | learnt.uses_no_contact
    if not counts.any():
        raise ValueError(
            f"touches must show contact, got {len(new)} that look like touching "
            "nothing. Press the sensor on something, or take its baseline anew."
        )
    features = encoding.features
    if labels is None:
        sums, left = _sums(learnt, features[counts]), learnt.classes
        report["objects"] = round(_sessions.effective_number(sums.shares), 1)
        shift = shift_unlabelled(sums, learnt.taught)
        if not report.get("centred", True):
            shift = np.zeros_like(shift)
    else:
        left = learnt.classes[~np.isin(learnt.classes, labels[counts])]
        shift = trust * _shift(learnt, features[counts], labels[counts])
    remounted_encoder = wrapped(learnt.encoder).shifted(shift)
    report |= {"n_touches": len(new), "labelled": labels is not None, "gain": gain}
    if labels is not None:
        report["trust"] = trust
    report["confirm"] = left.astype(str).tolist()
    broken = remounted_encoder.broken
    report["broken"] = 0 if broken is None else int(broken.sum())
    variance = max(learnt.taught.features.var(axis=0).sum(), 1e-300)
    report["moved"] = float((shift**2).sum() / variance)
    learnt = replace(learnt, encoder=remounted_encoder)
    if labels is None or not trust:
        return learnt, report
    objects = labels if new.object is None else new.object
    encoding = replace(
        encoding, features=features + shift, looks=remounted_encoder.look(new)
    )
    one_group = np.zeros(len(new), dtype=np.intp)
    joined = memory_of(new, encoding, labels, objects, one_group)
    joined, report["weight"] = _weighed_by_themselves(learnt, joined, trust**2)
    return learnt.relearnt(learnt.memory.plus(joined)), report


def _weighed_by_themselves(
    learnt: Learnt, joined: Memory, most: float
) -> tuple[Memory, float]:
    """Return confirmed touches with what they count when they are learnt, and that.

    Touches of one session share what it does to them, so that one may be nearer to a
    confirmed touch of another object than to its own in training. How much they are to
    count is what tells them best, each left out by itself; a priori `most`, a quarter
    of it less probable by half a nat, and so on.
    """
    if not learnt.takes_weights:
        return joined, 1.0
    n_new, n_before, best, weight = len(joined), len(learnt.memory), np.inf, most
    by_itself = replace(joined, blocks=np.arange(n_new))
    counts = ~joined.nothing | learnt.uses_no_contact
    codes = np.searchsorted(learnt.classes, joined.labels)
    for step in range(N_WEIGHTS):
        each = np.full(n_new, most * WEIGHT_STEP**-step)
        memory = learnt.memory.plus(replace(by_itself, weights=each))
        refitted = learnt.refitted(memory)
        log_posterior = log_softmax(left_out_log_likelihood(refitted), axis=1)
        rows = refitted.left_out_rows
        places = np.flatnonzero(rows >= n_before)
        places = places[counts[rows[places] - n_before]]
        of_truth = log_posterior[places, codes[rows[places] - n_before]]
        loss = step**2 / 2 - of_truth.sum()
        if loss >= best:
            break
        best, weight = loss, float(each[0])
    return replace(joined, weights=np.full(n_new, weight)), weight


def _shift(learnt: Learnt, features: Floats, labels: Array | None) -> Floats:
    """Return what to add to a session's features, with or without labels."""
    if labels is None:
        return shift_unlabelled(_sums(learnt, features), learnt.taught)
    codes = np.searchsorted(learnt.classes, labels)
    return _sessions.shift_by_labels(features, codes, learnt.taught)


def _sums(learnt: Learnt, features: Floats) -> SessionSums:
    """Return what touches of a session without labels sum up to."""
    taken_for = softmax(learnt.classifier.log_likelihood(features), axis=1)
    return SessionSums.of(features, taken_for, learnt.taught)


def _as_taught(
    learnt: Learnt, new: Touches, labels: Array | None, trust: float
) -> tuple[RemountedEncoder, float]:
    """Return an encoder that makes images of the session as they were, and the gain.

    The gain of an array is told by the loads, of the same objects where labels tell
    them, as far as those are believed (`trust`); kept where touches come nearer to
    training touches (one standard error).
    """
    kept, memory = RemountedEncoder.of(learnt.encoder, new), learnt.memory
    seen, taught = kept.look(new), memory.looks[learnt.counted]
    if np.isnan(taught).any():
        return kept, 1.0
    if kept.clean_up_ is None:
        loads, loads_now = taught[:, -1], seen[:, -1]
        pairs = [(loads, loads_now)]
        if labels is not None:
            whose, names = memory.labels[learnt.counted], np.unique(labels)
            pairs = [(loads[whose == n], loads_now[labels == n]) for n in names]
        ratios = [np.median(before) - np.median(now) for before, now in pairs]
        gain = float(np.exp(trust * np.mean(ratios)))
        other = RemountedEncoder.of(learnt.encoder, new, gain)
        near = []
        for encoder in (kept, other):
            features = encoder.transform(new)
            moved = features + trust * _shift(learnt, features, labels)
            near.append(memory.nearest.log_distances(moved).min(axis=1))
        better = near[0] - near[1]
        if better.mean() > better.std() / np.sqrt(len(better)):
            kept = other
    change = taught.mean(axis=0) - seen.mean(axis=0)
    return replace(kept, look_offset=change), kept.gain


def without_nuisance(learnt: Learnt, new: Touches) -> tuple[Learnt, int]:
    """Return what was learnt without what tells sessions; see `learn_nuisance`."""
    if new.object is None or new.session is None:
        raise ValueError(
            "touches must have columns 'object' and 'session', to see how the same "
            f"thing differs between sessions, got {', '.join(new.columns) or 'none'}."
        )
    features: Floats = learnt.encoder.transform(new)
    codes = np.unique(new.object, return_inverse=True)[1]
    subjects = np.full(len(new), "") if new.subject is None else new.subject
    differences = _sessions.between_sessions(features, codes, new.session, subjects)
    if len(differences) < LEAST_PAIRS:
        raise ValueError(
            f"touches must show at least {LEAST_PAIRS} things in several sessions, "
            f"got {len(differences)} differences. Touch more objects in two sessions."
        )
    return _weighed_down(learnt, differences), len(differences)


def across_sessions(learnt: Learnt, rehearsal: Mapping[str, Any]) -> dict[str, Any]:
    """Return what training touches say of another day, and what was rehearsed.

    See `ObjectRecogniser.across_sessions`.
    """
    memory = learnt.memory
    per_object = np.maximum(_n_sessions(memory.objects, memory.sessions), 1)
    met_elsewhere, median = _met_elsewhere(memory), float(np.median(per_object))
    result: dict[str, Any] = {"least": int(per_object.min()), "median": median}
    if met_elsewhere.any():  # a session that is there twice tells of no other day
        met_elsewhere &= ~memory.copied_elsewhere
    result["asked"] = int(met_elsewhere.sum())
    if met_elsewhere.any():
        right = _right_elsewhere(learnt, met_elsewhere)
        if len(right):
            result["expected"] = float(right.mean())
    if "expected" in rehearsal:
        result["rehearsed"] = list(rehearsal["expected"])
    if "confirmed" in rehearsal:
        result["confirmed"] = list(rehearsal["confirmed"])
    return result


def _right_elsewhere(learnt: Learnt, met_elsewhere: Bools) -> Bools:
    """Return which touches are right by machines that never met their session.

    Of those whose label the others taught. Each session in turn, of many several at a
    time; widths, ridges and weights are chosen from the others alone, as `evaluate`
    does. The encoding stays as it is; of many touches the choices do as well.
    """
    memory = learnt.memory
    if len(memory) > MOST_CHOOSING:
        log_likelihood, rows = _log_likelihood_of_left_out_sessions(
            learnt, memory.features
        )
        right = learnt.classes[log_likelihood.argmax(axis=1)] == memory.labels[rows]
        return np.asarray(right[met_elsewhere[rows]])
    right = [np.empty(0, dtype=bool)]
    turn = np.unique(memory.sessions, return_inverse=True)[1] % MOST_TURNS
    for k in np.unique(turn[met_elsewhere]):
        labels, counts = np.unique(memory.labels[turn != k], return_counts=True)
        teachable = np.isin(memory.labels, labels[counts > 1])
        others, tested = teachable & (turn != k), teachable & (turn == k)
        tested &= met_elsewhere
        if not tested.any() or (counts > 1).sum() < 2:
            continue
        groups, objects = memory.blocks[others], memory.objects[others]
        if n_met(objects, groups).min() < 2:  # one session is left: its blocks
            groups = blocks_in_order(objects)
        classifier, taught = clone(learnt.classifier), memory.features[others]
        with on_one_thread():
            classifier.fit(taught, memory.labels[others], groups=groups)
        best = classifier.log_likelihood(memory.features[tested]).argmax(axis=1)
        right.append(classifier.classes_[best] == memory.labels[tested])
    return np.concatenate(right)


def sessions_message(across: Mapping[str, Any]) -> str:
    """Return what `across_sessions` found as a sentence for people."""
    least, expected = across["least"], across.get("expected")
    taught = f"Taught in {least} session{'s' if least > 1 else ''} an object"
    if expected is not None:
        return (
            f"{taught}: expect about {100 * expected:.0f} % right after one touch in "
            f"another one ({across['asked']} touches of sessions left out whole)."
        )
    if "rehearsed" in across:
        confirmed = ""
        if "confirmed" in across:
            shares = _between(across["confirmed"])
            confirmed = f" ({shares} with one confirmed touch of each)"
        return (
            f"{taught}, and none in two: expect about {_between(across['rehearsed'])} "
            "right after one touch on another day, or mounted anew, as rehearsed "
            f"sessions were{confirmed}; only touches of another session can show it."
        )
    return (
        f"{taught}, and none in two: on another day, or mounted anew, expect less than "
        "today. Only touches of another session can show how much less."
    )


def _between(shares: Sequence[float]) -> str:
    low, high = (f"{100 * share:.0f}" for share in shares)
    return f"{low} %" if low == high else f"{low} to {high} %"


def without_sessions(learnt: Learnt) -> tuple[Learnt, dict[str, Any]]:
    """Take off what training sessions add, where that helps with sessions left out.

    Weighing down how sessions differ comes next, if it helps further. Also returns what
    was done.
    """
    memory = learnt.memory
    met_elsewhere = _met_elsewhere(memory)
    if not met_elsewhere.any():
        return learnt, {}
    features, codes = memory.features, learnt.codes
    centred = features - _sessions.session_effects(features, codes, memory.sessions)
    loss = {
        "plain": _loss(learnt, features, met_elsewhere),
        "centred": _loss(learnt, centred, met_elsewhere),
    }
    pairs = _sessions.between_sessions(centred, codes, memory.sessions, memory.subjects)
    # Touches that tell themselves how sessions differ are too sure: other persons must.
    may_weigh = len(np.unique(memory.subjects)) > 1 and len(pairs) >= LEAST_PAIRS
    may_weigh &= wrapped(learnt.encoder).weighing is None
    if may_weigh:
        loss["weighed"] = _loss_weighed(learnt, centred, met_elsewhere)
    loss = {name: losses[np.isfinite(losses)] for name, losses in loss.items()}
    if not len(loss["plain"]):
        return learnt, {}
    report = {"log_loss": {name: float(losses.mean()) for name, losses in loss.items()}}
    worse = loss["centred"] - loss["plain"]
    if worse.mean() > worse.std() / np.sqrt(len(worse)):
        return learnt, {**report, "centred": False, "weighed": False}
    gain = loss["centred"] - loss["weighed"] if may_weigh else np.zeros(1)
    weighs = bool(gain.mean() > LEAST_GAIN)
    centred_memory = replace(memory, features=centred)
    if weighs:
        learnt = _weighed_down(replace(learnt, memory=centred_memory), pairs)
    else:
        learnt = learnt.relearnt(centred_memory)
    return learnt, {**report, "centred": True, "weighed": weighs}


def _weighed_down(learnt: Learnt, differences: Floats) -> Learnt:
    features = learnt.memory.features
    weighing = _sessions.weighed_down(differences, features, learnt.parts)
    encoder = wrapped(learnt.encoder).weighed(weighing)
    memory = replace(learnt.memory, features=features @ weighing)
    return replace(learnt, encoder=encoder).relearnt(memory)


def _loss(learnt: Learnt, features: Floats, met_elsewhere: Array) -> Floats:
    """Return the log loss (nats) of the asked touches, their session left out whole.

    NaN of those that are not left out, where they are very many.
    """
    log_likelihood, rows = _log_likelihood_of_left_out_sessions(learnt, features)
    log_posterior = log_softmax(log_likelihood, axis=1)
    loss = np.full(len(learnt.memory), np.nan)
    loss[rows] = -log_posterior[np.arange(len(rows)), learnt.codes[rows]]
    return loss[met_elsewhere]


def _loss_weighed(learnt: Learnt, centred: Floats, met_elsewhere: Array) -> Floats:
    """Return the loss when features are weighed by pairs of other persons.

    In two halves, so that no touch is asked that told how sessions differ.
    """
    memory, codes, loss = learnt.memory, learnt.codes, np.empty(len(met_elsewhere))
    half = np.unique(memory.subjects, return_inverse=True)[1] % 2
    for k in range(2):
        weighing_half = half != k
        columns = centred, codes, memory.sessions, memory.subjects
        pairs = _sessions.between_sessions(*(c[weighing_half] for c in columns))
        weighing = np.eye(centred.shape[1])
        if len(pairs):
            weighing = _sessions.weighed_down(pairs, centred, learnt.parts)
        test_half = met_elsewhere & ~weighing_half
        loss[test_half] = _loss(learnt, centred @ weighing, test_half)
    return loss[met_elsewhere]


def _log_likelihood_of_left_out_sessions(
    learnt: Learnt, features: Floats
) -> tuple[Floats, Indices]:
    """Return what touches are taken for, their session left out, and which."""
    memory = learnt.memory
    session_codes = np.unique(memory.sessions, return_inverse=True)[1]
    refitted = learnt.refitted(replace(memory, features=features, blocks=session_codes))
    return left_out_log_likelihood(refitted), refitted.left_out_rows


def _met_elsewhere(memory: Memory) -> Array:
    """Return which touches are of an object that another session met too."""
    codes = np.searchsorted(memory.classes, memory.labels)
    n_sessions = _n_sessions(memory.labels, memory.sessions)
    return np.asarray((memory.sessions != "") & (n_sessions[codes] > 1))


def _n_sessions(names: Array, sessions: Array) -> Indices:
    """Return in how many sessions each name was met, the names sorted."""
    codes = np.unique(names, return_inverse=True)[1]
    days, day = np.unique(sessions, return_inverse=True)
    visits = np.unique((codes * len(days) + day)[sessions != ""])
    return np.bincount(visits // len(days), minlength=codes.max() + 1)


class Recentring:
    """Recognises in another session while it finds out what the session adds.

    What `remount` takes off with all touches of a session at once, without labels, is
    taken off with those there were so far: a little at first, more with each touch. The
    beliefs of the episode under way move along.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        As learnt; it stays as it is. Another camera, gain or baseline is for `remount`.

    Attributes
    ----------
    recogniser : ObjectRecogniser
        As it serves in the session by now.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.recognition import ObjectRecogniser, Recentring
    >>> images = np.random.default_rng(0).random((40, 3, 24))
    >>> images[:20] += 1
    >>> touches = Touches(images, object=["pen"] * 20 + ["mug"] * 20, geometry="none")
    >>> today = Recentring(ObjectRecogniser().fit(touches))
    >>> today.start().update(touches[:3]).best
    'pen'
    >>> today.start().update(touches[20:23]).best
    'mug'
    """

    def __init__(self, recogniser: ObjectRecogniser) -> None:
        learnt, report = without_sessions(recogniser.learnt())
        self._moves = bool(report.get("centred", True))
        self._as_learnt = copy(recogniser).serve(learnt)
        report |= {"labelled": False}
        self._as_learnt.chosen_ = {**recogniser.chosen_, "remount": report}
        self._taught = learnt.taught
        nothing = np.zeros((0, learnt.memory.features.shape[1]))
        no_names = np.zeros((0, len(learnt.classes)))
        self._sums = SessionSums.of(nothing, no_names, self._taught)
        self.recogniser = self._as_learnt
        self.start()

    def start(
        self, prior: Mapping[str, float] | None = None, strangers: float = STRANGERS
    ) -> Self:
        """Begin an episode, with another object; see `ObjectRecogniser.start`."""
        self._as_learnt.start(prior, strangers)  # refuses wrong shares now
        self._begun = prior, strangers
        self._episode: list[Evidence] = []
        return self

    @property
    def n_touches(self) -> int:
        """Touches of the session so far that showed contact."""
        return self._sums.n_touches

    def update(self, touch: Touches | Array) -> Belief:
        """Take in one touch, or several, of the episode's object; return the belief.

        It is that of all touches of the episode, as what the session adds is known now.
        """
        seen = self._as_learnt.evidence(touch)
        counts = seen.shows_contact | self._as_learnt.uses_no_contact_
        taken_for = softmax(seen.log_likelihood[counts], axis=1)
        self._sums = self._sums.plus(
            SessionSums.of(seen.features[counts], taken_for, self._taught)
        )
        self._episode.append(seen)
        if self._moves:
            shift = shift_unlabelled(self._sums, self._taught)
            now = copy(self._as_learnt)
            now.encoder_ = wrapped(now.encoder_).shifted(shift)
            self.recogniser = now
        else:
            shift = np.zeros_like(self._sums.features)
        belief = self.recogniser.start(*self._begun)
        for seen_before in self._episode:
            moved = seen_before.features + shift
            belief.update(
                self.recogniser.evidence_of(moved, seen_before.flags, seen_before.looks)
            )
        return belief
