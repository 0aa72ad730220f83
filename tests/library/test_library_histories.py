"""Random histories of changes, kills and repairs against a simple reference.

A writer that is killed between writing the file of a change and the commit has told
nobody of it. It is played by putting the database back as it was before the change.
"""

import copy
import random
import shutil

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, check_library, repair_library

NAMES = ("a", "b", "c", "d", "e")


class Reference:
    """What touches are called and whether they are in: `known` by id."""

    def __init__(self):
        self.known, self.into, self.names = {}, {}, set()

    def add(self, ids, label):
        self.names.add(label)
        self.known |= {key: [self.into.get(label, label), False] for key in ids}

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
        for touch in self.known.values():
            touch[0] = new if touch[0] == old else touch[0]

    def retract(self, ids):
        return self._put(ids, True)

    def restore(self, ids):
        return self._put(ids, False)

    def _put(self, ids, out):
        n_changed = sum(self.known[key][1] != out for key in ids)
        for key in ids:
            self.known[key][1] = out
        return bool(n_changed)


class History:
    """A library and its reference; `after_kill` is this after the killed change."""

    def __init__(self, folder, rng):
        self.folder, self.rng, self.truth = folder, rng, Reference()
        self.killed = self.after_kill = None
        self.n_images = 0
        TouchLibrary.open(folder, create=True).close()

    def step(self):
        steps = [self.add] * 3 + [self.change] * 4 + [self.kill] * 2
        self.rng.choice([*steps, self.repair, self.lose, self.check])()

    def add(self):
        label, n_touches = self.rng.choice(NAMES), self.rng.randint(1, 3)
        images = np.zeros((n_touches, 2, 2), np.int32)
        images[:, 0, 0] = self.n_images + np.arange(n_touches)
        self.n_images += n_touches
        with TouchLibrary.open(self.folder) as library:
            ids = library.add(Touches(images, object=[label] * n_touches))
        for reference in filter(None, (self.truth, self.after_kill)):
            reference.add(ids, label)

    def change(self):
        what = self._chosen()
        if self._carried_out(what):
            assert self._apply(self.truth, what)
            self.killed = self.after_kill = None

    def kill(self):
        database = self.folder / "library.sqlite"
        before = database.read_bytes()
        what = self._chosen()
        if self._carried_out(what):
            database.write_bytes(before)
            self.killed, self.after_kill = what, copy.deepcopy(self.truth)
            self._apply(self.after_kill, what)

    def repair(self):
        repair_library(self.folder)
        if self.killed:
            self._apply(self.truth, self.killed)
        self._mended()

    def lose(self):
        if not self.truth.known:
            return  # an empty library leaves no files
        (self.folder / "library.sqlite").unlink()
        assert repair_library(self.folder).rebuilt
        self.truth = self.after_kill or self.truth
        self._mended()

    def check(self):
        problems = check_library(self.folder).problems
        assert {problem.kind for problem in problems} <= {"change"}
        with TouchLibrary.open(self.folder) as library:
            rows = library.list(limit=None, retracted=True)
        assert {r.id: [r.object, r.retracted] for r in rows} == self.truth.known

    def _mended(self):
        self.killed = self.after_kill = None
        assert check_library(self.folder).ok
        self.check()

    def _chosen(self):
        ids = [*self.truth.known]
        some = self.rng.sample(ids, min(len(ids), 3))
        two = self.rng.sample(NAMES, 2)
        return self.rng.choice(
            [("rename", two), ("merge", two), ("retract", [some]), ("restore", [some])]
        )

    @staticmethod
    def _apply(reference, what):
        return getattr(reference, what[0])(*what[1])

    def _carried_out(self, what):
        action, values = what
        with TouchLibrary.open(self.folder) as library:
            try:
                if action == "rename":
                    library.rename_object(*values)
                elif action == "merge":
                    library.merge_objects(*values)
                elif action == "retract":
                    return bool(library.retract(*values, reason="wet"))
                else:
                    return bool(library.restore(*values))
            except LibraryError:
                return False
        return True


def _play(folder, seed, n_steps):
    history = History(folder, random.Random(seed))
    for _ in range(n_steps):
        history.step()
    history.repair()
    history.lose()
    shutil.rmtree(folder)


@pytest.mark.parametrize("seed", range(8))
def test_repairs_never_undo_what_was_acknowledged(tmp_path, seed):
    _play(tmp_path / "library", seed, 15)


@pytest.mark.slow
def test_many_histories(tmp_path):
    for seed in range(100, 250):
        _play(tmp_path / "library", seed, 25)


def test_a_change_that_nobody_was_told_of_is_set_aside_and_told(tmp_path):
    """The retraction of a killed writer came before a rename that was acknowledged."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        ids = library.add(Touches(np.zeros((1, 2, 2)), object=["a"]))
    before = (tmp_path / "library.sqlite").read_bytes()
    with TouchLibrary.open(tmp_path) as library:
        library.retract(ids, reason="wet")
    (tmp_path / "library.sqlite").write_bytes(before)
    with TouchLibrary.open(tmp_path) as library:
        library.rename_object("a", "b")
        assert "sets it aside" in str(library.check())
        done = library.repair()
        assert (done.n_changes, done.n_unacknowledged) == (0, 1)
        assert [row.object for row in library.list()] == ["b"]
        assert library.check().ok
    assert len(list(tmp_path.glob("damaged/*/*.json"))) == 1
