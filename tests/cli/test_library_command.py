"""`palpate library`, and every verb that takes touches taking a library."""

import sqlite3
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from PIL import Image

from palpate import Touches, simulate_presses
from palpate.library import TouchLibrary
from palpate.recognition import ObjectRecogniser

from .conftest import NAMES, drawn, put


@pytest.fixture
def folder(tmp_path, archive, palpate):
    folder = tmp_path / "library"
    result = palpate.answer("library", "add", folder, archive, "--session", "monday")
    assert result["added"] == 60
    return folder


def test_a_touch_is_shown_with_its_own_columns(palpate, tmp_path, rng):
    images, frames = rng.random((2, 4, 4)), np.zeros((2, 5, 4, 4))
    columns = {"position_mm": [[1, 2, 3], [4, 5, 6]], "wear": [7, 8]}
    columns["day"] = np.array(["2026-01-01", "2026-01-02"], "M8[D]")
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        ids = library.add(Touches(images, press_frames=frames, **columns))
        added_s = library.list()[1].added_s
    shown = palpate.answer("library", "show", tmp_path / "lab", ids[1])
    assert (shown["wear"], shown["position_mm"]) == (8, [4, 5, 6])
    assert shown["day"] == "2026-01-02"
    assert "press_frames" not in shown
    lines = palpate.printed("library", "show", tmp_path / "lab", ids[1])
    assert float(lines.split("added_s")[1].split()[0]) == pytest.approx(added_s, abs=1)


def test_adding_twice_adds_once(palpate, folder, archive):
    result = palpate("library", "add", folder, archive, "--session", "monday")
    assert result.stdout.startswith("0 new of 60 touches; 60 in")


def test_what_others_add_meanwhile_is_not_counted(
    palpate, folder, archive, monkeypatch
):
    add = TouchLibrary.add

    def add_beside(library, touches, **named):
        add(library, touches[:5], session="another")
        return add(library, touches, **named)

    monkeypatch.setattr(TouchLibrary, "add", add_beside)
    for n_new in (60, 0):
        words = "library", "add", folder, archive, "--session", "tuesday"
        assert palpate.answer(*words)["added"] == n_new


def test_touches_are_listed_and_shown(palpate, folder, tmp_path):
    rows = palpate.answer("library", "list", folder, "--where", "object = mug")["rows"]
    assert len(rows) == 20
    assert {row["session"] for row in rows} == {"monday"}
    listed = palpate.printed("library", "list", folder, "--objects")
    assert all(name in listed for name in NAMES)
    key = rows[3]["id"]
    result = palpate.answer("library", "show", folder, key, "-o", tmp_path / "i.npy")
    assert result["object"] == "mug"
    assert np.load(tmp_path / "i.npy").shape == (3, 24)
    palpate.refusal("library", "show", folder, "zz")
    assert "mug" in palpate("library", "show", folder, key[:12]).stdout
    assert key[:12] in palpate("library", "list", folder, "--limit", 60).stdout


def test_objects_are_renamed_merged_retracted_and_restored(palpate, folder):
    assert "is now cup" in palpate("library", "rename", folder, "mug", "cup").stdout
    assert "part of pen" in palpate("library", "merge", folder, "cup", "pen").stdout
    result = palpate("library", "retract", folder, "object = ball", "--reason", "wet")
    assert result.stdout == "20 touches retracted.\n"
    stats = palpate.answer("library", "stats", folder)
    assert (stats["n_touches"], stats["n_retracted"], stats["n_objects"]) == (40, 20, 1)
    result = palpate("library", "restore", folder, "object = ball")
    assert result.stdout == "20 touches back.\n"
    assert "n_touches" in palpate("library", "stats", folder).stdout


def test_a_filter_to_retract_may_be_an_option_and_says_what_it_did(palpate, folder):
    def answer(*words, code=0):
        return palpate.answer("library", *words, code=code)

    where = "--where", "object = ball"
    why = "--reason", "wet"
    assert answer("retract", folder, *where, *why) == {"retracted": 20}
    assert answer("retract", folder, *where, *why) == {"retracted": 0}
    assert answer("restore", folder, *where) == {"restored": 20}
    for words, got in ((why, "neither"), ((*why, *where, "object = pen"), "both")):
        error = answer("retract", folder, *words, code=1)["error"]
        assert error.endswith(f", got {got}.")
    assert answer("stats", folder)["n_retracted"] == 0
    assert answer("rename", folder, "mug", "cup") == {"old": "mug", "new": "cup"}
    merged = {"source": "cup", "into": "pen"}
    assert answer("merge", folder, "cup", "pen") == merged


def test_names_that_were_merged_may_still_be_filtered_by(palpate, folder):
    palpate("library", "merge", folder, "mug", "pen")
    words = ("library", "list", folder, "--where", "object = mug")
    assert palpate.answer(*words)["rows"] == []


def test_a_check_finds_damage_and_repairs(palpate, folder):
    palpate.printed("library", "check", folder)
    with closing(sqlite3.connect(folder / "library.sqlite")) as database, database:
        database.execute("UPDATE images SET image = x'00' WHERE number <= 3")
    problems = palpate.answer("library", "check", folder, code=1)["problems"]
    assert [len(problem["touches"]) for problem in problems] == [1] * 3
    repaired = palpate.printed("library", "check", folder, "--repair")
    assert "57 touches and 0 changes kept in a new database" in repaired
    assert "Lost: 3 touches, 0 changes." in repaired


def test_the_history_is_listed_and_a_backup_is_made(palpate, folder, tmp_path):
    palpate.printed("library", "rename", folder, "mug", "cup")
    where = ("--where", "object = pen", "--reason", "wet")
    palpate.printed("library", "retract", folder, *where)
    history = palpate.printed("library", "history", folder)
    assert "rename" in history
    assert "old mug, new cup" in history
    assert "20 touches, reason wet" in history
    changes = palpate.answer("library", "history", folder)["changes"]
    assert [change["action"] for change in changes] == ["rename", "retract"]
    copied = palpate.printed("library", "backup", folder, tmp_path / "copy")
    assert copied.startswith("60 touches in")
    palpate.printed("library", "check", tmp_path / "copy")
    again = palpate.refusal("library", "backup", folder, tmp_path / "copy")
    assert "new or empty folder" in again


def test_touches_that_are_added_without_an_object_are_told(palpate, tmp_path):
    path, lab = tmp_path / "t.csv", tmp_path / "lab"
    path.write_text("thing,t0,t1,t2,t3\nmug,1,2,3,4\npen,4,3,2,1\n")
    result = palpate("library", "add", lab, path)
    assert (result.returncode, result.stdout[:14]) == (0, "2 new of 2 tou")
    told = " ".join(result.stderr.split())
    assert "2 touches of" in told
    assert "call the column of names object (it has thing)" in told
    where = ("--where", "object is null", "--reason", "no names")
    palpate.printed("library", "retract", lab, *where)
    path.write_text(path.read_text().replace("thing", "object"))
    assert palpate("library", "add", lab, path).stderr == ""
    assert palpate.answer("library", "stats", lab)["n_objects"] == 2


def test_parquet_goes_out_and_comes_in_again(palpate, folder, tmp_path):
    out = tmp_path / "some.parquet"
    palpate.printed("library", "export", folder, "-o", out, "--by", "object")
    assert (out / "object=pen" / "part-0.parquet").is_file()
    add = ("library", "add", tmp_path / "other", out)
    added = {"library": str(tmp_path / "other"), "given": 60, "added": 60}
    assert palpate.answer(*add) == added
    model = tmp_path / "m.palpate"
    assert palpate.answer("learn", out, "-o", model)["n_train_touches"] == 60
    # It may be asked with a frame, here not of its unit; it is learnt as it is needed.
    frame = tmp_path / "rest.png"
    Image.fromarray(np.zeros(drawn(0).images.shape[1:], np.uint8)).save(frame)
    refused = palpate.refusal("recognise", model, out, "--no-contact", frame)
    assert "--no-contact must have the unit of the images" in refused
    refused = palpate.refusal("learn", out, "--no-contact", frame, "-o", model)
    assert "--no-contact must be left out for a Parquet file" in refused
    refused = palpate.refusal(*add, "--where", "order > 1")
    assert "--where must be left out for a Parquet file" in refused
    refused = palpate.refusal("library", "export", folder, "-o", out, "--by", "colour")
    assert "by must be one of" in refused


def test_a_library_is_added_to_another_as_it_is(palpate, tmp_path):
    """Baselines, columns and pictures of each recording go along."""
    lab, other, picture = tmp_path / "lab", tmp_path / "other", tmp_path / "cup"
    picture.mkdir()
    levels = np.random.default_rng(0).integers(0, 255, (12, 12), np.uint8)
    Image.fromarray(levels).save(picture / "1.jpg")
    days = drawn(0, ("cap",), 3), drawn(1, ("cap",), 3).without("order"), drawn(2)
    with TouchLibrary.open(lab, create=True) as library:
        for number, touches in enumerate(days):
            rest = np.full(touches.images.shape[1:], number)
            library.add(touches.with_columns(no_contact=rest), session=f"day {number}")
        expected = library.touches()
        ids = [row.id for row in library.list(limit=None)]
    palpate.printed("library", "add", lab, tmp_path / "cup")
    words = "library", "add", other, lab, "--where"
    counts = palpate.answer(*words, "n_rows != 12")
    assert counts["added"] == counts["given"] == len(ids)
    palpate.printed(*words, "n_rows = 12")
    assert palpate.answer(*words, "n_rows != 12")["added"] == 0
    with TouchLibrary.open(other) as library:
        assert [row.id for row in library.list("n_rows != 12", limit=None)] == ids
        read = library.touches("n_rows != 12")
        np.testing.assert_array_equal(read.images, expected.images)
        for number in range(3):
            assert (library.no_contact(f"day {number}") == number).all()
        files = library.select("n_rows = 12").files()
    assert files == [(picture / "1.jpg").read_bytes()]


def test_touches_are_exported(palpate, folder, tmp_path):
    pens = tmp_path / "pens.npz"
    result = palpate("library", "export", folder, "-o", pens, "--where", "object=pen")
    assert result.stdout.startswith("20 touches in")
    assert len(Touches.load(pens)) == 20


def test_verbs_take_a_library_with_a_filter(palpate, folder, tmp_path):
    model = tmp_path / "m.palpate"
    result = palpate.answer("learn", folder, "--where", "object != pen", "-o", model)
    assert result["n_train_touches"] == 40
    words = ("--where", "object = ball", "--error", "0.05")
    [episode] = palpate.answer("recognise", model, folder, *words)["episodes"]
    assert (episode["object"], len(episode["beliefs"])) == ("ball", 20)
    figures = palpate.answer(
        "evaluate",
        *("--train", folder, "--where", "order < 10"),
        *("--test", folder, "--test-where", "order >= 10"),
        *("--touches", "1,5", "--orders", "2"),
    )
    assert (figures["n_train_touches"], figures["n_test_touches"]) == (30, 30)


def test_days_of_an_array_are_asked_as_they_are_learnt_each_from_its_rest(
    palpate, tmp_path
):
    with TouchLibrary.open(tmp_path / "desk", create=True) as library:
        for day in range(3):
            presses = simulate_presses(None, 8, random_state=day)
            scale = np.percentile(presses.images, 99)
            rest = 0.3 * scale * np.random.default_rng(day).random((10, 10))
            whole = {"no_contact": rest, "geometry": "array"}
            touches = Touches(presses.images + rest, object=presses.object, **whole)
            library.add(touches, session=f"day {day}")
    words = ("--split", "session", "--touches", "1")
    figures = palpate.answer("evaluate", "--train", tmp_path / "desk", *words)
    assert figures["accuracy"]["1"] > 0.9
    model = tmp_path / "m.palpate"
    palpate.printed("learn", tmp_path / "desk", "-o", model)
    episodes = palpate.answer("recognise", model, tmp_path / "desk")["episodes"]
    assert np.mean([e["decision"] == e["object"] for e in episodes]) > 0.75


def test_a_filter_in_a_file_selects_training_touches_as_a_typed_one_does(
    palpate, folder, tmp_path
):
    with TouchLibrary.open(tmp_path / "test", create=True) as library:
        library.add(drawn(1))
    words = ("--train", folder, "--test", tmp_path / "test", "--touches", "1")
    profile = tmp_path / "reading.toml"
    profile.write_text("where = 'order < 10'\ncolour = false")
    for filtered in (("--where", "order < 10"), ("--read", profile)):
        figures = palpate.answer("evaluate", *words, *filtered)
        assert (figures["n_train_touches"], figures["n_test_touches"]) == (30, 60)


def test_a_model_is_extended_from_new_episodes(palpate, folder, tmp_path):
    old, new = tmp_path / "old.palpate", tmp_path / "new.palpate"
    palpate.printed("learn", folder, "-o", old)
    refused = palpate.refusal("learn", folder, "--extend", old, "-o", new)
    assert "has not learnt, got none" in refused
    with TouchLibrary.open(folder) as library:
        library.add(drawn(1, ("cap",)), episode="new")
    words = ("learn", folder, "--where", "episode = new", "--extend", old, "-o", new)
    assert palpate.answer(*words)["n_labels"] == 4
    with TouchLibrary.open(folder) as library:
        library.add(drawn(2, ("mug",), 7), episode="more")
    learnt = palpate.answer("learn", folder, "--extend", new, "-o", new)
    assert (learnt["n_labels"], learnt["n_train_touches"]) == (4, 87)
    for verb, *names in (("rename", "cap", "hat"), ("merge", "hat", "mug")):
        palpate.printed("library", verb, folder, *names)  # no touch gets two names
        refused = palpate.refusal("learn", folder, "--extend", new, "-o", old)
        assert f"got '{names[1]}' for some that it knows as 'cap'" in refused


def test_what_is_extended_stays_as_it_is(palpate, tmp_path):
    old, new, part = (tmp_path / n for n in ("old.palpate", "new.palpate", "p.npz"))
    simulate_presses(["bar10", "disc13"], 8, random_state=0).save(tmp_path / "two.npz")
    simulate_presses(["square13"], 8, random_state=1).save(part)
    palpate("learn", tmp_path / "two.npz", "-o", old, "--preset", "liu2014")
    words = "learn", part, "--extend", old, "-o", new
    assert palpate.answer(*words, "--preset", "liu2014")["n_labels"] == 3
    # Where parts lie is learnt from images, which the model does not keep.
    poses = ObjectRecogniser.load(new).pose_
    assert poses.labels_.tolist() == ["bar10", "disc13"]
    # An archive has no ids: what is learnt already is known by what it is like.
    refused = palpate.refusal("learn", part, "--extend", new, "-o", old)
    assert "has not learnt, got none" in refused
    # Numbers that a table gives its touches begin anew in the next table.
    parts = {"first": ["bar10", "disc13"], "second": ["disc13", "bar10"]}
    for seed, (name, shapes) in enumerate(parts.items()):
        presses = simulate_presses(shapes, 4, random_state=seed)
        numbers = [f"{number}" for number in range(8)]
        presses.with_columns(touch_id=numbers).save(tmp_path / f"{name}.npz")
    numbered = tmp_path / "numbered.palpate"
    palpate("learn", tmp_path / "first.npz", "-o", numbered)
    more = "learn", tmp_path / "second.npz", "--extend", numbered, "-o", numbered
    assert palpate.answer(*more)["n_train_touches"] == 16
    for option, value, usual in (
        ("--preset", "default", "'liu2014'"),
        ("--seed", "1", "0"),
        ("--label", "category", "'object'"),
    ):
        refused = palpate.refusal(*words, option, value)
        assert f"{option} must be {usual} as the model has it" in refused
    refused = palpate.refusal(*words, "--floor", "0.05")
    assert "--floor must be left out with --extend, got 0.05." in refused
    refused = palpate.refusal(*words, "--pitch-mm", "2")
    assert "--pitch-mm must be left out with --extend, got 2" in refused


def test_a_cluster_that_is_not_there_is_named(palpate, folder, tmp_path, monkeypatch):
    import distributed

    soon = partial(distributed.Client, timeout=0.2)
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: soon(address))
    model = tmp_path / "m.palpate"
    refused = palpate.refusal("learn", folder, "-o", model, "--cluster", "nowhere:1")
    assert "--cluster must be the address of a Dask scheduler" in refused


def test_a_lost_database_is_not_replaced(palpate, folder, archive):
    palpate("library", "rename", folder, "mug", "cup")
    for path in folder.glob("library.sqlite*"):
        path.unlink()
    refused = palpate.refusal("library", "add", folder, archive)
    assert "library.sqlite, which held touches and is gone" in refused
    palpate.answer("library", "check", folder, code=1)
    (folder / "library.count").unlink()  # as the message says
    palpate.printed("library", "add", folder, archive)


def test_pictures_are_kept_in_colour_where_asked(palpate, tmp_path):
    flat = np.full((4, 6, 3), [200, 100, 50])
    pictures = put(tmp_path / "in" / "cup" / "1.png", flat).parents[1]
    palpate.printed("library", "add", tmp_path / "lab", pictures, "--colour")
    (row,) = palpate.answer("library", "list", tmp_path / "lab")["rows"]
    assert row["n_channels"] == 3


def test_films_and_tables_become_touches(palpate, tmp_path):
    """The detector finds touches in a film; each line of a CSV file is a touch."""
    cv2 = pytest.importorskip("cv2")
    film = tmp_path / "press.avi"
    out = cv2.VideoWriter(str(film), cv2.VideoWriter_fourcc(*"FFV1"), 20, (64, 48))
    still = np.full((48, 64, 3), 90, np.uint8)
    pressed = still.copy()
    pressed[10:30, 20:40] = 190
    for frame in [still] * 12 + [pressed] * 5 + [still] * 5:
        out.write(frame)
    out.release()
    add = ("library", "add", tmp_path / "lab")
    for how in (("--object", "knob"), ("--detect",)):
        added = palpate.printed(*add, film, *how, "--begin", "5")
        assert "1 new of 1 touch;" in added
    table = tmp_path / "t.csv"
    table.write_text("object,a,b,c,d\npen,1,2,3,4\ncup,5,6,7,8\n")
    assert "2 new of 2 touches; 4 in" in palpate.printed(*add, table, "--shape", "2x2")
    refused = palpate.refusal(*add, table, "--shape", "two", code=2)
    assert "--shape must be rows x columns such as 16x16, got 'two'" in refused
    (advice,) = palpate.answer("check", film)["advice"]
    assert f"`palpate library add LIBRARY {film} --object NAME`" in advice
    refused = palpate.refusal(*add, film, "--where", "object = mug")
    assert "--where must be left out for a film" in refused


def test_frames_become_touches_where_begin_says(palpate, tmp_path):
    levels = np.repeat([0, 9, 0, 90, 0], [12, 5, 5, 5, 5])
    frames = np.broadcast_to(levels[:, None, None], (32, 4, 4)).astype(np.uint8)
    Touches(frames).save(tmp_path / "frames.npz")
    for begin, many in ((), "2 new of 2"), (("--begin", "20"), "1 new of 1"):
        lab = tmp_path / f"lab{len(begin)}"
        words = (tmp_path / "frames.npz", "--detect", "--object", "cup", *begin)
        assert many in palpate.printed("library", "add", lab, *words)


def test_presses_that_run_into_one_are_told(palpate, tmp_path):
    """A mat that creeps does not come back below the limit between two presses."""
    levels = np.repeat([0, 90, 10, 90, 0], [12, 5, 5, 5, 5])
    frames = np.broadcast_to(levels[:, None, None], (32, 4, 4)).astype(np.uint8)
    Touches(frames).save(tmp_path / "frames.npz")
    words = ("library", "add", tmp_path / "lab", tmp_path / "frames.npz", "--detect")
    run = palpate(*words)
    assert "1 new of 1" in run.stdout
    assert "2 would at" in run.stderr
    assert "See --begin" in run.stderr


def test_a_stream_that_begins_with_a_press_is_refused_and_leaves_no_library(
    palpate, tmp_path
):
    levels = np.repeat([0, 90, 0], [4, 12, 8])
    frames = np.broadcast_to(levels[:, None, None], (24, 4, 4)).astype(np.uint8)
    Touches(frames).save(tmp_path / "frames.npz")
    add = ("library", "add", tmp_path / "lab", tmp_path / "frames.npz", "--detect")
    refused = palpate.refusal(*add)
    assert "The first 10 frames must touch nothing" in refused
    assert "or give --no-contact" in refused
    assert not (tmp_path / "lab").exists()
    rest = Image.fromarray(frames[0])
    rest.save(tmp_path / "rest.png")
    given = palpate.printed(*add, "--no-contact", tmp_path / "rest.png")
    assert "1 new of 1" in given
