"""State machines: orders in any sequence, beside references that are simple dicts.

`play(machine, seed)` tries some sequences of one seed. Hypothesis prints a sequence
that fails, as short as it can make it.
"""

import copy
import json
import math
import pickle
import shutil
import tempfile
import time
from functools import cache
from pathlib import Path
from unittest import mock

import hypothesis
import numpy as np
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from palpate import ObjectRecogniser, Touches
from palpate.library import LibraryError, TouchLibrary, check_library
from palpate.sensors import LiveSensor, SensorError
from palpate.web import LiveSession
from palpate.web._learning import learn_job

names = st.sampled_from("abcde")


def play(machine, seed, n_sequences=1, n_steps=25):
    """Try sequences of steps that follow from a seed."""
    phases = (Phase.explicit, Phase.generate, Phase.shrink)
    chosen = settings(
        max_examples=n_sequences,
        stateful_step_count=n_steps,
        deadline=None,
        database=None,
        phases=phases,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    run_state_machine_as_test(hypothesis.seed(seed)(machine), settings=chosen)


SESSION_ERRORS = ValueError, SensorError


def assert_refused(order, state, errors=(ValueError, TypeError)):
    """Fail where an order is not refused, or changes what `state` returns."""
    before = state()
    try:
        order()
    except errors:
        assert state() == before
    else:
        raise AssertionError("was not refused")


class Names:
    """The object of each touch and whether it is retracted: `touches` by id."""

    def __init__(self):
        self.touches, self.into, self.names = {}, {}, set()

    def add(self, ids, label):
        label = self.into.get(label, label)
        self.names.add(label)
        self.touches |= {key: [label, False] for key in ids}

    def rename(self, old, new):
        old = self.into.get(old, old)
        if old not in self.names or new in self.names:
            return False
        self.names = self.names - {old} | {new}
        self._call(old, new)
        return True

    def merge(self, source, into):
        source, into = self.into.get(source, source), self.into.get(into, into)
        if source == into or not {source, into} <= self.names:
            return False
        self._call(source, into)
        self.into[source] = into
        return True

    def _call(self, old, new):
        self.into = {n: new if to == old else to for n, to in self.into.items()}
        for touch in self.touches.values():
            touch[0] = new if touch[0] == old else touch[0]

    def set_retracted(self, ids, retracted):
        """Retract or restore touches; return whether that changes anything."""
        n_changed = sum(self.touches[key][1] != retracted for key in ids)
        for key in ids:
            self.touches[key][1] = retracted
        return bool(n_changed)


class LibraryMachine(RuleBasedStateMachine):
    """A library that is changed, killed, checked, repaired and copied."""

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp()) / "library"
        self.truth, self.n_images, self.n_copies = Names(), 0, 0
        TouchLibrary.open(self.folder, create=True).close()

    def teardown(self):
        self.check()
        shutil.rmtree(self.folder.parent)

    @rule(label=names, n_touches=st.integers(1, 3))
    def add(self, label, n_touches):
        with TouchLibrary.open(self.folder) as library:
            self._add_to(library, label, n_touches)

    def _add_to(self, library, label, n_touches):
        images = np.zeros((n_touches, 2, 2), np.int32)
        images[:, 0, 0] = self.n_images + np.arange(n_touches)
        self.n_images += n_touches
        ids = library.add(Touches(images, object=[label] * n_touches))
        assert library.add(Touches(images, object=[label] * n_touches)) == ids
        self.truth.add(ids, label)

    @rule(two=st.lists(names, min_size=2, max_size=2, unique=True), merge=st.booleans())
    def rename_or_merge(self, two, merge):
        with TouchLibrary.open(self.folder) as library:
            try:
                (library.merge_objects if merge else library.rename_object)(*two)
            except LibraryError:
                return
        assert (self.truth.merge if merge else self.truth.rename)(*two), two

    @precondition(lambda self: self.truth.touches)
    @rule(data=st.data(), out=st.booleans())
    def retract_or_restore(self, data, out):
        places = st.sets(
            st.integers(0, len(self.truth.touches) - 1), min_size=1, max_size=3
        )
        ids = [[*self.truth.touches][place] for place in sorted(data.draw(places))]
        with TouchLibrary.open(self.folder) as library:
            changed = (
                library.retract(ids, reason="wet") if out else library.restore(ids)
            )
        assert bool(changed) == self.truth.set_retracted(ids, out)

    @rule(label=names)
    def kill(self, label):
        """A killed writer leaves acknowledged touches in a log that nobody emptied."""
        with TouchLibrary.open(self.folder) as library:
            self._add_to(library, label, 1)
            self.n_copies += 1
            copy = self.folder.with_name(f"{self.n_copies}")
            shutil.copytree(self.folder, copy)
        assert (copy / "library.sqlite-wal").stat().st_size
        (copy / "library.sqlite-shm").unlink(missing_ok=True)
        self.folder = copy

    @rule()
    def copy(self):
        self.n_copies += 1
        copy = self.folder.with_name(f"{self.n_copies}")
        with TouchLibrary.open(self.folder) as library:
            assert library.backup(copy) == len(self.truth.touches)
        self.folder = copy

    @rule()
    def repair(self):
        assert not TouchLibrary.repair_folder(self.folder).rebuilt

    @rule()
    def check(self):
        assert str(check_library(self.folder)).count("all present") == 1
        with TouchLibrary.open(self.folder) as library:
            rows = library.list(limit=None, retracted=True)
            history = library.history()
        touches = {row.id: [row.object, row.retracted] for row in rows}
        assert list(touches.items()) == list(self.truth.touches.items())
        assert [change.after for change in history] == sorted(c.after for c in history)


@cache
def recognisers():
    """Return a recogniser of four objects that differ clearly, and one of noise."""
    rng = np.random.default_rng(0)
    labels = np.repeat(list("abcd"), 4)
    cases = []
    for spread in (0.05, 30.0):
        patterns = np.repeat(rng.normal(size=(4, 3, 8)), 4, axis=0)
        images = patterns + spread * rng.normal(size=patterns.shape)
        kinds = np.repeat(["soft", "hard"], 8)
        touches = Touches(images, object=labels, category=kinds, geometry="none")
        recogniser = ObjectRecogniser().fit(touches)
        recogniser.learn_modality("sight", images[:, 0, :2], labels)
        cases.append((recogniser, images))
    return cases


numbers = st.one_of(
    st.floats(-1e3, 0), st.sampled_from([0.0, -1e6, 1e6, -1e308, 1e308, -math.inf])
)
log_likelihoods_of_four = st.lists(numbers, min_size=4, max_size=4)
errors = st.sampled_from([1e-6, 0.01, 0.05, 0.5])


class BeliefMachine(RuleBasedStateMachine):
    """A belief stays a probability through updates, copies, pickles and decisions.

    `entered` is every log-likelihood that entered it: one update with all of them
    must give the same belief.
    """

    @initialize(number=st.sampled_from([0, 1]))
    def start(self, number):
        self.recogniser, self.images = recognisers()[number]
        self.belief, self.entered, self.senses = self.recogniser.start(), [], []

    @rule(places=st.lists(st.integers(0, 15), min_size=1, max_size=3))
    def touch(self, places):
        evidence = self.recogniser.evidence(self.images[places])
        self.belief.update(evidence)
        self.entered.append(evidence.log_likelihood)

    @rule(row=log_likelihoods_of_four.filter(lambda row: max(row) > -math.inf))
    def update_from_log_likelihood(self, row):
        self.belief.update_from_log_likelihood([row])
        self.entered.append(np.array([row]))

    @rule(n_times=st.sampled_from([10, 100, 2000]), place=st.integers(0, 15))
    def touch_again_and_again(self, n_times, place):
        log_likelihood = self.recogniser.evidence(self.images[[place]]).log_likelihood
        self.belief.update_from_log_likelihood(
            np.repeat(log_likelihood, n_times, axis=0)
        )
        self.entered.append(np.repeat(log_likelihood, n_times, axis=0))

    @rule(place=st.integers(0, 15))
    def update_sense(self, place):
        features = self.images[place, 0, :2]
        self.belief.update_sense("sight", features)
        self.senses.append(features)

    @rule(
        bad=st.sampled_from(
            [
                (np.zeros((1, 3)), {}),
                ([[math.nan] * 4], {}),
                ([[-math.inf] * 4], {}),
                (np.zeros((2, 4)), {"by_encoding": np.zeros((2, 9, 4))}),
                (np.zeros((2, 4)), {"by_encoding": np.zeros((1, 1, 3))}),
                (np.zeros((2, 4)), {"log_distances": np.zeros((1, 3))}),
                (np.zeros((2, 4)), {"features": np.zeros((1, 2))}),
                (np.zeros((2, 4)), {"flags": [""]}),
            ]
        )
    )
    def bad_log_likelihood_is_refused(self, bad):
        log_likelihood, others = bad
        update = self.belief.update_from_log_likelihood
        assert_refused(lambda: update(log_likelihood, **others), self._answers)

    @rule(image=st.sampled_from([np.zeros((2, 2)), np.full((3, 8), np.inf), "x"]))
    def bad_image_is_refused(self, image):
        assert_refused(lambda: self.belief.update(image), self._answers)

    @rule(copier=st.sampled_from([copy.copy, copy.deepcopy, pickle.dumps]))
    def copy_and_go_on(self, copier):
        """A copy and the belief do not change each other."""
        other = copier(self.belief)
        other = pickle.loads(other) if copier is pickle.dumps else other
        before = self._answers()
        assert self._answers(other) == before
        other.update(self.images[0])
        other.update_sense("sight", self.images[0, 0, :2])
        assert self._answers() == before
        before = self._answers(other)
        self.touch([1])
        assert self._answers(other) == before

    @rule(error=errors, refusal=errors, level=st.sampled_from(["object", "any"]))
    def decide(self, error, refusal, level):
        belief = self.belief
        options = {"error": error, "refusal": refusal, "level": level}
        decision = belief.decide(**options)
        assert decision == belief.decide(**options)
        reason = belief.reason(**options)
        name = decision if level == "object" else getattr(decision, "name", None)
        shares = {**belief.posterior, **belief.categories}
        if name is None:
            ends = "touch again", "touch it", "at other places", "if it is new"
            assert reason.endswith(ends)
            assert max(belief.posterior.values()) < 1 - error + 1e-12
            assert belief.unknown < 1 - refusal + 1e-12 or not belief.touches_used
        elif name == "unknown":
            assert reason.startswith("nothing I know (")
            assert belief.unknown >= 1 - refusal - 1e-12
        else:
            assert reason.startswith((name, "a "))
            assert shares[name] >= 1 - error - 1e-12
        if belief.touches_used == 0 and not self.senses:
            assert decision is None

    @rule()
    def show(self):
        html = self.belief._repr_html_()
        assert html.count("<tr>") == 5
        assert "nan" not in html + repr(self.belief)
        json.dumps(self.belief.explain(), allow_nan=False)

    @invariant()
    def it_is_a_probability(self):
        if not hasattr(self, "belief"):
            return
        belief = self.belief
        for shares in (belief.posterior, belief.categories):
            assert all(0 < share <= 1 + 1e-12 for share in shares.values()), shares
            assert sum(shares.values()) <= 1 + 1e-9
        assert abs(sum(belief.posterior.values()) + belief.unknown - 1) < 1e-9
        assert np.isfinite(belief.log_posterior).all()
        assert 0 <= belief.unknown <= 1
        assert belief.posterior[belief.best] == max(belief.posterior.values())
        assert abs(belief.doubt - (1 - belief.posterior[belief.best])) < 1e-9
        assert belief.touches_used == sum(map(len, self.entered)) == len(belief.flags)

    def teardown(self):
        """One update with all that entered gives the belief of the many updates."""
        if not hasattr(self, "belief"):
            return
        once = self.recogniser.start()
        if self.entered:
            once.update_from_log_likelihood(np.concatenate(self.entered))
        if self.senses:
            once.update_sense("sight", np.stack(self.senses))
        # Sums are in another order: a part in 1e9 of the sum.
        np.testing.assert_allclose(
            self.belief.log_posterior, once.log_posterior, rtol=1e-9, atol=1e-6
        )

    def _answers(self, belief=None):
        belief = self.belief if belief is None else belief
        answers = (
            belief.posterior,
            belief.unknown,
            belief.touches_used,
            tuple(belief.flags),
        )
        return repr((*answers, belief.explain(), belief.decide(), belief.categories))


class PressedArray(LiveSensor):
    """An array of 6 x 8 that reads a rest frame, or what presses it."""

    def __init__(self):
        super().__init__("pressed", "count", (6, 8), np.uint8, "none")
        self.idle_frame, self.press = np.full((6, 8), 20, np.uint8), None

    def _open(self):
        pass

    def _grab(self):
        time.sleep(0.001)
        return [self.idle_frame if self.press is None else self.press]

    def _close(self):
        pass


def press_of(name, number):
    """Return the frame of an object that presses, a little different by number."""
    image = np.full((6, 8), 20, np.uint8)
    column = "abcde".index(name)
    image[1:4, column : column + 3] = 150 + number % 50
    image[4, number % 8] = 60 + number % 7
    return image


def until(condition, seconds=20.0):
    """Wait until a condition holds; fail after `seconds`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.001)


class SessionMachine(RuleBasedStateMachine):
    """The live page's session, with hands on the sensor and orders in any sequence.

    Learning runs in this process. Every stored touch stays in `truth` until it is
    retracted, whatever else happens.
    """

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp()) / "library"
        self.learning_here = mock.patch(
            "palpate.web._session.learn_in_process", learn_job
        )
        self.learning_here.start()
        self.truth, self.number = Names(), 0
        self.learnt, self.undoable = None, []
        self._open()

    def _open(self):
        self.sensor = PressedArray()
        self.session = LiveSession(self.sensor, library=self.folder).start()
        self.lesson = None
        self.has_baseline = self.had_baseline = False
        self.asking = self.pressed = False
        self.n_touches, self.n_before, self.closed = 0, 0, False

    def teardown(self):
        self.session.stop()
        self.learning_here.stop()
        shutil.rmtree(self.folder.parent)

    @rule()
    def start_again(self):
        self.session.stop()
        self._open()

    @rule(name=names)
    def touch(self, name):
        """Press the sensor once; the touch goes to the lesson or to the episode."""
        watch, n_episode = self.session.watch, self._n_touches()
        n_stored, n_tried = self._n_stored(), watch._n_presses
        self.number += 1
        seen = self.sensor.n_frames
        self.sensor.press = press_of(name, self.number)
        if self.has_baseline:
            until(lambda: watch.detector.touching)
        until(lambda: self.sensor.n_frames > seen + 6)
        self.sensor.press = None
        until(lambda: not watch.detector.touching)
        if not self.has_baseline:
            return
        if self.asking:
            until(lambda: watch._n_presses == n_tried + 1)
            self.pressed = True
        elif self.lesson is not None:
            until(lambda: self._n_stored() == n_stored + 1)
            self._stored(self.lesson[0])
            self.lesson[2] += 1
            if self.lesson[2] == self.lesson[1]:
                self.lesson = None
        else:
            fresh = self.closed
            until(lambda: self._n_touches() == (1 if fresh else n_episode + 1))
            self._touch_counted()

    @rule(name=names)
    def post_touch(self, name):
        self.number += 1
        self.session.post_touch(press_of(name, self.number))
        self._touch_counted()

    @rule(name=names)
    def post_lesson(self, name):
        self.number += 1
        self.session.post_lesson(name, press_of(name, self.number))
        self._stored(name)

    @rule(two=st.lists(names, min_size=2, max_size=2, unique=True))
    def post_enough_to_learn(self, two):
        for name in two * 2:
            self.post_lesson(name)

    @rule(name=names, wanted=st.integers(1, 3), keep=st.booleans())
    def teach(self, name, wanted, keep):
        # Those from before the baseline are not kept.
        n_kept = min(wanted, self.n_touches - self.n_before) if keep else 0
        self.session.teach(name, wanted, keep_episode=keep)
        self.lesson, self.asking, self.pressed = [name, wanted, n_kept], False, False
        rows = self._rows()
        for row in rows[len(rows) - n_kept :]:
            self.truth.add([row.id], name)
            self.undoable.append(("taught", [row.id]))
        if n_kept == wanted:
            self.lesson = None
        self._begun()

    @rule()
    def stop_teaching(self):
        self.session.stop_teaching()
        self.lesson = None

    @rule()
    def undo(self):
        """The last action of which something is left is taken back."""
        keys = []
        while self.undoable and not keys:
            kind, of_action = self.undoable.pop()
            is_out = kind == "forgotten"
            keys = [key for key in of_action if self.truth.touches[key][1] == is_out]
        if not keys:
            assert_refused(self.session.undo, self._rows, SESSION_ERRORS)
            return
        self._leave_lesson(() if is_out else keys)
        assert self.session.undo() == self.truth.touches[keys[0]][0]
        self.truth.set_retracted(keys, not is_out)

    @rule(ask=st.booleans())
    def baseline(self, ask):
        self.session.take_baseline(ask_press=ask)
        self.had_baseline, self.has_baseline = self.has_baseline, True
        self.asking, self.pressed = ask, False
        self.n_before = self.n_touches

    @rule()
    def undo_baseline(self):
        self.session.end_press(undo=True)
        self.has_baseline, self.asking, self.pressed = self.had_baseline, False, False
        self.n_before = self.n_touches

    @rule()
    def end_press(self):
        self.session.end_press()
        self.asking = self.pressed = False

    @rule()
    def press_difference(self):
        if self.pressed and self.has_baseline:
            assert self.session.press_difference().max() > 100
        else:
            assert_refused(self.session.press_difference, self._rows, SESSION_ERRORS)

    @rule(old=names, new=names, merge=st.booleans())
    def rename(self, old, new, merge):
        reference = copy.deepcopy(self.truth)
        allowed = bool(self._counts().get(old)) and (
            reference.merge(old, new) if merge else reference.rename(old, new)
        )
        try:
            self.session.rename(old, new, merge=merge)
        except ValueError:
            few = self._counts().get(old, 0) < 2
            assert not allowed or (old in (self.learnt or ()) and few)
        else:
            assert allowed, (old, new, merge)
            self.truth = reference
            if self.lesson is not None and self.lesson[0] == old:
                self.lesson[0] = new
            self._learnt_again()

    @rule(name=names)
    def forget(self, name):
        if not self._counts().get(name) and name not in (self.learnt or ()):
            assert_refused(
                lambda: self.session.forget(name), self._rows, SESSION_ERRORS
            )
            return
        stored = [k for k, v in self.truth.touches.items() if v == [name, False]]
        self._leave_lesson(stored)
        self.session.forget(name)
        self.truth.set_retracted(stored, True)
        if stored:
            self.undoable.append(("forgotten", stored))
        self._learnt_again()

    @rule()
    def learn(self):
        self.session.learn(wait=True)
        self._learnt()

    @rule()
    def begin_episode(self):
        self.session.begin_episode()
        self._begun()

    @rule()
    def end_episode(self):
        self.session.end_episode()
        self.closed = True

    @invariant()
    def the_page_says_what_is_so(self):
        state = json.loads(json.dumps(self.session.to_dict(), allow_nan=False))
        counts = {row["name"]: row["n_touches"] for row in state["library"]["objects"]}
        assert counts == self._counts()
        lesson = state["lesson"] and [state["lesson"][k] for k in _LESSON]
        assert lesson == self.lesson
        assert state["library"]["undoable"] == len(self.undoable) or self.undoable
        assert len(state["episode"]["touches"]) == self.n_touches
        assert state["sensor"]["baseline"] == self.has_baseline
        assert (state["sensor"]["press"] is not None) == self.asking
        learnt = state["model"] and state["model"]["objects"]
        assert learnt == self.learnt
        assert self.session.model_path.exists() == (learnt is not None)
        assert not state["learning"]

    def _leave_lesson(self, keys):
        if self.lesson is not None:
            self.lesson[2] -= len({*keys} & {*self.session.teacher.lesson.ids})

    def _learnt_again(self):
        if self.learnt is not None:
            until(lambda: not self.session.learning)
            self._learnt()

    def _learnt(self):
        learnt = sorted(name for name, n in self._counts().items() if n > 1)
        self.learnt = learnt if len(learnt) > 1 else None
        assert bool(self.session.learn_error) == (self.learnt is None)
        self._begun()

    def _begun(self):
        self.n_touches, self.n_before, self.closed = 0, 0, False

    def _touch_counted(self):
        if self.closed:
            self.n_touches = self.n_before = 0
        self.n_touches += 1
        self.closed = False

    def _stored(self, name):
        key = self._rows()[-1].id
        self.truth.add([key], name)
        self.undoable.append(("taught", [key]))

    def _counts(self):
        labels = [name for name, out in self.truth.touches.values() if not out]
        return {name: labels.count(name) for name in sorted(set(labels))}

    def _rows(self):
        return self.session.teacher.library.list(limit=None, retracted=True)

    def _n_stored(self):
        return len(self._rows())

    def _n_touches(self):
        return len(self.session.episode.touches)


_LESSON = "name", "wanted", "done"
MACHINES = {
    "library": LibraryMachine,
    "belief": BeliefMachine,
    "session": SessionMachine,
}
