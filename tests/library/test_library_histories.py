"""Random histories of changes, kills and repairs; `tests/fuzz/machines.py` plays them.

A writer that is killed between writing the file of a change and the commit has told
nobody of it. It is played by putting the database back as it was before the change.
"""

import numpy as np
import pytest
from machines import LibraryMachine, play

from palpate import Touches
from palpate.library import TouchLibrary


@pytest.mark.parametrize("seed", range(2))
def test_repairs_never_undo_what_was_acknowledged(seed):
    play(LibraryMachine, seed, n_sequences=8)


@pytest.mark.slow
def test_many_histories():
    play(LibraryMachine, 100, n_sequences=300)


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
