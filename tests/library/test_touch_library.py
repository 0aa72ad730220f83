"""A library of touches: what goes in comes out, and nothing is lost or doubled."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from machines import LibraryMachine, play
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, SensorDescription, TouchLibrary

from .conftest import assert_alike, outcome_elsewhere


@pytest.fixture
def cups(rng):
    return Touches(
        rng.integers(0, 255, (6, 5, 7), dtype=np.uint8),
        object=["cup"] * 3 + ["pen"] * 3,
        category=["vessel"] * 3 + ["tool"] * 3,
        order=np.arange(6, dtype=np.int16),
        session=["a", "a", "b", "a", "a", "b"],
        force_n=np.array([0.1, np.nan, 0.3, 0.4, 0.5, 0.6]),
        position_mm=rng.normal(size=(6, 3)).astype(np.float32),
        clicks=rng.integers(0, 9, (6, 2, 2)),
        pressed=np.array([True, False] * 3),
        frames=rng.normal(size=(6, 3, 5, 7)),
        no_contact=np.full((5, 7), 9, np.uint8),
        geometry="array",
        set_pitch_mm=2.5,
    )


def test_what_is_added_comes_back(library, cups):
    ids = library.add(cups)
    again = library.touches()
    assert_alike(again, cups)
    assert list(again.columns) == list(cups.columns)
    assert_array_equal(library.image(ids[4]), cups.images[4])
    assert_array_equal(library.no_contact(), cups.no_contact)
    assert_array_equal(library.no_contact("b"), cups.no_contact)
    assert library.no_contact("elsewhere") is None


def test_the_same_touch_is_one_even_with_a_better_category_or_a_new_column(
    library, cups
):
    first = library.add(cups.without("category", "clicks"))
    assert library.add(cups) == first
    assert library.add(cups[[4, 1]]) == [first[4], first[1]]
    assert len(library) == len(set(first)) == 6


def test_the_same_image_of_another_object_or_session_is_another_touch(library, cups):
    library.add(cups)
    library.add(cups.with_columns(object=["mug"] * 6))
    library.add(cups, session="tuesday")
    library.add(cups, episode="e7")
    assert len(library) == 24


def test_one_touch_at_a_time_equals_all_at_once(tmp_path, cups):
    with TouchLibrary.open(tmp_path / "one", create=True) as one_by_one:
        ids = [key for touch in cups for key in one_by_one.add(touch)]
        with TouchLibrary.open(tmp_path / "all", create=True) as all_at_once:
            assert all_at_once.add(cups) == ids
            assert_array_equal(
                all_at_once.touches().images, one_by_one.touches().images
            )


def test_what_is_infinite_leaves_the_touches_beside_it_as_they_are(library, cups):
    force, time_s = np.linspace(0.5, 1, 6), np.arange(6.0)
    force[0] = time_s[1] = np.inf
    touches = cups.with_columns(force_n=force, time_s=time_s)
    ids = library.add(touches)
    assert [library.add(touch)[0] for touch in touches] == ids
    assert [row.id for row in library.list("force_n > 0")] == ids[1:]
    assert len(library) == 6
    assert_array_equal(library.touches().columns["force_n"], force)


def test_objects_are_counted_with_their_episodes(library, cups):
    library.add(cups)
    assert library.objects() == [("cup", "vessel", 3, 2), ("pen", "tool", 3, 2)]
    library.merge_objects("cup", "pen")
    assert library.objects() == [("pen", "tool", 6, 2)]


def test_rows_are_listed_without_reading_an_image(library, cups, alter):
    library.add(cups)
    alter(library.folder, "DELETE FROM images")
    rows = library.list(limit=2, offset=3)
    assert [row.order for row in rows] == [3, 4]
    assert rows[0].object == "pen"
    assert (rows[0].n_rows, rows[0].n_cols, rows[0].dtype) == (5, 7, "|u1")
    assert library.list("force_n is null")[0].force_n is None
    assert (len(library), library.count("object = cup and order < 2")) == (6, 2)
    json.dumps(rows[0]._asdict())


def test_sensors_are_described(library, cups):
    plain = cups.without("set_pitch_mm", "geometry")
    sensor = SensorDescription("pad 3", "array", "kPa", 4.0, "array")
    library.add(plain, sensor=sensor)
    assert library.sensors() == [sensor]
    again = library.touches("sensor = 'pad 3' and unit = kPa and pitch_mm > 3")
    assert again.geometry == "array"
    assert float(again.whole["set_pitch_mm"]) == 4.0
    assert str(again.whole["set_unit"]) == "kPa"
    with pytest.raises(ValueError, match="sensor name must be a text"):
        library.add(plain, sensor=SensorDescription(""))


def test_what_a_repair_lost_is_added_again(library, cups, alter):
    ids = library.add(cups)
    alter(library.folder, "DELETE FROM images WHERE number > 2")
    assert library.repair().lost == ids[2:]
    assert library.add(cups) == ids
    assert_alike(library.touches(), cups)
    assert library.check().ok


@pytest.mark.parametrize(
    ("make", "create", "match"),
    [
        (Path.mkdir, False, r"got no library\.sqlite"),
        (
            lambda path: (path / "mug").mkdir(parents=True),
            True,
            r"got mug in it\. Give",
        ),
        (Path.touch, True, "desk must be a folder, got a file"),
    ],
    ids=["none", "pictures", "file"],
)
def test_what_is_no_library_is_refused_and_left_alone(tmp_path, make, create, match):
    make(tmp_path / "desk")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(LibraryError, match=match):
        TouchLibrary.open(tmp_path / "desk", create=create)
    assert not TouchLibrary.is_library(tmp_path / "desk")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_newer_library_is_refused_by_name(library, alter):
    library.close()
    alter(library.folder, "PRAGMA user_version = 7")
    with pytest.raises(LibraryError, match="format 7, this palpate reads 3"):
        TouchLibrary.open(library.folder)


def test_a_library_travels_to_other_processes_by_its_folder(library, cups):
    library.add(cups)
    with pickle.loads(pickle.dumps(library)) as again:
        assert len(again) == 6


def test_only_touches_are_added(library):
    with pytest.raises(TypeError, match="must be Touches, got ndarray"):
        library.add(np.ones((1, 2, 2)))


def test_a_forked_process_opens_the_library_anew(library, cups):
    """SQLite's connections must not cross a fork: the child is refused."""
    library.add(cups)
    assert "Open the library again" in outcome_elsewhere(lambda: len(library))
    assert outcome_elsewhere(lambda: len(TouchLibrary.open(library.folder))) == "6"


@pytest.mark.parametrize(
    ("seed", "n_sequences"),
    [(0, 3), (1, 3), pytest.param(100, 300, marks=pytest.mark.slow)],
)
def test_the_library_agrees_with_a_reference(seed, n_sequences):
    play(LibraryMachine, seed, n_sequences)


def test_numbers_of_numpy_are_numbers(library):
    """A session as its column has it, and counts of rows."""
    frame = np.full((5, 7), 3)
    touches = Touches(np.ones((2, 5, 7)), object=["a", "b"], session=[1, 2])
    library.add(touches.with_columns(no_contact=frame))
    assert_array_equal(library.no_contact(touches.session[0]), frame)
    rows = library.list(limit=np.int64(1), offset=np.int64(1))
    assert [row.object for row in rows] == ["b"]
    for bad, kind in ((2**70, ValueError), ("a", TypeError), (1.5, TypeError)):
        with pytest.raises(kind, match=r"^limit must be"):
            library.list(limit=bad)


def test_what_a_page_asks_again_and_again_goes_through_no_table(library, cups):
    """Among 10^5 touches that took 110 ms, and 25 ms for each touch by its id."""
    (key, *_) = library.add(cups)
    before, statements = library.objects(), []
    library._store._connection.set_trace_callback(statements.append)
    assert library.objects() == before
    assert not any("FROM touches" in statement for statement in statements)
    library.list(f"id = {key}")
    [sought] = [sql for sql in statements if "t.id IN" in sql]
    library._store._connection.set_trace_callback(None)
    plan = library._store.rows(f"EXPLAIN QUERY PLAN {sought}")
    assert "SEARCH t USING INDEX" in str(plan)
    with TouchLibrary.open(library.folder) as other:
        other.retract(key, reason="wet")
    assert library.objects() == [("cup", "vessel", 2, 2), ("pen", "tool", 3, 2)]


def test_sessions_are_counted_as_objects_are(library):
    """Touches of no session have none, and those of retracted ones do not count."""
    touches = Touches(np.arange(8).reshape(2, 2, 2), object=["a", "b"])
    library.add(touches)
    assert library.stats().n_sessions == 0
    ids = library.add(touches, session="s1")
    library.add(touches, session="s2")
    assert library.stats().n_sessions == 2
    library.retract(ids, reason="wet")
    assert library.stats().n_sessions == 1
