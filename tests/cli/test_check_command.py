"""`palpate check`: every bad picture in one list, layouts asked about, advice."""

import json
import re
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.recognition import ObjectRecogniser
from palpate.touches import TouchesError

from .conftest import put, put_each

BAD = {
    "loose.png": "in no folder",
    "mug/003.png": "cut short",
    "mug/004.png": "8 x 6 8-bit PNG, not 12 x 10",
    "pen/003.png": "neither JPEG nor PNG",
    "pen/004.png": "transparent parts",
}


@pytest.fixture
def odd(tmp_path):
    """Twelve good pictures and five that cannot be used."""
    root = tmp_path / "touches"
    for name in ("mug", "pen"):
        for number in (1, 2, 5, 6, 7, 8):
            put(root / name / f"{number:03}.png")
    put(root / "loose.png")
    put(root / "mug" / "003.png")
    cut = root / "mug" / "003.png"
    cut.write_bytes(cut.read_bytes()[:-30])
    put(root / "mug" / "004.png", np.zeros((6, 8), np.uint8))
    (root / "pen" / "003.png").write_text("hello")
    Image.new("RGBA", (12, 10)).save(root / "pen" / "004.png")
    return root


def test_grey_levels_in_three_channels_are_no_colour(palpate, tmp_path, rng):
    for number in range(4):
        grey = rng.integers(40, 160, (12, 16, 1))
        put(tmp_path / "mug" / f"{number}.jpg", np.repeat(grey, 3, axis=2))
    assert palpate.answer("check", tmp_path)["notes"] == []


@pytest.fixture
def jpegs(tmp_path):
    """JPEGs in colour, five of them odd: cut, turned, small, words, grey."""
    root, rng = tmp_path / "jpegs", np.random.default_rng(0)
    for name, red in (("mug", 60), ("pen", 160)):
        for number in range(8):
            levels = rng.normal((red, 90, 40), 9, (24, 32, 3))
            put(root / name / f"{number}.jpg", levels)
    cut = root / "mug" / "1.jpg"
    cut.write_bytes(cut.read_bytes()[:300])
    exif = Image.Exif()
    exif[0x0112] = 6
    with Image.open(root / "mug" / "2.jpg") as picture:
        turned = picture.transpose(Image.Transpose.ROTATE_90)
    turned.save(root / "mug" / "2.jpg", exif=exif.tobytes())
    put(root / "mug" / "3.jpg", np.zeros((12, 16, 3)))
    (root / "pen" / "1.jpg").write_text("my notes")
    put(root / "pen" / "2.jpg", rng.integers(0, 255, (24, 32)))
    return root


def test_five_odd_jpegs_are_reported_and_the_others_are_used(palpate, jpegs, tmp_path):
    answer = palpate.answer("check", jpegs, code=1)
    bad = ["mug/1.jpg", "mug/3.jpg", "pen/1.jpg"]
    assert [picture["picture"] for picture in answer["bad"]] == bad
    assert answer["notes"] == [
        "1 picture turned upright, as the camera noted (Exif): mug/2.jpg",
        "1 picture in grey among those in colour: pen/2.jpg",
        "12 pictures in colour read in grey: --colour, if colour tells, as on a gel",
    ]
    assert answer["odd"] == {"turned": ["mug/2.jpg"], "grey": ["pen/2.jpg"]}
    in_colour = palpate.answer("check", jpegs, "--colour", code=1)
    assert not any("--colour" in note for note in in_colour["notes"])
    fixes = {picture["picture"]: picture["fix"] for picture in in_colour["bad"]}
    assert [*fixes] == [*bad, "pen/2.jpg"]
    assert fixes["pen/2.jpg"] == "take it out, or learn and recognise without --colour"
    model = tmp_path / "m.palpate"
    for words in ((), ("--colour",)):
        palpate.printed("learn", jpegs, "--skip-bad", "-o", model, *words)
        recognised = palpate.printed("recognise", model, jpegs, "--skip-bad", *words)
        assert "Touches of mug" in recognised
    for name in ("mug/1.jpg", "mug/3.jpg", "pen/1.jpg"):
        (jpegs / name).unlink()
    refused = palpate.refusal("learn", jpegs, "--colour", "-o", model)
    assert "pen/2.jpg" in refused
    assert "Take it out, or learn and recognise without --colour." in refused


def test_pictures_without_a_folder_of_their_object_are_not_learnt(
    palpate, jpegs, tmp_path
):
    refused = palpate.refusal(
        "learn", jpegs / "pen", "--skip-bad", "-o", tmp_path / "m.palpate"
    )
    assert "Name folders after objects, pass --name-pattern" in refused


def test_a_sentence_breaks_between_words_on_a_terminal(
    palpate, model, archive, tmp_path, monkeypatch
):
    """Lines that are drawn are left as they are, and so are those of a file."""
    pictures = put_each(tmp_path / "set-of-pictures", 6)
    commands = ("check", pictures), ("recognise", model, archive)
    whole, drawn = (palpate.printed(*words) for words in commands)
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    broken, drawn_there = (palpate.printed(*words) for words in commands)
    assert f"{pictures}:\n12 touches of 10 x\n12 can be used.\n" in broken
    few = "- Few touches of mug\n  (6), pen (6): 20\n  are a start, 60\n  are good.\n"
    assert few in broken
    advice, advice_there = (text[text.index("\n- ") :] for text in (whole, broken))
    assert advice_there.replace("\n  ", " ") == advice
    lines = [line for line in drawn.splitlines() if line.startswith("  touch")]
    assert lines
    assert set(lines) <= {*drawn_there.splitlines()}


def test_where_levels_fit_no_picture_the_levels_are_blamed(palpate, odd):
    words = ("learn", odd, "--skip-bad", "--levels", "-/object", "-o", "m.palpate")
    blamed = "Fix: give --levels or a --name-pattern as these paths are."
    assert blamed in palpate.refusal(*words)


def test_every_bad_picture_is_in_one_list_with_its_fix(palpate, odd):
    answer = palpate.answer("check", odd, code=1)
    assert [fault["picture"] for fault in answer["bad"]] == list(BAD)
    for fault in answer["bad"]:
        assert BAD[fault["picture"]] in fault["problem"]
        assert fault["fix"]
    assert answer["n_touches"] == 12
    objects = [{"object": o, "touches": 6, "sessions": None} for o in ("mug", "pen")]
    assert answer["objects"] == objects
    for words in ("--skip-bad", "few touches of mug (6), pen (6)", "one session"):
        assert any(words in line for line in answer["advice"]), words
    printed = palpate("check", odd).stdout
    assert all(name in printed for name in BAD)
    assert "5 pictures cannot be used" in printed


def test_pictures_on_their_side_are_told_from_those_of_another_size(palpate, tmp_path):
    put_each(tmp_path, 4, ["mug"])
    put(tmp_path / "mug" / "tall.png", np.zeros((12, 10)))
    put(tmp_path / "mug" / "small.png", np.zeros((5, 6)))
    # Sides of touches and of pictures are told in other orders.
    assert "of 10 x 12 (rows x columns)" in palpate("check", tmp_path).stdout
    answer = palpate.answer("check", tmp_path, code=1)
    small, tall = answer["bad"]
    assert small["problem"] == "6 x 5 8-bit PNG, not 12 x 10 8-bit PNG"
    assert small["fix"].startswith("crop or pad it to that size")
    assert "not in sub-folders of one" in small["fix"]
    assert tall["problem"] == "10 x 12 8-bit PNG, not 12 x 10 8-bit PNG: on its side"
    assert tall["fix"].startswith("turn it by 90 degrees")


def test_odd_pictures_are_named_the_first_few_and_all_as_json(palpate, tmp_path):
    put_each(tmp_path, 6)
    for number in range(5):
        put(tmp_path / "mug" / f"{number}.png", np.full((10, 12), number))
    shutil.copy(tmp_path / "pen" / "0.png", tmp_path / "pen" / "9.png")
    flat = [f"mug/{number}.png" for number in range(5)]
    answer = palpate.answer("check", tmp_path)
    assert answer["odd"] == {"flat": flat, "copies": [["pen/9.png", "pen/0.png"]]}
    first, twice = answer["notes"]
    assert first.endswith(
        "mug/0.png, mug/1.png, mug/2.png and 2 more (--json lists all)"
    )
    assert twice == "1 picture there twice: pen/9.png and pen/0.png"


def test_skip_bad_leaves_bad_pictures_out_and_names_them(palpate, odd, tmp_path):
    odd = odd.rename(tmp_path / "my touches")
    refused = palpate.refusal("learn", odd, "-o", tmp_path / "m.palpate")
    assert f"`palpate check '{odd}'` lists all that is wrong" in refused
    model = tmp_path / "m.palpate"
    result = palpate("learn", odd, "--skip-bad", "-o", model, "--json")
    assert "5 pictures of 17" in result.stderr
    assert "loose.png is in no folder" in result.stderr
    assert json.loads(result.stdout)["n_train_touches"] == 12
    assert ObjectRecogniser.load(model).classes_.tolist() == ["mug", "pen"]
    words = ("evaluate", "--train", odd, "--skip-bad", "--split", "last")
    assert palpate.answer(*words, "--touches", "1")["n_test_touches"] == 2
    added = palpate.answer("library", "add", tmp_path / "lab", odd, "--skip-bad")
    assert added["added"] == 12
    again = palpate.answer("check", tmp_path / "lab")
    assert (again["read_as"], again["n_touches"]) == ("a library", 12)


def test_in_python_bad_pictures_left_out_are_a_warning(odd):
    with pytest.warns(UserWarning, match="5 pictures of 17"):
        assert len(Touches.load(odd, skip_bad=True)) == 12


def test_a_folder_without_one_good_picture_has_a_problem_and_no_touches(
    palpate, tmp_path
):
    put(tmp_path / "set" / "mug" / "1.png").write_text("hello")
    answer = palpate.answer("check", tmp_path / "set", code=1)
    assert answer["n_touches"] == 0
    assert "No picture of these objects can be used" in answer["problem"]


def test_the_page_shows_touches_of_each_object_what_is_odd_and_what_is_bad(
    palpate, tmp_path
):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    root, report = put_each(tmp_path / "set", 6), tmp_path / "check.html"
    shutil.copy(root / "mug" / "0.png", root / "mug" / "9.png")
    put(root / "pen" / "flat.png", np.full((10, 12), 7))
    exif = Image.Exif()
    exif[0x0112] = 6  # as large as the others once it is upright
    put(root / "pen" / "turned.png", 200 * np.eye(12, 10), exif=exif)
    (root / "notes.txt").write_text("hello")
    lines = palpate.printed("check", root, "--report", report).splitlines()
    assert "Note: 1 file of .txt left alone (notes.txt)." in lines
    assert lines[-1] == str(report)
    page = report.read_text()
    assert page.count("<img alt='touch") == 15
    assert "title='mug/0.png'" in page
    for name, odd in (("turned", "turned upright"), ("flat", "flat"), ("9", "a copy")):
        assert f"{name}.png<br>{odd}" in page
    assert "http" not in page.replace("http-equiv", "")
    put(root / "pen" / "bad.png").write_text("hello")
    palpate.answer("check", root, "--report", report, code=1)
    assert "pen/bad.png" in report.read_text()


def test_brightness_that_tells_objects_apart_by_itself_is_reported(palpate, tmp_path):
    """Brightness alone tells these two; nothing does where all are alike."""
    for number in range(16):
        for name in ("mug", "pen"):
            put(tmp_path / "set" / name / f"{number}.png")
            levels = np.random.default_rng(number).integers(0, 255, (10, 12))
            put(tmp_path / "alike" / name / f"{number}.png", levels)
    alone = palpate.answer("check", tmp_path / "set")
    assert alone["alone"]["brightness"] == {"right": 1.0, "chance": 0.5}
    assert any("no touch" in line for line in alone["advice"])
    alike = palpate.answer("check", tmp_path / "alike")
    assert alike["alone"]["brightness"]["right"] == 0.5
    assert not any("no touch," in line for line in alike["advice"])


@pytest.mark.parametrize(
    ("paths", "objects", "sessions"),
    [
        ("mug/frames, pen/frames", "mug, pen", ""),
        ("mug/dataset_0, pen/dataset_1", "mug, pen", "dataset_0, dataset_1"),
        ("mug/run 1/frames, pen/run 2/frames", "mug, pen", "run 1, run 2"),
        ("2024-05-01/mug, 2024-05-02/pen", "mug, pen", "2024-05-01, 2024-05-02"),
        ("cups/mug, tools/pen", "cups/mug, tools/pen", ""),
        ("mug/1, mug/2, pen/1, pen/2", "mug/1, mug/2, pen/1, pen/2", ""),
    ],
)
def test_common_layouts_are_read_as_objects_and_sessions(
    tmp_path, paths, objects, sessions
):
    touches = Touches.load(put_each(tmp_path, 2, paths.split(", ")))
    assert ", ".join(np.unique(touches.object)) == objects
    assert (touches.session is None) == (sessions == "")
    if sessions:
        assert ", ".join(np.unique(touches.session)) == sessions


@pytest.mark.parametrize(
    ("dtype", "geometry", "fix"),
    [
        (np.uint8, "array", "needs one: --no-contact FILE"),
        (np.float32, "array", r"in Python, touches\.with_columns\(no_contact=frame"),
        (np.float32, "none", ""),
    ],
)
def test_a_frame_of_no_contact_is_asked_for_as_it_can_be_given(
    palpate, tmp_path, rng, dtype, geometry, fix
):
    levels = rng.integers(0, 200, (40, 8, 8)).astype(dtype)
    touches = Touches(levels, object=["mug", "pen"] * 20, geometry=geometry)
    touches.save(tmp_path / "t.npz")
    advice = palpate.answer("check", tmp_path / "t.npz")["advice"]
    asked = [line for line in advice if "touching nothing" in line]
    assert len(asked) == bool(fix)
    assert all(re.search(fix, line) for line in asked)


@pytest.mark.parametrize("rests", [0, 1, 2])
def test_a_library_is_asked_for_no_option_that_it_refuses(palpate, tmp_path, rests):
    """One that has several frames of no contact needs no other."""
    rng = np.random.default_rng(rests)
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        for day in (1, 2):
            levels = rng.integers(0, 200, (12, 60, 80), np.uint8)
            rest = np.full((60, 80), min(day, rests), np.uint8) if rests else None
            names = ["mug", "pen"] * 6
            library.add(Touches(levels, object=names, no_contact=rest), session=day)
    advice = palpate.answer("check", tmp_path / "lab")["advice"]
    asked = [line for line in advice if "touching nothing" in line]
    assert len(asked) == (rests == 0)
    assert "--no-contact" not in " ".join(advice)


def test_frames_of_one_touch_that_count_as_touches_are_told(palpate, tmp_path, rng):
    images = 100 * rng.random((24, 6, 6))
    # Of each object 200 are looked at, here the frames of ten touches.
    told = "380 of 398 touches are almost the same as the one before"
    for name, n_frames, is_told in (("touches", 1, False), ("frames", 20, True)):
        frames = np.repeat(images, n_frames, axis=0)
        frames += rng.normal(size=frames.shape)
        labels = np.repeat(["cup", "pen"], len(frames) // 2)
        path = tmp_path / f"{name}.npz"
        Touches(frames, object=labels).save(path)
        advice = " ".join(palpate.answer("check", path)["advice"])
        assert (
            (told in advice)
            is ("almost the same as the one before" in advice)
            is is_told
        )


def test_copies_and_taxels_that_never_change_are_named(palpate, tmp_path, rng):
    """A dead taxel that writes 65535 was learnt as if it were pressed hard."""
    images = rng.integers(0, 4096, (12, 8, 8)).astype(np.uint16)
    labels, path = ["mug", "pen"] * 6, tmp_path / "t.npz"
    Touches(images, object=labels).save(path)
    assert not palpate.answer("check", path)["notes"]
    images[7] = images[3]
    images[:2] = 9  # touches of one level are no copies
    Touches(images, object=labels).save(path)
    assert palpate.answer("check", path)["notes"] == ["1 touch there twice: 7 as 3"]
    images[:, 3, 4] = 65535
    images[:, 5, 5] = 2000  # others read that too: it may rest there
    Touches(images[2:], object=labels[2:]).save(path)
    stuck, _ = palpate.answer("check", path)["notes"]
    assert stuck.startswith(
        "1 taxel of one reading in all touches, beyond those of all"
    )
    assert "(row 3, column 4 reads 65535): where it is dead, write NaN" in stuck
    printed = palpate("learn", path, "-o", tmp_path / "m.palpate").stdout
    assert stuck[1:] in " ".join(printed.split())
    # A camera's picture has a dark frame, which is no dead taxel.
    camera = rng.integers(60, 200, (12, 120, 160)).astype(np.uint8)
    camera[:, :3] = 0
    Touches(camera, object=labels, geometry="plane").save(path)
    assert not palpate.answer("check", path)["notes"]


def test_names_that_differ_in_blanks_are_told(palpate, tmp_path, rng):
    labels = ["mug", "mug ", "pen"] * 4
    Touches(rng.random((12, 8, 8)), object=labels).save(tmp_path / "t.npz")
    advice = " ".join(palpate.answer("check", tmp_path / "t.npz")["advice"])
    assert "differ in capitals or blanks alone (mug and mug ) count as" in advice


def test_columns_of_a_file_without_labels_are_named(palpate, tmp_path, rng):
    Touches(rng.random((6, 8, 8)), label=["mug", "pen"] * 3).save(tmp_path / "t.npz")
    (line,) = palpate.answer("check", tmp_path / "t.npz")["advice"]
    assert "call the column of names object (it has label)" in line
    assert "--name-pattern" not in line


def test_names_of_folders_that_will_not_do_are_reported(palpate, tmp_path):
    for part in ("teach", "later"):
        put_each(tmp_path / "set" / part, 2)
    advice = palpate.answer("check", tmp_path / "set")["advice"]
    (line,) = (line for line in advice if "the same names" in line)
    assert line.startswith("the same names (mug, pen) are in later/ and teach/")
    for levels in ("--levels object/session", "session/object", "-/object"):
        assert levels in line
    every = ["mug/Mo", "mug/Di", "Mug/Di", "pen/Mo", "pen/Di", "can/Mo", "can/Di"]
    put_each(tmp_path / "named", 2, every)  # one of them met on one day alone
    advice = palpate.answer("check", tmp_path / "named")["advice"]
    assert any(
        "the same names (Di, Mo) are in Mug/ and can/" in line for line in advice
    )
    words = ("check", tmp_path / "named", "--levels", "object/session")
    advice = palpate.answer(*words)["advice"]
    assert any("capitals alone (Mug and mug) count" in line for line in advice)
    put_each(tmp_path / "other", 2, ["tools/saw", "tools/awl", "toys/car", "toys/top"])
    advice = palpate.answer("check", tmp_path / "other")["advice"]
    assert not any("the same names" in line for line in advice)
    (line,) = (line for line in advice if "all is of one session" in line)
    assert "a column session" in line  # of archives and tables, which have no folders
    days = line.partition("such as ")[2].partition(",")[0].split(" and ")
    put_each(tmp_path / "days", 2, [*days, *(d.replace("mug", "pen") for d in days)])
    objects = palpate.answer("check", tmp_path / "days")["objects"]
    assert [(row["object"], row["sessions"]) for row in objects] == [
        ("mug", 2),
        ("pen", 2),
    ]
    put_each(tmp_path / "met", 2, ["mug", "pen", "unknown"])
    advice = palpate.answer("check", tmp_path / "met")["advice"]
    assert any(line.startswith("no object can be called unknown") for line in advice)


def test_many_pictures_wrong_in_one_way_are_one_row(palpate, tmp_path):
    put_each(tmp_path, 4)
    result = palpate("check", tmp_path, "--levels", "session/object")
    assert "and 5 more" in " ".join(result.stdout.split())
    _, table = result.stdout.split("8 pictures cannot be used")
    assert table.count("not named as levels") == 1
    result = palpate.answer("check", tmp_path, "--levels", "session/object", code=1)
    assert len(result["bad"]) == 8


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ("train/mug test/mug", r"test and train, .* `levels=-/object`"),
        ("train val", r"train and val, which are parts of a set"),
        ("2024-05-01 2024-05-02", r"05-02, named as sessions .* `levels=object`"),
        ("day1/run_1 day2/run_1", r"got day1, day2, named as .* `levels=object`"),
        ("mug/gel mug/video pen/gel pen/video", r"`levels=object/=gel`"),
        (
            "mug/run_1/gel mug/run_1/cam pen/run_2/gel pen/run_2/cam",
            r"`levels=object/-/=cam`",
        ),
    ],
)
def test_ambiguous_layouts_are_refused_with_levels_to_give(
    palpate, tmp_path, paths, message
):
    root = put_each(tmp_path / "set", 2, paths.split())
    with pytest.raises(TouchesError, match=message):
        Touches.load(root)
    assert (" --levels " in palpate.refusal("check", root)) == ("levels" in message)


def test_days_may_be_objects_where_that_is_said(tmp_path):
    root = put_each(tmp_path, 2, ["monday", "tuesday"])
    assert (
        Touches.load(root, levels="object").object.tolist()
        == ["monday"] * 2 + ["tuesday"] * 2
    )


def test_pictures_that_are_not_read_or_no_touches_are_named(palpate, tmp_path):
    """Of an object whose pictures are BMP nothing was learnt, and learn was silent."""
    root = put_each(tmp_path / "set", 6)
    put_each(root, 3, ["cup"], ending="bmp")
    model = ("-o", tmp_path / "m.palpate")
    left = "ictures left alone: 3 of .bmp; save them as PNG"
    assert left in " ".join(palpate("learn", root, *model).stdout.split())
    words = ("evaluate", "--train", root, "--split", "last")
    assert left in palpate.answer(*words)["recommendations"][0]
    shutil.rmtree(root / "cup")
    assert not palpate.answer("check", root)["notes"]
    for name in ("mug", "pen"):
        put(root / name / "background.png")
    ways = "ictures of each object are named in 2 ways (#, background), and all count"
    assert ways in palpate.answer("check", root)["notes"][-1]
    assert ways in " ".join(palpate("learn", root, *model).stdout.split())
    (root / "pen" / "background.png").unlink()
    assert not palpate.answer("check", root)["notes"]


def test_levels_are_skipped_and_chosen(tmp_path):
    root = put_each(tmp_path, 2, ["mug/a", "mug/b", "pen/a", "pen/b"])
    skipped = Touches.load(root, levels="object/-")
    assert (len(skipped), np.unique(skipped.object).tolist()) == (8, ["mug", "pen"])
    chosen = Touches.load(root, levels="object/=b")
    assert {path.split("/")[1] for path in chosen.columns["source_path"]} == {"b"}
    assert chosen.object.tolist() == ["mug", "mug", "pen", "pen"]
    nested = Touches.load(root, levels="category/object")
    assert nested.category.tolist() == ["mug"] * 4 + ["pen"] * 4
    with pytest.raises(TouchesError, match=r"=c where there are a, b"):
        Touches.load(root, levels="object/=c")
    for wrong in ("session", "object/object", "object/a b", "object/="):
        with pytest.raises(TouchesError, match=r"levels must name .* - skips a level"):
            Touches.load(root, levels=wrong)


@pytest.fixture
def mixed(tmp_path):
    """Pictures of two objects in one folder each, of the mug in two."""
    root = put_each(tmp_path / "mixed", 6, ["ball", "pen"])
    return put_each(root, 3, ["mug/first", "mug/second"])


BY_FIRST = "--name-pattern '(?P<object>[^/]+)/.*'"


def test_an_object_in_folders_of_its_own_is_one_row_with_a_fix(
    palpate, mixed, tmp_path, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    printed = palpate("check", mixed).stdout
    (row,) = (line for line in printed.splitlines() if line.startswith("│"))
    assert "mug/ (6 pictures)" in row
    assert "in folders inside mug/ (first, second), unlike the others" in row
    assert f"move them up into mug/, or say {BY_FIRST}" in row
    bad = palpate.answer("check", mixed, code=1)["bad"]
    assert [fault["folder"] for fault in bad] == ["mug"] * 6
    refused = palpate.refusal("learn", mixed, "-o", tmp_path / "m.palpate")
    assert f"Move them up into mug/, or say {BY_FIRST}." in refused
    words = BY_FIRST.replace("'", "").split()
    read = palpate.answer("check", mixed, *words)["objects"]
    assert [row["object"] for row in read] == ["ball", "mug", "pen"]


def test_objects_without_the_folders_that_levels_name_are_one_row(
    palpate, mixed, tmp_path, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "250")
    words = ("--levels", "object/session")
    printed = palpate("check", mixed, *words).stdout
    (row,) = (line for line in printed.splitlines() if line.startswith("│"))
    assert "ball/, pen/ (12 pictures)" in row
    assert "in one folder, where the others lie in two" in row
    assert f"say {BY_FIRST}" in row
    refused = palpate.refusal("learn", mixed, *words, "-o", tmp_path / "m.palpate")
    assert f"say {BY_FIRST}." in refused


def test_an_object_of_which_nothing_is_left_is_refused_by_name(
    palpate, mixed, odd, tmp_path
):
    no_mug = "No picture of mug can be used: mug/first/0.png is in folders inside"
    out = tmp_path / "m.palpate"
    for words in (
        ("learn", mixed, "-o", out),
        ("evaluate", "--train", mixed, "--split", "last"),
        ("library", "add", tmp_path / "lab", mixed),
    ):
        refused = palpate.refusal(*words, "--skip-bad")
        assert no_mug in refused
        assert f"Or take mug out of {mixed}" in refused
    assert not out.exists()
    answer = palpate.answer("check", mixed, code=1)
    assert no_mug in answer["problem"]
    assert not any("--skip-bad" in line for line in answer["advice"])
    for picture in (odd / "pen").iterdir():
        picture.write_text("hello")
    refused = palpate.refusal("learn", odd, "--skip-bad", "-o", out)
    assert "No picture of pen can be used: pen/001.png is a file" in refused
    named = tmp_path / "named"
    for number in range(3):
        put(named / f"mug_{number}.png")
        (named / f"pen_{number}.png").write_text("hello")
    words = ("--name-pattern", r"(?P<object>[a-z]+)_\d+", "--skip-bad")
    refused = palpate.refusal("learn", named, *words, "-o", out)
    assert "No picture of pen can be used: pen_0.png is" in refused


def test_touches_in_files_beside_a_preview_are_told(palpate, tmp_path):
    for n in range(3):
        np.savetxt(tmp_path / f"{n}.csv", np.eye(4), delimiter=",")
    Image.fromarray(np.eye(4, dtype=np.uint8)).save(tmp_path / "preview.png")
    lines = palpate.printed("check", tmp_path).splitlines()
    fix = "if these are the touches, take the pictures out"
    assert f"Note: 3 files of .csv left alone (0.csv, 1.csv, 2.csv): {fix}." in lines


def test_notes_name_the_few_in_colour_and_what_is_flat_empty_or_no_png(
    palpate, tmp_path, rng
):
    put_each(tmp_path, 6, ending="jpg")
    put(tmp_path / "pen" / "gel.jpg", rng.integers(0, 255, (10, 12, 3)))
    put(tmp_path / "pen" / "black.jpg", np.zeros((10, 12)))
    put(tmp_path / "pen" / "old.bmp")
    (tmp_path / "cup").mkdir()
    answer = palpate.answer("check", tmp_path)
    assert answer["odd"] == {"coloured": ["pen/gel.jpg"], "flat": ["pen/black.jpg"]}
    colour, flat, other, empty = answer["notes"]
    assert colour.startswith("1 picture in colour among grey ones, read in grey, to")
    assert colour.endswith(": pen/gel.jpg")
    assert flat.endswith("all over, to be recorded again or left out: pen/black.jpg")
    assert other == "1 file of .bmp left alone (pen/old.bmp): save as PNG"
    assert empty == "1 folder empty: cup/"


def test_a_folder_of_bmp_alone_is_read_and_a_note_says_so(palpate, tmp_path):
    answer = palpate.answer("check", put_each(tmp_path, 3, ending="bmp"))
    assert answer["n_touches"] == 6
    assert answer["notes"] == [
        "6 files of .bmp read in grey, none looked at: save them as PNG"
    ]


def test_a_missing_picture_of_no_contact_is_refused_with_the_nearest_name(
    palpate, odd, tmp_path
):
    for name in ("loose.png", "mug/001.png"):
        shutil.copy(odd / "pen" / "001.png", odd / name)
    for near in (odd / "lose.png", "loose.png"):
        refused = palpate.refusal("check", odd, "--no-contact", near)
        assert f"Did you mean {odd / 'loose.png'}?" in refused
        assert "out of the folder" not in refused
    refused = palpate.refusal("check", odd, "--no-contact", odd / "zzzzzz")
    assert "Give another --no-contact, or leave it out." in refused


def test_a_mistyped_path_is_refused_with_the_nearest_name(palpate, odd, tmp_path):
    assert f"Did you mean {odd}/?" in palpate.refusal("check", odd.parent / "touchs")
    (tmp_path / "mugs.palpate").write_bytes(b"")
    refused = palpate.refusal("recognise", tmp_path / "mug.palpate", odd)
    assert f"Did you mean {tmp_path / 'mugs.palpate'}?" in refused
