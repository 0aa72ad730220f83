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
    printed = palpate.printed("benchmark", archive, *FEW, "--report", page)
    for text in (printed, unescape(page.read_text())):
        assert "one.npz: 20 touches" in text
        assert "control: majority" in text
        assert "touches must have a column 'session'" in " ".join(text.split())
    assert printed.splitlines()[-1] == str(page)


def test_a_report_that_is_no_page_is_refused(palpate, folder):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    refused = palpate.refusal("benchmark", folder, "--report", "page.txt")
    assert "must end in .html" in refused
