"""`palpate library`, and every verb that takes touches taking a library."""

import json
import sqlite3
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from PIL import Image

from palpate import Touches, simulate_presses
from palpate.library import TouchLibrary
from palpate.recognition import ObjectRecogniser

NAMES = ("ball", "mug", "pen")


def _touches(seed, names=NAMES, n_each=20):
    rng = np.random.default_rng(3)
    patterns = {name: rng.normal(size=(3, 24)) for name in (*NAMES, "cap")}
    noise = np.random.default_rng(seed)
    objects = np.repeat(names, n_each)
    images = [patterns[o] + 0.5 * noise.normal(size=(3, 24)) for o in objects]
    order = np.tile(np.arange(n_each), len(names))
    return Touches(np.array(images), object=objects, order=order, geometry="none")


@pytest.fixture
def archive(tmp_path):
    _touches(0).save(tmp_path / "t.npz")
    return tmp_path / "t.npz"


@pytest.fixture
def folder(tmp_path, archive, palpate):
    folder = tmp_path / "library"
    result = palpate.answer("library", "add", folder, archive, "--session", "monday")
    assert result["added"] == 60
    return folder


def test_adding_twice_adds_once(palpate, folder, archive):
    result = palpate("library", "add", folder, archive, "--session", "monday")
    assert result.stdout.startswith("0 new of 60 touches; 60 in")


def test_touches_are_listed_and_shown(palpate, folder, tmp_path):
    rows = palpate.answer("library", "list", folder, "--where", "object = mug")["rows"]
    assert len(rows) == 20
    assert {row["session"] for row in rows} == {"monday"}
    result = palpate("library", "list", folder, "--objects")
    assert all(name in result.stdout for name in NAMES)
    key = rows[3]["id"]
    result = palpate.answer("library", "show", folder, key, "-o", tmp_path / "i.npy")
    assert result["object"] == "mug"
    assert np.load(tmp_path / "i.npy").shape == (3, 24)
    assert palpate("library", "show", folder, "zz").returncode == 1
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
    def outcome(*words):
        result = palpate("library", *words, "--json")
        return result.returncode, json.loads(result.stdout)

    where = "--where", "object = ball"
    why = "--reason", "wet"
    assert outcome("retract", folder, *where, *why) == (0, {"retracted": 20})
    assert outcome("retract", folder, *where, *why) == (0, {"retracted": 0})
    assert outcome("restore", folder, *where) == (0, {"restored": 20})
    for words, got in ((why, "neither"), ((*why, *where, "object = pen"), "both")):
        code, answer = outcome("retract", folder, *words)
        assert (code, answer["error"][-len(got) - 1 :]) == (1, f"{got}.")
    assert outcome("stats", folder)[1]["n_retracted"] == 0
    assert outcome("rename", folder, "mug", "cup") == (0, {"old": "mug", "new": "cup"})
    merged = {"source": "cup", "into": "pen"}
    assert outcome("merge", folder, "cup", "pen") == (0, merged)


@pytest.mark.parametrize(
    "words",
    [
        ("library", "rename", "LIB", "mgu", "cup"),
        ("library", "merge", "LIB", "pen", "mugg"),
        ("library", "retract", "LIB", "object = Mugs", "--reason", "wet"),
        ("library", "restore", "LIB", "--where", "order < 3 and (object=mgu)"),
        ("library", "list", "LIB", "--where", "object == 'mgu'"),
        ("library", "export", "LIB", "-o", "x.npz", "--where", "object = mgu"),
        ("learn", "LIB", "-o", "x.palpate", "--where", "object = mgu"),
        ("evaluate", "--train", "LIB", "--split", "last", "--where", "object = mgu"),
    ],
    ids=" ".join,
)
def test_a_misspelt_object_is_named_with_the_one_meant(palpate, folder, words):
    result = palpate.refusal(*(folder if word == "LIB" else word for word in words))
    assert "library ('ball', 'mug', 'pen'), got " in result
    assert result.endswith(" Did you mean 'mug'?\n")


def test_names_that_were_merged_may_still_be_filtered_by(palpate, folder):
    palpate("library", "merge", folder, "mug", "pen")
    result = palpate("library", "list", folder, "--where", "object = mug", "--json")
    assert (result.returncode, json.loads(result.stdout)["rows"]) == (0, [])


def test_a_check_finds_damage_and_repairs(palpate, folder):
    assert palpate("library", "check", folder).returncode == 0
    with closing(sqlite3.connect(folder / "library.sqlite")) as database, database:
        database.execute("UPDATE images SET image = x'00' WHERE number <= 3")
    result = palpate("library", "check", folder, "--json")
    assert result.returncode == 1
    assert [len(p["touches"]) for p in json.loads(result.stdout)["problems"]] == [1] * 3
    result = palpate("library", "check", folder, "--repair")
    assert result.returncode == 0
    assert "57 touches and 0 changes kept in a new database" in result.stdout
    assert "Lost: 3 touches, 0 changes." in result.stdout


def test_the_history_is_listed_and_a_backup_is_made(palpate, folder, tmp_path):
    assert palpate("library", "rename", folder, "mug", "cup").returncode == 0
    where = ("--where", "object = pen", "--reason", "wet")
    assert palpate("library", "retract", folder, *where).returncode == 0
    result = palpate("library", "history", folder)
    assert "rename" in result.stdout
    assert "old mug, new cup" in result.stdout
    assert "20 touches, reason wet" in result.stdout
    changes = palpate.answer("library", "history", folder)["changes"]
    assert [change["action"] for change in changes] == ["rename", "retract"]
    result = palpate("library", "backup", folder, tmp_path / "copy")
    assert result.stdout.startswith("60 touches in")
    assert palpate("library", "check", tmp_path / "copy").returncode == 0
    again = palpate.refusal("library", "backup", folder, tmp_path / "copy")
    assert "new or empty folder" in again


def test_parquet_goes_out_and_comes_in_again(palpate, folder, tmp_path):
    out = tmp_path / "some.parquet"
    result = palpate("library", "export", folder, "-o", out, "--by", "object")
    assert result.returncode == 0, result.stderr
    assert (out / "object=pen" / "part-0.parquet").is_file()
    result = palpate.answer("library", "add", tmp_path / "other", out)
    assert result == {
        "library": str(tmp_path / "other"),
        "given": 60,
        "added": 60,
    }
    model = tmp_path / "m.palpate"
    assert palpate.answer("learn", out, "-o", model)["n_train_touches"] == 60
    refused = palpate.refusal(
        "library", "add", tmp_path / "other", out, "--where", "order > 1"
    )
    assert "--where must be left out for Parquet" in refused
    refused = palpate.refusal("library", "export", folder, "-o", out, "--by", "colour")
    assert "by must be one of" in refused


def test_touches_are_exported(palpate, folder, tmp_path):
    pens = tmp_path / "pens.npz"
    result = palpate("library", "export", folder, "-o", pens, "--where", "object=pen")
    assert result.stdout.startswith("20 touches in")
    assert len(Touches.load(pens)) == 20


def test_verbs_take_a_library_with_a_filter(palpate, folder, archive, tmp_path):
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
    refused = palpate.refusal("learn", archive, "--where", "object = pen", "-o", model)
    assert "--where must be given with a library" in refused
    refused = palpate("learn", folder, "--name-pattern", "x", "-o", model)
    assert "--name-pattern must be left out for a library" in refused.stderr
    refused = palpate("learn", folder, "--where", "colour = red", "-o", model)
    assert "must name columns of the library" in refused.stderr


def test_a_filter_in_a_file_selects_training_touches_as_a_typed_one_does(
    palpate, folder, tmp_path
):
    with TouchLibrary.open(tmp_path / "test", create=True) as library:
        library.add(_touches(1))
    words = ("--train", folder, "--test", tmp_path / "test", "--touches", "1")
    profile = tmp_path / "reading.toml"
    profile.write_text("where = 'order < 10'")
    for filtered in (("--where", "order < 10"), ("--read", profile)):
        figures = palpate.answer("evaluate", *words, *filtered)
        assert (figures["n_train_touches"], figures["n_test_touches"]) == (30, 60)


def test_a_model_is_extended_from_new_episodes(palpate, folder, tmp_path):
    old, new = tmp_path / "old.palpate", tmp_path / "new.palpate"
    palpate("learn", folder, "-o", old)
    refused = palpate("learn", folder, "--extend", old, "-o", new)
    assert "has not learnt, got none" in refused.stderr
    with TouchLibrary.open(folder) as library:
        library.add(_touches(1, ("cap",)), episode="new")
    result = palpate(
        *("learn", folder, "--where", "episode = new"),
        *("--extend", old, "-o", new, "--json"),
    )
    assert json.loads(result.stdout)["n_labels"] == 4
    with TouchLibrary.open(folder) as library:
        library.add(_touches(2, ("mug",), 7), episode="more")
    learnt = palpate.answer("learn", folder, "--extend", new, "-o", new)
    assert (learnt["n_labels"], learnt["n_train_touches"]) == (4, 87)


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
    for option, value, usual in (
        ("--preset", "default", "'liu2014'"),
        ("--seed", "1", "0"),
        ("--label", "category", "'object'"),
    ):
        refused = palpate(*words, option, value)
        assert refused.returncode == 1
        assert f"{option} must be {usual} as the model has it" in refused.stderr
    refused = palpate(*words, "--floor", "0.05")
    assert "--floor must be left out with --extend, got 0.05." in refused.stderr
    refused = palpate(*words, "--pitch-mm", "2")
    assert "--pitch-mm must be left out with --extend, got 2" in refused.stderr


def test_a_cluster_that_is_not_there_is_named(palpate, folder, tmp_path, monkeypatch):
    import distributed

    soon = partial(distributed.Client, timeout=0.2)
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: soon(address))
    model = tmp_path / "m.palpate"
    refused = palpate.refusal("learn", folder, "-o", model, "--cluster", "nowhere:1")
    assert "--cluster must be the address of a Dask scheduler" in refused
    refused = palpate("learn", folder, "-o", model, "--cluster", "x", "--workers", 2)
    assert "either --workers or --cluster" in refused.stderr
    refused = palpate("learn", folder, "-o", model, "--workers", "0")
    assert refused.returncode == 2
    assert "--workers must be at least 1" in refused.stderr


@pytest.mark.parametrize("option", ["--where", "--name-pattern", "--no-contact"])
def test_a_bag_refuses_options_that_say_nothing_of_it(palpate, tmp_path, option):
    (tmp_path / "bag").mkdir()
    refused = palpate.refusal(
        *("library", "add", tmp_path / "new", tmp_path / "bag"),
        *("--topic", "/pad", option, "object = mug"),
    )
    assert f"{option} must be left out with --topic, got 'object = mug'" in (refused)
    assert not (tmp_path / "new").exists()


def test_a_lost_database_is_not_replaced(palpate, folder, archive):
    palpate("library", "rename", folder, "mug", "cup")
    for path in folder.glob("library.sqlite*"):
        path.unlink()
    refused = palpate.refusal("library", "add", folder, archive)
    assert "library.sqlite, which held touches and is gone" in refused
    assert palpate("library", "check", folder).returncode == 1
    (folder / "library.count").unlink()  # as the message says
    assert palpate("library", "add", folder, archive).returncode == 0


def test_pictures_are_kept_in_colour_where_asked(palpate, tmp_path):
    pictures = tmp_path / "in"
    (pictures / "cup").mkdir(parents=True)
    flat = np.full((4, 6, 3), [200, 100, 50], np.uint8)
    Image.fromarray(flat).save(pictures / "cup" / "1.png")
    added = palpate("library", "add", tmp_path / "lab", pictures, "--colour")
    assert added.returncode == 0, added.stderr
    result = palpate.answer("library", "list", tmp_path / "lab")
    assert result["rows"][0]["n_channels"] == 3
    result = palpate.refusal(
        "learn", tmp_path / "lab", "--colour", "-o", tmp_path / "m.palpate"
    )
    assert "--colour must be left out for a library" in result


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
    lab = tmp_path / "lab"
    result = palpate("library", "add", lab, film, "--object", "knob", "--begin", "5")
    assert "1 new of 1 touch;" in result.stdout, result.stderr
    result = palpate("library", "add", lab, film, "--detect", "--begin", "5")
    assert "1 new of 1 touch;" in result.stdout, result.stderr
    (tmp_path / "t.csv").write_text("object,a,b,c,d\npen,1,2,3,4\ncup,5,6,7,8\n")
    result = palpate("library", "add", lab, tmp_path / "t.csv", "--shape", "2x2")
    assert "2 new of 2 touches; 4 in" in result.stdout, result.stderr
    refused = palpate("library", "add", lab, tmp_path / "t.csv", "--shape", "two")
    assert "--shape must be rows x columns such as 16x16, got 'two'" in refused.stderr
    refused = palpate("library", "add", lab, film, "--where", "object = mug")
    assert "--where must be left out for a film" in refused.stderr


def test_frames_become_touches_where_begin_says(palpate, tmp_path):
    levels = np.repeat([0, 9, 0, 90, 0], [12, 5, 5, 5, 5])
    frames = np.broadcast_to(levels[:, None, None], (32, 4, 4)).astype(np.uint8)
    Touches(frames).save(tmp_path / "frames.npz")
    for begin, many in ((), "2 new of 2"), (("--begin", "20"), "1 new of 1"):
        lab = tmp_path / f"lab{len(begin)}"
        words = (tmp_path / "frames.npz", "--detect", "--object", "cup", *begin)
        done = palpate("library", "add", lab, *words)
        assert many in done.stdout, done.stderr


@pytest.mark.parametrize("option", ["--shape=2x2", "--dtype=<u2", "--channels=x,y"])
def test_what_a_library_says_itself_is_refused(option, palpate, folder):
    done = palpate.refusal("check", folder, option)
    assert f"{option.partition('=')[0]} must be left out for a library" in done


def test_begin_is_of_films(palpate, folder, archive):
    for path in (folder, archive):
        done = palpate.refusal("check", path, "--begin", "3")
        assert "--begin must be left out for" in done


@pytest.mark.parametrize("size", ["inf", "nan", "-1"])
def test_a_largest_picture_is_a_positive_number(size, palpate, archive):
    done = palpate.refusal("check", archive, "--max-megapixels", size)
    assert "--max-megapixels must be positive and finite" in done


def test_objects_are_listed_all_or_not_at_all(palpate, folder):
    for options in (("--where", "object = mug"), ("--offset", "1"), ("--retracted",)):
        done = palpate.refusal("library", "list", folder, "--objects", *options)
        assert "--objects must stand without --where" in done


@pytest.mark.parametrize(
    "options",
    [
        ("--colour",),
        ("--shape", "4x4"),
        ("--detect",),
        ("--episode", "e"),
        ("--skip-bad",),
    ],
)
def test_what_a_running_sensor_does_not_heed_is_refused(options, palpate, tmp_path):
    words = (tmp_path / "lab", "sim:mug", "--object", "mug", "-n", "1")
    done = palpate.refusal("library", "add", *words, *options)
    assert f"{options[0]} must be left out with a running sensor" in done
    assert not (tmp_path / "lab").exists()


def test_how_many_touches_is_refused_without_a_running_sensor(palpate, tmp_path):
    _touches(1, ("mug",)).save(tmp_path / "t.npz")
    done = palpate("library", "add", tmp_path / "lab", tmp_path / "t.npz", "-n", "12")
    assert done.returncode == 1
    assert "--touches must be left out without a running sensor" in done.stderr
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize("name", ["test", "unknown"])
def test_a_filter_of_touches_that_are_not_there_is_refused(name, palpate, folder):
    option = f"--{name}-where"
    words = ("--train", folder, "--split", "last", option, "order > 3")
    done = palpate.refusal("evaluate", *words)
    assert f"{option} must come with --{name}, got 'order > 3' alone" in done
