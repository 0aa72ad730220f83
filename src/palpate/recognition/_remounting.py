"""A learnt recogniser on another day: mounted anew, in other light, on another device.

Another camera sees the dome elsewhere and larger or smaller, which can be found and
undone; what else a session does to touches is taken off their features.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import softmax
from scipy.stats import t as t_distribution

from .._numbers import log_softmax
from .._types import Array, Floats
from ..images import DomeCrop
from ..touches import Touches
from . import _sessions
from ._calibration import left_out_log_likelihood
from ._contact import NO_CONTACT, ContactCheck
from ._encoder import TouchEncoder
from ._evidence import Evidence, as_touches
from ._learning import encoded, memory_of
from ._memory import Memory, Nearest, blocks_in_order

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

# Fewer differences between sessions than this do not tell a covariance.
LEAST_PAIRS = 20
# A loss (nats) that is smaller by no more than this is smaller by rounding.
LEAST_GAIN = 1e-6
# Of mountings that are as they were when it was taught, so many raise an alarm.
FALSE_ALARMS = 0.05
# A rim that lies this share of its radius off where it was has moved.
RIM_MOVED = 0.03

OTHER_MOUNTING = (
    "This does not look like the sensor, mounting or light that was learnt with, or "
    "not like things it knows: names may be wrong. Take the baseline anew, or get used "
    "to it with a few touches{}."
)


@dataclass(frozen=True)
class MountingCheck:
    """Whether a sensor is mounted, lit and covered as it was when it was taught.

    Attributes
    ----------
    changed : bool
        Whether `distance` is above what 95 % of draws of training touches show.
    distance, usual : float
        How unlike training touches these are, and that limit, in standard deviations
        above the mean of draws: by their distances to the nearest training touches (of
        other blocks), or by spectrum and load, whichever is more.
    reasons : list of str
        What was seen, in sentences.
    """

    changed: bool
    distance: float
    usual: float
    reasons: list[str]


def adapt(recogniser: ObjectRecogniser, touches: Touches) -> ObjectRecogniser:
    """Return a copy of `recogniser` that was remounted with `touches`.

    What is done, and what is refused: `ObjectRecogniser.remount`.
    """
    return deepcopy(recogniser).remount(touches)


def remounted(recogniser: ObjectRecogniser, touches: Touches) -> ObjectRecogniser:
    """Return another recogniser, for the session; see `ObjectRecogniser.remount`."""
    new = as_touches(touches)
    labels = new.object if recogniser.label == "object" else new.category
    if labels is not None:
        unknown = np.setdiff1d(labels, recogniser.classes_)
        if len(unknown):
            raise ValueError(
                f"touches must be of known objects, got {str(unknown[0])!r}, which was "
                "not learnt. Remount first, then add it with add_object; or leave the "
                "labels out to remount without them."
            )
    result = copy(recogniser)
    result.encoder_, gain = _as_taught(recogniser, new, labels)
    shape = tuple(recogniser.encoder_.image_shape_)
    if new.no_contact is not None or new.images.shape[1:] != shape:
        contact = ContactCheck().fit(new, result.encoder_)
        for pose in ("blind_", "usual_"):
            setattr(contact, pose, getattr(recogniser.contact_, pose))
        result.contact_ = contact
    found = _without_sessions(result)
    encoding = encoded(result.encoder_, result.contact_, new)
    counts = ~encoding.nothing | result.uses_no_contact_
    if not counts.any():
        raise ValueError(
            f"touches must show contact, got {len(new)} that look like touching "
            "nothing. Press the sensor on something, or take its baseline anew."
        )
    features, taught = encoding.features, taught_of(result)
    if labels is None:
        say = result.classifier_.log_likelihood
        shift, shares = _sessions.shift_unlabelled(features[counts], say, taught)
        if not found.get("centred", True):
            shift = np.zeros_like(shift)
        found["objects"] = round(_sessions.effective_number(shares), 1)
    else:
        codes = np.searchsorted(result.classes_, labels)
        shift = _sessions.shift_by_labels(features[counts], codes[counts], taught)
    before = result.encoder_.offset_
    result.encoder_.offset_ = shift if before is None else shift + before
    found |= {"n_touches": len(new), "labelled": labels is not None, "gain": gain}
    broken = result.encoder_.broken_
    found["broken"] = 0 if broken is None else int(broken.sum())
    variance = max(taught.features.var(axis=0).sum(), 1e-300)
    found["moved"] = float((shift**2).sum() / variance)
    result.chosen_ = {**result.chosen_, "remount": found}
    if labels is not None:
        objects = labels if new.object is None else new.object
        one_group = np.zeros(len(new), dtype=np.intp)
        encoding.features = features + shift
        encoding.looks = result.encoder_.look(new)
        there = memory_of(new, encoding, labels, objects, one_group)
        result._relearn(result.memory_.plus(there))
    return result


def _as_taught(
    recogniser: ObjectRecogniser, new: Touches, labels: Array | None
) -> tuple[TouchEncoder, float]:
    """Return an encoder that makes images of the session as they were, and the gain.

    The gain of an array is told by the loads, of the same objects where labels tell
    them; kept where touches come nearer to training touches (one standard error).
    """
    encoder, memory = recogniser.encoder_.moved(new), recogniser.memory_
    seen, taught = encoder.look(new), memory.looks[_counted(recogniser)]
    if np.isnan(taught).any():
        return encoder, 1.0
    gain, kept = 1.0, encoder
    if encoder.clean_up_ is None:
        asked = np.zeros(len(new)) if labels is None else labels
        of = memory.labels[_counted(recogniser)]
        ratios = [
            np.median(taught[slice(None) if labels is None else of == name, -1])
            - np.median(seen[asked == name, -1])
            for name in np.unique(asked)
        ]
        gain = float(np.exp(np.mean(ratios)))
        other, nearest = recogniser.encoder_.moved(new, gain), recogniser._nearest()
        near = [
            nearest.log_distances(one.transform(new)).min(axis=1)
            for one in (encoder, other)
        ]
        better = near[0] - near[1]
        if better.mean() > better.std() / np.sqrt(len(better)):
            kept = other
    kept.look_offset_ = taught.mean(axis=0) - seen.mean(axis=0)
    return kept, gain if kept is not encoder else 1.0


def learn_nuisance(recogniser: ObjectRecogniser, touches: Touches) -> int:
    """Change a recogniser in place; see `ObjectRecogniser.learn_nuisance`."""
    new = as_touches(touches)
    if new.object is None or new.session is None:
        raise ValueError(
            "touches must have columns 'object' and 'session', to see how the same "
            f"thing differs between sessions, got {', '.join(new.columns) or 'none'}."
        )
    features: Floats = recogniser.encoder_.transform(new)
    codes = np.unique(new.object, return_inverse=True)[1]
    subjects = np.full(len(new), "") if new.subject is None else new.subject
    differences = _sessions.between_sessions(features, codes, new.session, subjects)
    if len(differences) < LEAST_PAIRS:
        raise ValueError(
            f"touches must show at least {LEAST_PAIRS} things in several sessions, "
            f"got {len(differences)} differences. Touch more objects in two sessions."
        )
    other = copy(recogniser)
    other.encoder_ = copy(recogniser.encoder_)
    _weigh_down(other, differences)
    recogniser.__dict__.update(other.__dict__)
    return len(differences)


def check_mounting(
    recogniser: ObjectRecogniser, touches: Touches | Evidence
) -> MountingCheck:
    """See `ObjectRecogniser.check_mounting`."""
    if isinstance(touches, Evidence):
        evidence, reasons = touches, []
    else:
        new = as_touches(touches)
        evidence, reasons = recogniser.evidence(new), _rim_moved(recogniser, new)
    counts = np.array([flag != NO_CONTACT for flag in evidence.flags])
    if not counts.any():
        return MountingCheck(False, -np.inf, np.inf, [*reasons, "Nothing was touched."])
    found = float(evidence.log_distances[counts].min(axis=1).mean())
    posterior = softmax(evidence.log_likelihood[counts], axis=1).mean(axis=0)
    n_objects = max(1, round(_sessions.effective_number(posterior)))
    own, taught = _usual_distances(recogniser)
    n_touches, seed = int(counts.sum()), recogniser.random_state
    drawn, runs = _sessions.usual_means(own, taught, n_touches, n_objects, seed)
    now = np.append(found, evidence.looks[counts].mean(axis=0))
    if np.isnan(drawn).any():  # of a model that kept no looks
        drawn[:, 1:], now[1:] = 0.0, 0.0
    unlike, distance = _sessions.unlikeness(drawn, runs, now)
    # Of a few draws that share no touch even the largest is exceeded often: two signs,
    # each as a t-test.
    n_apart = max(len(np.unique(taught.blocks)) // n_objects, 2)
    least = t_distribution.ppf(1 - FALSE_ALARMS / 2, n_apart - 1)
    least *= np.sqrt(1 + 1 / n_apart)
    usual = float(max(np.quantile(unlike, 1 - FALSE_ALARMS), least))
    if distance > usual:
        reasons.insert(0, _why(drawn, now, usual, n_touches))
    return MountingCheck(distance > usual, distance, usual, reasons)


def _why(drawn: Floats, now: Floats, usual: float, n_touches: int) -> str:
    beyond = (now - drawn.mean(axis=0)) / np.maximum(drawn.std(axis=0), 1e-9)
    beyond[0] = max(beyond[0], 0)  # nearer than usual is no sign
    clear = [k for k in (0, _sessions.N_LOOKS) if abs(beyond[k]) > usual]
    these, most = f"These {n_touches} touches", int(np.abs(beyond).argmax())
    most = clear[0] if clear else most
    times = float(np.exp(abs(now[most] - np.median(drawn[:, most]))))
    if most == 0:
        return (
            f"{these} lie {times:.1f} times as far from training touches as those from "
            "each other."
        )
    way = "weaker" if beyond[most] < 0 else "stronger"
    if most == _sessions.N_LOOKS:
        return f"{these} press {times:.1f} times {way} than training touches."
    detail = "coarse" if most <= _sessions.N_LOOKS // 2 else "fine"
    root = float(np.sqrt(times))
    return f"{these} show {detail} detail {root:.1f} times {way} than training touches."


def _usual_distances(recogniser: ObjectRecogniser) -> tuple[Floats, _sessions.Taught]:
    """Return how far training touches are from other blocks of their sessions.

    What sessions differ by is no use here. Worked out once for a memory.
    """
    memory, some = recogniser.memory_, _counted(recogniser)
    made: Any = getattr(recogniser, "_usual_to", None)
    if made is None or made[0] is not memory:
        visits = np.stack([memory.objects.astype(str), memory.sessions], axis=1)
        visit = np.unique(visits, axis=0, return_inverse=True)[1].ravel()
        blocks = blocks_in_order(visit)
        nearest = Nearest(replace(memory, blocks=blocks))
        far = nearest.log_distances(memory.features, blocks)
        own = np.where(np.isnan(far), np.inf, far).min(axis=1)
        own = np.column_stack([own, memory.looks])[some]
        taught = replace(taught_of(recogniser), blocks=blocks[some])
        recogniser.__dict__["_usual_to"] = made = memory, own, taught
    return made[1], made[2]


def across_sessions(recogniser: ObjectRecogniser) -> dict[str, Any]:
    """Return what the training touches say of another day, as plain values.

    `sessions` per object (least and median), `asked` (touches of objects that another
    session met too) and, where there are any, `expected`: the accuracy after one touch
    of a session that was left out whole.
    """
    memory = recogniser.memory_
    told = memory.sessions != ""
    per_object = [
        len(np.unique(memory.sessions[told & (memory.objects == name)])) or 1
        for name in np.unique(memory.objects)
    ]
    asked, median = _met_elsewhere(memory), float(np.median(per_object))
    result = {"least": min(per_object), "median": median, "asked": int(asked.sum())}
    if asked.any():
        said = _said_of_left_out_sessions(recogniser, memory.features)
        right = recogniser.classes_[said.argmax(axis=1)] == memory.labels
        result["expected"] = float(right[asked].mean())
    return result


def said_of_sessions(across: Mapping[str, Any]) -> str:
    """Return what `across_sessions` found as a sentence for people."""
    least, expected = across["least"], across.get("expected")
    taught = f"Taught in {least} session{'s' if least > 1 else ''} an object"
    if expected is not None:
        return (
            f"{taught}: expect {expected:.0%} right after one touch in another one "
            f"({across['asked']} touches of sessions left out whole)."
        )
    return (
        f"{taught}, and none in two: on another day, or mounted anew, expect less than "
        "today; how much less only touches of another session tell."
    )


def taught_of(recogniser: ObjectRecogniser) -> _sessions.Taught:
    """Return the training touches that count, for comparing a session with them."""
    memory, counts = recogniser.memory_, _counted(recogniser)
    said = left_out_log_likelihood(recogniser.classifier_)
    codes = np.searchsorted(recogniser.classes_, memory.labels)
    return _sessions.Taught(
        memory.features[counts],
        codes[counts],
        memory.blocks[counts],
        softmax(said[counts], axis=1),
        _parts(recogniser),
    )


def _counted(recogniser: ObjectRecogniser) -> Array:
    """Return which training touches count; all of objects that show no contact."""
    memory = recogniser.memory_
    counts = ~memory.nothing | recogniser.uses_no_contact_
    return counts | ~np.isin(memory.labels, memory.labels[counts])


def _without_sessions(recogniser: ObjectRecogniser) -> dict[str, Any]:
    """Take off what training sessions add, where that helps with sessions left out.

    Weighing down how sessions differ comes next, if it helps further. Returns what was
    done.
    """
    memory = recogniser.memory_
    asked = _met_elsewhere(memory)
    if not asked.any():
        return {}
    codes = np.searchsorted(recogniser.classes_, memory.labels)
    centred = memory.features - _sessions.session_effects(
        memory.features, codes, memory.sessions
    )
    loss = {"plain": _loss(recogniser, memory.features, asked)}
    loss["centred"] = _loss(recogniser, centred, asked)
    pairs = _sessions.between_sessions(centred, codes, memory.sessions, memory.subjects)
    # Touches that tell themselves how sessions differ are too sure: other persons must.
    may_weigh = len(np.unique(memory.subjects)) > 1 and len(pairs) >= LEAST_PAIRS
    may_weigh &= recogniser.encoder_.weighing_ is None
    if may_weigh:
        loss["weighed"] = _loss_weighed(recogniser, centred, asked)
    found = {"log_loss": {name: float(one.mean()) for name, one in loss.items()}}
    worse = loss["centred"] - loss["plain"]
    if worse.mean() > worse.std() / np.sqrt(len(worse)):
        return {**found, "centred": False, "weighed": False}
    recogniser.memory_ = replace(memory, features=centred)
    gain = loss["centred"] - loss["weighed"] if may_weigh else np.zeros(1)
    weighs = gain.mean() > LEAST_GAIN
    if weighs:
        recogniser.encoder_ = copy(recogniser.encoder_)
        _weigh_down(recogniser, pairs)
    else:
        recogniser._relearn(recogniser.memory_)
    return {**found, "centred": True, "weighed": bool(weighs)}


def _weigh_down(recogniser: ObjectRecogniser, differences: Floats) -> None:
    encoder, memory = recogniser.encoder_, recogniser.memory_
    weighing = _sessions.weighed_down(differences, memory.features, _parts(recogniser))
    before = encoder.weighing_
    encoder.weighing_ = weighing if before is None else before @ weighing
    if encoder.offset_ is not None:
        encoder.offset_ = encoder.offset_ @ weighing
    recogniser._relearn(replace(memory, features=memory.features @ weighing))


def _loss(recogniser: ObjectRecogniser, features: Floats, asked: Array) -> Floats:
    """Return the log loss (nats) of the asked touches, their session left out whole."""
    said = log_softmax(_said_of_left_out_sessions(recogniser, features), axis=1)
    codes = np.searchsorted(recogniser.classes_, recogniser.memory_.labels)
    return -said[np.arange(len(codes)), codes][asked]


def _loss_weighed(
    recogniser: ObjectRecogniser, centred: Floats, asked: Array
) -> Floats:
    """Return the loss when features are weighed by pairs of other persons.

    In two halves, so that no touch is asked that told how sessions differ.
    """
    memory, loss = recogniser.memory_, np.empty(len(asked))
    half = np.unique(memory.subjects, return_inverse=True)[1] % 2
    codes = np.unique(memory.labels, return_inverse=True)[1]
    for k in range(2):
        told = half != k
        visits = memory.sessions[told], memory.subjects[told]
        pairs = _sessions.between_sessions(centred[told], codes[told], *visits)
        weighing = np.eye(centred.shape[1])
        if len(pairs):
            weighing = _sessions.weighed_down(pairs, centred, _parts(recogniser))
        mine = asked & ~told
        loss[mine] = _loss(recogniser, centred @ weighing, mine)
    return loss[asked]


def _said_of_left_out_sessions(
    recogniser: ObjectRecogniser, features: Floats
) -> Floats:
    memory = recogniser.memory_
    of = np.unique(memory.sessions, return_inverse=True)[1]
    again = copy(recogniser.classifier_).refit(features, memory.labels, groups=of)
    return left_out_log_likelihood(again)


def _met_elsewhere(memory: Memory) -> Array:
    """Return which touches are of an object that another session met too."""
    told = memory.sessions != ""
    met = np.zeros(len(memory), dtype=bool)
    for name in np.unique(memory.labels):
        mine = told & (memory.labels == name)
        if len(np.unique(memory.sessions[mine])) > 1:
            met |= mine
    return met


def _parts(recogniser: ObjectRecogniser) -> _sessions.Parts:
    return _sessions.Parts(np.cumsum([0, *recogniser.encoder_.parts_.values()]))


def _rim_moved(recogniser: ObjectRecogniser, touches: Touches) -> list[str]:
    """Return a sentence where a dome's rim lies elsewhere than it was learnt."""
    crop = recogniser.encoder_.clean_up_
    if not isinstance(crop, DomeCrop) or not crop.has_rim_:
        return []
    there: Any = recogniser.encoder_.moved(touches).clean_up_
    away = np.hypot(there.rim_row_ - crop.rim_row_, there.rim_col_ - crop.rim_col_)
    larger = there.rim_radius_ / crop.rim_radius_ - 1
    if max(away / crop.rim_radius_, abs(larger)) <= RIM_MOVED:
        return []
    size = f"{abs(larger):.0%} {'larger' if larger > 0 else 'smaller'}"
    where = f"{away:.0f} pixels from where it was learnt"
    return [f"The rim lies {where}, and is {size}."]
