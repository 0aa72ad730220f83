"""`palpate study` as a command: JSON, skipped data, refusals; study of sessions."""

import json
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from palpate import Touches
from palpate.cli import app, main
from palpate.simulation import DomeCamera, simulate_touches
from palpate.studies import STUDIES, liu2014
from palpate.studies.corradi2014 import Corradi2014Plan
from palpate.studies.corradi2015 import Corradi2015Plan
from palpate.studies.liu2014 import Liu2014Plan


@pytest.fixture
def tiny_quick(least_plan, monkeypatch):
    """Let --quick mean the least plan, without real presses."""

    def quick(**changes):
        return least_plan(covers_mm=(0.9,), **changes)

    monkeypatch.setattr(Liu2014Plan, "quick", quick)
    monkeypatch.delenv("PALPATE_DATA", raising=False)


def test_json_is_one_object_and_what_is_missing_is_said(tiny_quick):
    arguments = ["study", "liu2014", "--quick", "--json", "--workers", "1"]
    completed = CliRunner().invoke(app, [*arguments, "--seed", "2"])
    assert completed.exit_code == 0, completed.output
    result = json.loads(completed.stdout)
    assert result["study"] == "liu2014"
    assert result["plan"]["seed"] == 2
    assert [completed.stderr.strip()] == result["skipped"]
    paper = {row["name"]: row["paper"] for row in result["rows"]}
    assert paper["KPCA+MKL-SVM"] == 85.54
    for row in result["rows"]:
        assert isinstance(row["ours"], float)


def test_tables_and_report_for_people(tiny_quick, monkeypatch, tmp_path):
    # Empty pictures: `test_liu2014_study` has them drawn.
    figure = pytest.importorskip("matplotlib.figure").Figure
    drawings = [name for name in vars(liu2014) if name.startswith("draw_")]
    for name in drawings:
        monkeypatch.setattr(liu2014, name, lambda _: figure())
    report = tmp_path / "liu.html"
    arguments = ["study", "liu2014", "--quick", "--workers", "1"]
    arguments += ["--protocol", "nested", "--report", str(report)]
    completed = CliRunner().invoke(app, arguments)
    assert completed.exit_code == 0, completed.output
    assert "Table 2" in completed.stdout
    assert completed.stdout.rstrip().endswith("liu.html")
    page = report.read_text("utf-8")
    assert page.startswith("<!doctype html>")
    assert page.count('role="img"') == len(drawings) == 6


def test_studies_are_listed():
    for arguments in (["study"], ["study", "--list"]):
        completed = CliRunner().invoke(app, arguments)
        assert completed.exit_code == 0
        assert all(name in completed.stdout for name in STUDIES)
    done = CliRunner().invoke(app, ["study", "--list", "--json"])
    assert json.loads(done.stdout)["studies"].keys() == STUDIES.keys()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study", "liu"], "'liu2014'"),
        (["study", "liu2014", "--data", "gone"], "--data must name a folder"),
        (["study", "liu2014", "--protocol", "best"], "'nested', 'paper'"),
        (["study", "liu2014", "--report", "r.pdf"], "must end in .html"),
        (["study", "corradi2015", "--protocol", "paper"], "got 'protocol'. Leave it"),
        (["study", "liu2014", "--workers", "0"], "workers must be at least 1"),
    ],
)
def test_failures_say_what_to_do(arguments, message, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["palpate", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    captured = capsys.readouterr()
    assert stopped.value.code == 1 + ("--workers" in arguments)
    assert message in captured.err
    assert "\n" not in captured.err.rstrip()
    assert captured.out == ""


@pytest.mark.parametrize(
    ("plan", "changes", "message"),
    [
        (Corradi2014Plan, {"n_touches": 5}, "n_touches must be at least 10, got 5"),
        (Corradi2014Plan, {"encodings": ("hog",)}, "encodings must be one of 'hu'"),
        (Corradi2015Plan, {"partitions": 0}, "partitions must be at least 1"),
        (Corradi2015Plan, {"n_train": 2}, "n_train must be at least 6"),
        (Corradi2015Plan, {"n_simulated": 20}, "n_simulated must be at least 75"),
        (Corradi2015Plan, {"clusters": (0,)}, "clusters must be at least 1"),
        (Corradi2015Plan, {"seed": -1}, "seed must be at least 0"),
        (Liu2014Plan, {"protocol": "best"}, "protocol must be one of"),
        (Liu2014Plan, {"parts": (3,)}, "parts must be two or more"),
        (Liu2014Plan, {"parts": (3, 13)}, "between 1 and 12"),
        (Liu2014Plan, {"n_presses": 5}, "n_presses must be at least 6, got 5"),
        (Liu2014Plan, {"runs": 0}, "runs must be at least 1"),
    ],
)
def test_plans_of_bad_sizes_are_refused(plan, changes, message):
    with pytest.raises(ValueError, match=message):
        plan(**changes)


@pytest.mark.slow
def test_quick_is_quick_and_draws_every_picture(tmp_path):
    arguments = ["study", "liu2014", "--quick", "--json", "--report", "liu.html"]
    completed = subprocess.run(
        [sys.executable, "-m", "palpate", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert completed.returncode == 0, completed.stderr
    assert json.loads(completed.stdout)["seconds"] < 60
    assert (tmp_path / "liu.html").read_text("utf-8").count('role="img"') == 6


TINY = {
    "sessions": 2,
    "touches_each": 5,
    "touches": (1, 3, 10),  # more than some recordings have
    "orders": 2,
    "draws": 3,
    "ways": ("none", "confirm:1"),
    "objects": ("ball", "box"),
}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    rng = np.random.default_rng(0)
    names, days = np.tile(["a", "b", "c"], 16), np.repeat(["mon", "tue"], 24)
    images = rng.normal(size=(48, 1, 6)) + 4 * (names == "a")[:, None, None]
    touches = Touches(images, object=names, session=days, geometry="none")
    people = np.repeat(["x", "y", "x", "y"], 12)
    touches.with_columns(subject=people).save(folder / "two_days.npz")
    moved = np.array(["bowl_whitebig", "mug_blacksquared", "ball"])[np.arange(48) % 3]
    rims = np.repeat([[20.0, 20.0, 9.0], [30.0, 20.0, 9.0]], 24, axis=0)
    jumped = touches.without("session").with_columns(
        object=moved,
        category=moved,
        order=np.arange(48),
        rim_circle_row_col_radius_px=rims,
    )
    jumped.save(folder / "jumped.npz")
    touches[days == "mon"].save(folder / "one_day.npz")
    np.savez(folder / "no_touches.npz", numbers=np.arange(3))
    small = partial(simulate_touches, camera=DomeCamera(image_shape=(40, 40)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.studies.sessions.simulate_touches", small)
        return STUDIES["sessions"].run(data=folder, workers=1, progress=False, **TINY)


@pytest.mark.slow
def test_every_source_has_every_way_and_one_day_is_no_source(result):
    rows = result["rows"]
    sources = {row["data"] for row in rows}
    assert sources == {"simulated dome", "simulated array", "two_days", "jumped"}
    for data in sources - {"jumped"}:
        ways = {row["way"] for row in rows if row["data"] == data}
        assert {"as it is", "one confirmed touch an object", "alarm: area"} <= ways
        assert "brightness alone" in ways
        assert "the last quarter of the same sessions" in ways
    ways = {row["way"] for row in rows if row["data"] == "two_days"}
    assert "pairs of others known, its touches without labels" in ways
    ways = {row["way"] for row in rows if row["data"] == "jumped"}
    assert ways == {
        "object after the camera jumped, as it is",
        "object after the camera jumped, its touches without labels",
        "category after the camera jumped, as it is",
    }
    assert all(0 <= row["ours"] <= 100 for row in rows)


@pytest.mark.slow
def test_tables_and_report_have_every_source_of_sessions(result, tmp_path):
    titles = [title for title, _, _ in STUDIES["sessions"].tables(result)]
    assert titles == ["simulated dome", "simulated array", "jumped", "two_days"]
    pytest.importorskip("matplotlib")
    page = STUDIES["sessions"].write_report(tmp_path / "sessions.html", result)
    assert "two_days" in page.read_text()
