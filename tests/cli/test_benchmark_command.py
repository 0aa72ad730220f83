"""`palpate benchmark` from outside: JSON, text, the page, and what it refuses."""

import json
from html import unescape

import numpy as np
import pytest

from palpate import Touches

FEW = ("--recognisers", "taxels SVM, 3-NN", "--protocols", "halves,sessions")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    rng = np.random.default_rng(0)
    images = np.repeat(rng.normal(size=(2, 3, 8)), 10, axis=0)
    touches = Touches(images, object=["a"] * 10 + ["b"] * 10, geometry="none")
    (folder / "deeper").mkdir()
    touches.save(folder / "deeper" / "one.npz")
    (folder / "broken.npz").write_bytes(b"no archive")
    return folder


def test_json_has_the_promised_keys(palpate, folder):
    result = palpate("benchmark", folder, *FEW, "--json")
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    answer = json.loads(result.stdout)
    (entry,) = answer["benchmark"]
    promised = (
        "archive protocol n_touches n_labels n_folds left_out rows controls behind"
    )
    assert {*promised.split()} <= entry.keys()
    assert (entry["archive"], entry["n_touches"]) == ("deeper/one.npz", 20)
    assert [row["recogniser"] for row in entry["rows"]] == ["taxels SVM", "3-NN"]
    promised = "accuracy sd se after no_contact log_loss seconds chosen reason"
    for row in entry["rows"]:
        assert row.keys() == {"recogniser", *promised.split()}
        assert row["accuracy"] == 1
    skipped = [(skip["archive"], skip["protocol"]) for skip in answer["skipped"]]
    assert skipped == [("broken.npz", None), ("deeper/one.npz", "sessions")]


def test_text_and_page_say_the_same(palpate, folder, tmp_path):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    page = tmp_path / "b.html"
    archive = folder / "deeper" / "one.npz"
    result = palpate("benchmark", archive, *FEW, "--report", page)
    assert result.returncode == 0, result.stderr
    for text in (result.stdout, unescape(page.read_text())):
        assert "one.npz: 20 touches" in text
        assert "control: majority" in text
        assert "touches must have a column 'session'" in " ".join(text.split())
    assert result.stdout.splitlines()[-1] == str(page)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--recognisers", "CNN"], 1, "recognisers must be one of 'default'"),
        (["--protocols", "thirds"], 1, "protocols must be one of"),
        (["--touches", "few"], 2, "--touches must be whole numbers"),
        (["--report", "page.txt"], 1, "must end in .html"),
        (["--workers", "0"], 2, "--workers must be at least 1"),
    ],
)
def test_a_wrong_option_is_refused_with_what_it_must_be(
    palpate, folder, arguments, code, message
):
    if "--report" in arguments:
        pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    result = palpate("benchmark", folder, *arguments)
    assert (result.returncode, result.stdout) == (code, "")
    assert message in result.stderr


def test_an_empty_folder_is_refused(palpate, tmp_path):
    assert "Touches.save" in palpate.refusal("benchmark", tmp_path)
