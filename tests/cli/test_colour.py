"""Pictures in colour: a model reads new ones as it read those that taught it."""

import numpy as np
import pytest

from palpate import ObjectRecogniser, Touches
from palpate.library import TouchLibrary
from palpate.sensors import open_sensor

from .conftest import put

TINTS = {"ball": (60, 0, 0), "pen": (0, 60, 0)}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Eight pictures of each object to teach it, and eight new ones of it."""
    root, rng = tmp_path_factory.mktemp("gel"), np.random.default_rng(0)
    for part in ("taught", "new"):
        for name, tint in TINTS.items():
            for number in range(8):
                levels = rng.integers(60, 120, (16, 20, 1)) + np.array(tint)
                put(root / part / name / f"{number}.png", levels)
    return root


@pytest.fixture(scope="module")
def models(pictures):
    """Models learnt from the same pictures, in colour and in grey."""
    return [
        ObjectRecogniser()
        .fit(Touches.load(pictures / "taught", colour=colour))
        .save(pictures / f"{colour}.palpate")
        for colour in (True, False)
    ]


def test_learning_says_that_colours_were_left(palpate, pictures):
    words = ("learn", pictures / "taught", "-o", pictures / "said.palpate")
    noted = "Pictures in colour were read in grey: --colour"
    assert noted in palpate.printed(*words)
    assert noted not in palpate.printed(*words, "--colour")


@pytest.mark.parametrize("ending", ["npy", "csv", "bmp"])
def test_of_other_files_than_pictures_no_colours_were_left(
    palpate, tmp_path, rng, ending
):
    for name in TINTS:
        for number in range(4):
            path = tmp_path / "t" / name / f"{number}.{ending}"
            levels = rng.integers(0, 255, (8, 9, 3), dtype=np.uint8)
            path.parent.mkdir(parents=True, exist_ok=True)
            if ending == "bmp":
                put(path, levels)
            elif ending == "npy":
                np.save(path, levels[..., 0])
            else:
                np.savetxt(path, levels[..., 0], fmt="%d", delimiter=",")
    result = palpate("learn", tmp_path / "t", "-o", tmp_path / "m.palpate")
    assert (result.returncode, result.stderr) == (0, "")
    assert "--colour" not in result.stdout


def test_evaluating_says_that_colours_were_left(palpate, pictures):
    words = "evaluate", "--train", pictures / "taught", "--test", pictures / "new"
    grey = palpate.answer(*words)
    assert "read in grey: --colour" in grey["recommendations"][0]
    coloured = palpate.answer(*words, "--colour")
    assert not any("read in grey" in s for s in coloured["recommendations"])


def test_numbers_beside_numbered_taxels_are_said_to_be_left(palpate, tmp_path):
    """A fingertip of electrodes also writes pressure and temperature."""
    rng, path = np.random.default_rng(0), tmp_path / "tips.csv"
    rows = [["object", "time_s", "E1", "E2", "E3", "PDC", "TDC"]]
    for n, name in enumerate(["mug", "pen"] * 12):
        levels = 1000.0 * (n % 2) + rng.normal(size=3)
        rows.append([name, n, *levels, *rng.normal(size=2)])
    path.write_text("\n".join(",".join(map(str, row)) for row in rows))
    left = "numbers beside the numbered taxels are kept, not looked at (PDC, TDC)"
    assert any(left in note for note in palpate.answer("check", path)["notes"])
    result = palpate("learn", path, "-o", tmp_path / "m.palpate")
    assert left in " ".join(result.stdout.replace("Numbers", "numbers").split())
    advice = palpate.answer("evaluate", "--train", path, "--split", "last")[
        "recommendations"
    ]
    assert left in f"n{advice[0][1:]}"
    touches = Touches.load(path)
    assert [*touches.columns] == ["object", "time_s", "PDC", "TDC"]
    path.write_text(path.read_text().replace("PDC", "E4").replace("TDC", "E5"))
    checked = palpate.answer("check", path)
    assert checked["size"] == "1 x 5"
    assert not checked["notes"]


def test_columns_that_were_read_as_taxels_are_named(palpate, tmp_path, rng):
    """A time or the number of an object among them would tell objects by itself."""
    path = tmp_path / "fields.csv"
    rows = [["object", "Bx", "By", "Bz", "ticks", "object_id"]]
    for n, name in enumerate(["mug", "pen"] * 12):
        rows.append([name, *rng.normal(size=3), n + rng.random(), n % 2])
    path.write_text("\n".join(",".join(map(str, row)) for row in rows))
    names = (
        "5 columns of numbers were read as taxels, in this order: Bx, By, Bz, ticks, "
        "object_id"
    )
    (note,) = palpate.answer("check", path)["notes"]
    assert note.startswith(names)
    printed = palpate("learn", path, "-o", tmp_path / "m.palpate").stdout
    assert names in " ".join(printed.split())
    words = ("evaluate", "--train", path, "--split", "last")
    assert palpate.answer(*words)["recommendations"][0].startswith(names)
    path.write_text(path.read_text().replace("Bx,By,Bz,ticks,object_id", "0,1,2,3,4"))
    assert not palpate.answer("check", path)["notes"]


def test_taxels_in_another_order_than_those_learnt_are_refused(palpate, tmp_path, rng):
    """Figures were those of guessing, and nobody said why."""
    rows = [f"{'ab'[n % 2]},{n % 2 + rng.random()},{rng.random()}" for n in range(24)]
    teach, ask, more = (tmp_path / name for name in ("t.csv", "a.csv", "m.csv"))
    for path, names in ((teach, "E1,E2"), (ask, "E2,E1"), (more, "t0,t1")):
        path.write_text("\n".join([f"object,{names}", *rows]))
    words = ("evaluate", "--train", teach, "--test", more)
    assert palpate.answer(*words)["n_test_touches"] == 24
    message = f"{ask} must have its taxels in the order of {teach}, got E2 where E1 is"
    assert message in palpate.refusal(*words[:-1], ask)
    assert message in palpate.refusal(*words, "--unknown", ask)


def test_a_folder_of_parquet_hides_nothing(palpate, pictures, tmp_path):
    pytest.importorskip("pyarrow")
    folder = tmp_path / "set.parquet"
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(Touches.load(pictures / "taught"))
        library.export(folder, by="object")
    words = ("learn", folder, "-o", tmp_path / "m.palpate")
    assert "colour" not in palpate.printed(*words)


def test_a_model_of_colours_reads_colours(palpate, pictures, models):
    episodes = palpate.answer("recognise", models[0], pictures / "new")["episodes"]
    for episode in episodes:
        assert episode["beliefs"][-1]["posterior"][episode["object"]] > 0.9
    assert len(episodes) == 2
    new, output = pictures / "new", pictures / "again.palpate"
    palpate.printed("remount", models[0], new, "-o", output)
    palpate.printed("learn", new, "--extend", models[0], "-o", output)


def test_grey_is_refused_where_colours_were_learnt(pictures, models):
    recogniser = ObjectRecogniser.load(models[0])
    grey = Touches.load(pictures / "new")
    for ask in (recogniser.evidence, recogniser.remount):
        with pytest.raises(ValueError, match=r"have r, g, b a pixel.*with `colour`"):
            ask(grey)


def test_colours_are_refused_where_grey_was_learnt(palpate, pictures, models):
    result = palpate.refusal("recognise", models[1], pictures / "new", "--colour")
    assert "must have one level a pixel" in result
    assert "Leave --colour out, or learn again." in result


def test_an_array_in_colour_is_one_picture_or_several(pictures, models):
    recogniser = ObjectRecogniser.load(models[0])
    touches = Touches.load(pictures / "new", colour=True)
    wanted = recogniser.evidence(touches).log_likelihood
    several = recogniser.evidence(touches.images).log_likelihood
    np.testing.assert_array_equal(several, wanted)
    alone = recogniser.evidence(touches.images[3]).log_likelihood
    np.testing.assert_allclose(alone, wanted[3:4], atol=1e-9)  # sums in another order
    assert (recogniser.predict(touches.images) == touches.object).all()


def test_pictures_are_replayed_in_colour(pictures):
    still = pictures / "new" / "ball" / "0.png"
    address = f"replay:{pictures / 'new'}?colour=1&no-contact={still}"
    sensor = open_sensor(address)
    assert sensor.image_shape == (16, 20, 3)
    assert sensor.unit == "colour level"
    assert open_sensor(address.replace("colour=1&", "")).unit == "grey level"


def test_a_driver_that_is_not_installed_is_named():
    whole = r'digit:, .* pip install "git\+https://.*#subdirectory=plugs/drivers"'
    with pytest.raises(ValueError, match=whole):  # the folder is in a checkout alone
        open_sensor("digit2:DIGIT")
