"""Learning from a library: the same model, features once, images never all at once."""

import numpy as np
import pytest
from joblib import parallel_config
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, Selection, TouchLibrary
from palpate.recognition import ObjectRecogniser

NAMES = ("ball", "mug", "pen")


def _touches(seed, names=NAMES, n_each=30):
    """Objects are patterns of 3 x 24 values with noise; geometry does not matter."""
    rng = np.random.default_rng(7)
    patterns = {name: rng.normal(size=(3, 24)) for name in (*NAMES, "cap")}
    noise = np.random.default_rng(seed)
    object = np.repeat(names, n_each)
    images = np.array([patterns[o] + 0.7 * noise.normal(size=(3, 24)) for o in object])
    return Touches(
        images,
        object=object,
        order=np.tile(np.arange(n_each), len(names)),
        geometry="none",
    )


@pytest.fixture
def library(tmp_path):
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        opened.add(_touches(0), episode="first")
        yield opened


@pytest.fixture
def counted(monkeypatch):
    """How many touches of a library were encoded, one entry per call."""
    calls = []
    features = Selection.features

    def counting(self, key, encode):
        def encode_counted(touches):
            calls.append(len(touches))
            return encode(touches)

        return features(self, key, encode_counted)

    monkeypatch.setattr(Selection, "features", counting)
    return calls


@pytest.fixture
def shown(monkeypatch):
    """Places of the touches whose images were read, one entry per call."""
    calls = []
    touches = Selection.touches

    def showing(self, rows):
        calls.append(np.asarray(rows))
        return touches(self, rows)

    monkeypatch.setattr(Selection, "touches", showing)
    return calls


def test_a_library_teaches_what_its_touches_teach(library):
    held = ObjectRecogniser().fit(library.touches())
    read = ObjectRecogniser().fit(library.select())
    tested = _touches(1)
    # Every step is the same but for the size of the blocks that are encoded.
    assert_allclose(
        read.log_likelihood(tested), held.log_likelihood(tested), atol=1e-10
    )
    assert read.chosen_ == held.chosen_


def test_features_are_computed_once(library, counted):
    ObjectRecogniser("corradi2015").fit(library.select())
    assert sum(counted) == 90
    counted.clear()
    ObjectRecogniser("corradi2015").fit(library.select())
    assert counted == []
    library.add(_touches(2, ("pen",), 4), episode="second")
    ObjectRecogniser("corradi2015").fit(library.select())
    # PCA is learnt anew from other touches: another encoder, so nothing is kept.
    assert sum(counted) == 94


def test_an_object_is_added_from_its_new_episodes_alone(library, counted):
    recogniser = ObjectRecogniser().fit(library.select())
    counted.clear()
    library.add(_touches(3, ("cap",)), episode="second")
    recogniser.add_object("cap", library.select("episode = second"))
    assert sum(counted) == 30
    assert "cap" in recogniser.classes_
    belief = recogniser.start().update(_touches(4, ("cap",), 5))
    assert belief.best == "cap"


def test_an_encoding_is_learnt_from_some_touches_of_each_label(tmp_path, shown):
    """Of 2,020 touches some 2,000 are shown, of each of three labels a third."""
    parts = [_touches(6, ("ball",), 1990), _touches(7, ("mug", "pen"), 15)]
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(Touches.concatenate(parts))
        read = ObjectRecogniser().fit(library.select())
    [rows] = shown
    assert (np.diff(rows) > 0).all()
    assert (rows >= 1990).sum() == 30
    assert len(rows) == 2000 // 3 + 30
    assert len(read.memory_.features) == 2020
    answer = read.log_likelihood(_touches(5)).argmax(axis=1)
    assert (read.classes_[answer] == _touches(5).object).mean() > 0.9


def test_an_encoding_is_learnt_from_all_of_a_few_touches(library, shown):
    ObjectRecogniser("corradi2015").fit(library.select())
    assert_array_equal(shown[0], np.arange(90))


def test_features_are_the_same_from_one_process_and_two(library):
    """More touches than are encoded at once."""
    library.add(_touches(8, n_each=400))
    chosen = library.select()
    one = chosen.features("one", _means)
    assert_array_equal(one, library.touches().images.mean(axis=2))
    with parallel_config("threading", n_jobs=2):
        assert_array_equal(chosen.features("two", _means), one)


def _means(touches):
    return touches.images.mean(axis=2)


def test_a_damaged_cache_is_computed_again(library):
    chosen = library.select()
    first = chosen.features("means", _means)
    for path in (library.folder / "features").rglob("*.npz"):
        path.write_bytes(path.read_bytes()[:-3])
    assert_array_equal(chosen.features("means", _means), first)
    with pytest.raises(ValueError, match="letters and digits"):
        chosen.features("../x", _means)


def test_a_selection_knows_the_ids_of_its_touches(library):
    """One id in 256 ends in a byte of zero, which is a part of it."""
    ids = library.add(_touches(9, ("cap",), 600))
    assert library.select("object = cap").touch_id.tolist() == ids
    assert any(key.endswith("00") for key in ids)


def test_a_selection_reads_what_is_asked_for(library):
    chosen = library.select("object = mug")
    assert len(chosen) == 30
    assert set(chosen.object) == {"mug"}
    assert chosen.category is None
    some = chosen.touches([2, 5])
    assert_array_equal(some.images, library.touches("object = mug").images[[2, 5]])
    with pytest.raises(LibraryError, match="that rise"):
        chosen.touches([5, 2])
    with pytest.raises(LibraryError, match="at least one touch"):
        library.select("object = nobody")


@pytest.mark.realdata
@pytest.mark.slow
def test_real_touches_learn_alike_from_a_library(tmp_path, data_folder):
    """Five objects of the dome camera, a fifth of their touches."""
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    some = np.isin(touches.object, np.unique(touches.object)[:5])
    touches = touches[np.flatnonzero(some)[::5]]
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(touches)
        read = ObjectRecogniser("corradi2015").fit(library.select())
    held = ObjectRecogniser("corradi2015").fit(touches)
    assert_allclose(read.memory_.features, held.memory_.features, atol=1e-9)
