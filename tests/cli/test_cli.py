"""The command line from outside: JSON, exit codes, and one sentence per failure."""

import json
import subprocess
import sys

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import ObjectRecogniser

NAMES = ("ball", "mug", "pen")
VERBS = (
    "learn",
    "recognise",
    "evaluate",
    "simulate",
    "study",
    "explore",
    "library",
    "serve",
    "record",
    "live",
    "demo",
    "bench",
    "doctor",
)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    rng = np.random.default_rng(0)
    patterns = rng.normal(size=(3, 3, 24))
    images = np.repeat(patterns, 20, axis=0) + 0.5 * rng.normal(size=(60, 3, 24))
    folder = tmp_path_factory.mktemp("touches")
    touches = Touches(images, object=np.repeat(NAMES, 20), geometry="none")
    touches.save(folder / "t.npz")
    return folder / "t.npz"


@pytest.fixture(scope="module")
def model(archive):
    recogniser = ObjectRecogniser().fit(Touches.load(archive))
    return recogniser.save(archive.parent / "m.palpate")


def test_learn_writes_a_model_that_recognises(palpate, archive, tmp_path):
    done = palpate("learn", archive, "-o", tmp_path / "m.palpate", "--json")
    assert done.returncode == 0, done.stderr
    learnt = json.loads(done.stdout)
    assert learnt["n_labels"] == 3
    assert ObjectRecogniser.load(learnt["model"]).classes_.tolist() == list(NAMES)


def test_recognise_gives_one_episode_per_object(palpate, archive, model):
    done = palpate("recognise", model, archive, "--json")
    episodes = json.loads(done.stdout)["episodes"]
    assert [e["object"] for e in episodes] == list(NAMES)
    for episode in episodes:
        assert [b["touch"] for b in episode["beliefs"]] == list(range(1, 21))
        for belief in episode["beliefs"]:
            assert sum(belief["posterior"].values()) == pytest.approx(1)
            assert 0 <= belief["unknown"] <= 1
        assert episode["decision"] == episode["object"]
        assert 1 <= episode["touches_used"] <= 20
        assert episode["reasons"]


def test_recognise_draws_the_belief_for_people(palpate, archive, model):
    done = palpate("recognise", model, archive)
    assert done.returncode == 0
    assert "Touches of mug:" in done.stdout
    assert "touch   1" in done.stdout
    assert "█" in done.stdout


def test_evaluate_prints_json_and_writes_the_report(palpate, archive, tmp_path):
    report = tmp_path / "r.html"
    done = palpate(
        "evaluate",
        "--train",
        archive,
        "--split",
        "last",
        "--touches",
        "1,3",
        "--report",
        report,
        "--json",
    )
    figures = json.loads(done.stdout)
    assert set(figures["accuracy"]) == {"1", "3"}
    assert report.read_text().startswith("<!doctype html>")
    assert done.stderr == ""


def test_every_verb_has_help(palpate):
    listed = palpate("--help").stdout
    for verb in VERBS:
        assert verb in listed
        assert palpate(verb, "--help").returncode == 0


def test_help_loads_nothing_heavy():
    code = (
        "import sys; sys.argv = ['palpate', '--help']\n"
        "from palpate.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'sklearn', 'cv2', 'matplotlib', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["recognise", "gone.palpate", "gone.npz"], 1, "no model file gone.palpate"),
        (["learn", "gone", "-o", "m.palpate"], 1, "gone"),
        (["learn", "gone", "-o", "m.pkl"], 1, "must end in .palpate"),
        (["evaluate", "--train", "gone", "--touches", "a"], 1, "--touches 1,5,15"),
        (["bench", "speed"], 1, "'zernike'"),
        (["learn"], 2, "Missing argument"),
        (["touch"], 2, "No such command"),
    ],
)
def test_failures_say_what_to_do(palpate, arguments, code, message, tmp_path):
    done = palpate(*arguments, cwd=tmp_path)
    assert done.returncode == code
    assert message in done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr


def test_a_split_without_labels_is_refused(palpate, archive, tmp_path):
    Touches.load(archive).without("object").save(tmp_path / "bare.npz")
    done = palpate("evaluate", "--train", tmp_path / "bare.npz", "--split", "last")
    assert done.returncode == 1
    assert "column 'object'" in done.stderr


def test_demo_without_data_says_where_to_get_it(palpate, monkeypatch, tmp_path):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    done = palpate("demo", "--real", cwd=tmp_path)
    assert done.returncode == 1
    assert "PALPATE_DATA" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_doctor_knows_this_installation(palpate):
    done = palpate("doctor", "--json")
    found = json.loads(done.stdout)
    assert found["healthy"]
    assert {"numpy", "matplotlib"} <= {check["name"] for check in found["checks"]}


def test_bench_lists_its_names(palpate):
    assert "zernike" in palpate("bench", "--list").stdout
