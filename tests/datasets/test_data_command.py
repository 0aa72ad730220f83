"""`palpate data`, and the commands that use the sets and models it fetched."""

import json
import re
from operator import itemgetter
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.datasets import card, fetch, names, where
from palpate.simulation import simulate_presses
from palpate.web import PageServer

from .conftest import zipped


def test_list_where_and_card(palpate, sources, pins):
    sources.put("tactip4", zipped(pins[0]))
    assert palpate("data", "where").stdout.strip() == str(where())
    assert palpate.answer("data", "where")["there"] is False
    result = palpate("data", "fetch", "tactip4")
    assert result.stdout.strip() == str(where() / "tactip4" / "tactip4.npz")
    assert "None stated by the source" in result.stderr
    assert "github.com/marselap/tactip-cnn-bayes" in result.stderr
    assert "was trusted" in result.stderr
    sets = palpate.answer("data", "list")["sets"]
    states = {record["name"]: record["state"] for record in sets}
    assert set(states) == set(names())
    assert states["tactip4"] == "there"
    assert states["mattress"] == "to fetch"
    assert states["gelsight_wedge"] == "no"
    listed = palpate("data", "list").stdout
    assert "tactip4         there     800 pictures" in listed


def test_fetch_as_json_notes_arrays_that_differ_from_those_of_the_figures(
    palpate, sources, pins
):
    sources.put("tactip4", zipped(pins[0]))
    answer = palpate.answer("data", "fetch", "tactip4")
    assert answer["name"] == "tactip4"
    assert any("not the arrays behind the figures" in note for note in answer["notes"])
    assert palpate.answer("data", "fetch", "tactip4")["notes"] == []


@pytest.mark.parametrize("name", names())
def test_a_printed_card_has_the_texts_of_the_json(palpate, name):
    printed = palpate("data", "card", name).stdout
    record = card(name)
    texts = [record[key] for key in ("what", "licence", "sensor", "tried")]
    texts += [record["source"]["page"], record.get("why_not", "")]
    texts += [*record["leaks"], *record["not_for"]]
    for figure in record["figures"]:
        texts += [figure["figure"], figure["command"]]
    assert [text for text in texts if text not in printed] == []
    assert palpate.answer("data", "card", name)["licence"] == record["licence"]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["fetch", "tactip5"], "Did you mean 'tactip4'"),
        (["card", "bathtub"], "Did you mean 'bathtip'"),
        (["fetch", "mattress"], "404"),
        (["fetch", "mattress", "--mirror", "lab"], "mirror must begin"),
    ],
)
def test_errors_are_a_sentence_and_json(arguments, error, palpate, sources):
    result = palpate("data", *arguments, "--json")
    assert result.returncode == 1
    assert error in json.loads(result.stdout)["error"]
    assert error in result.stderr
    assert "Traceback" not in result.stderr


def test_the_demo_says_how_to_get_its_pictures(palpate, tmp_path):
    refused = palpate.refusal("demo", "--real", "--data", tmp_path)
    assert "palpate data fetch bathtip" in refused
    assert str(tmp_path) in refused


def camera(rng, pattern):
    """Return a picture as the BathTip camera writes it: a disc with something on it."""
    rows, cols = np.mgrid[:480, :640]
    shade = cv2.resize(pattern, (640, 480)) + rng.normal(scale=3, size=(480, 640))
    disc = np.where(np.hypot(rows - 240, cols - 240) < 220, 60 + shade, 245)
    return cv2.imencode(".jpg", disc.clip(0, 255).astype(np.uint8))[1].tobytes()


def test_a_missing_model_is_named_also_without_a_home(palpate, monkeypatch):
    monkeypatch.delenv("PALPATE_DATA_HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("pathlib.Path.home", lambda: 1 / 0)
    assert "no model file my.palpate" in palpate.refusal(
        "recognise", "my.palpate", "t.npz"
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:bathtip:UserWarning")
def test_two_commands_make_the_demo(palpate, sources, tmp_path, monkeypatch):
    """Without PALPATE_DATA the fetched set lies in the cache."""
    monkeypatch.delenv("PALPATE_DATA")
    monkeypatch.setenv("PALPATE_DATA_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    files = {"baselineForCalibration.jpg": camera(rng, np.zeros((3, 3)))}
    owners = ("ball_yellowbeachball", "box_hst", "can_largeyellow", "mug_greenplain")
    for code, owner in enumerate(owners):
        pattern = np.random.default_rng(code).uniform(0, 120, (5, 5))
        folder = f"touch/0{code}_{owner.split('_')[0]}/01"
        for n in range(1, 90):
            name = f"touch_{code}_img_{n}_name_{owner}_at_{n}_0_1.jpg"
            files[f"{folder}/{name}"] = camera(rng, pattern)
    sources.put("bathtip", zipped(files))
    palpate.answer("data", "fetch", "bathtip")
    assert palpate.answer("demo", "--real")["n_labels"] == 2
    words = ("--protocols", "halves", "--recognisers", "3-NN")
    assert "bathtip50" in str(palpate.answer("benchmark", *words))


@pytest.fixture(scope="module")
def ready(tmp_path_factory):
    """A cache with the ready model of an array, which replaced an older one."""
    cache = tmp_path_factory.mktemp("cache")
    older = cache / "models" / "sim-array-0.palpate"
    older.parent.mkdir()
    older.write_bytes(b"of other code")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PALPATE_DATA_HOME", str(cache))
        fetch("sim-array")
    return cache


def test_a_ready_model_is_made_once_and_recognises_its_sensor(
    palpate, ready, tmp_path, monkeypatch
):
    """It recognises new noiseless presses of its own parts after three of each."""
    assert "sim-array       to make" in palpate("data", "list").stdout
    monkeypatch.setenv("PALPATE_DATA_HOME", str(ready))
    [path] = (ready / "models").iterdir()  # the model of other code was deleted
    modified_ns = path.stat().st_mtime_ns
    assert "sim-array       there" in palpate("data", "list").stdout
    assert Path(palpate("data", "fetch", "sim-array").stdout.strip()) == path
    new = tmp_path / "new.npz"
    simulate_presses(["bar10", "disc13"], 3, random_state=5).save(new)
    episodes = palpate.answer("recognise", "sim-array", new)["episodes"]
    best = [
        max(e["beliefs"][-1]["posterior"].items(), key=itemgetter(1)) for e in episodes
    ]
    assert [name for name, _ in best] == ["bar10", "disc13"]
    assert path.stat().st_mtime_ns == modified_ns
    assert "'sim-array'" in palpate.refusal("data", "fetch", "sim-arrow")


@pytest.mark.slow
def test_a_ready_model_of_a_page_is_a_copy_in_its_library(
    palpate, ready, tmp_path, monkeypatch
):
    pytest.importorskip("fastapi", reason='needs the extra "web"')
    monkeypatch.setenv("PALPATE_DATA_HOME", str(ready))
    [path] = (ready / "models").iterdir()
    used, desk = [], tmp_path / "desk"

    def run(server, app):
        used.append(app.state.session.model_path)

    monkeypatch.setattr(PageServer, "run", run)

    def served(*words):
        result = palpate("serve", "--port", "0", "--model", *words)
        assert result.returncode == 0, result.stderr

    served("sim-array", "--library", desk)
    copy = desk / "model.palpate"
    assert copy.read_bytes() == path.read_bytes()
    # `live` can teach and learn, but does not overwrite the ready model either.
    live = ("live", "sim-array", "--sensor")
    serve = ("serve", "--port", "0", "--model", "sim-array")
    for words in (serve, (*live, "sim:bar10")):
        refused = palpate.refusal(*words, "--library", desk)
        assert re.search("learnt on in a library that is not there.*desk", refused)
    # An absent sensor leaves no library behind, so that the next start can make it.
    later, absent = tmp_path / "later", "serial:/dev/nowhere?shape=10x10"
    assert "library" not in palpate.refusal(*live, absent, "--library", later)
    served("sim-array", "--library", later)
    assert used.pop() == later / "model.palpate"
    served("sim-array")
    served(path, "--library", tmp_path / "new")
    assert used == [copy, path, path]


def test_a_misspelt_ready_model_is_refused_with_the_nearest_name(palpate, tmp_path):
    refused = palpate.refusal("recognise", "sim-dom", tmp_path)
    assert "There is no model file sim-dom. Did you mean 'sim-dome'?" in refused


DOCS = Path(__file__).parents[2] / "docs"
NEEDED = {
    *("name", "what", "sensor", "touches", "objects", "sessions", "licence", "makes"),
    *("leaks", "not_for", "tried", "source", "holds", "figures"),
}


def row(name):
    """Return the row of a set in docs/reference/data.md."""
    record = card(name)
    place = ", ".join(f"`{place}`" for place in record["makes"])
    page = record["source"]["page"]
    source = f"[{page.split('//')[1].rstrip('/')}]({page})"
    licence = record["licence"].split(".")[0]
    state = "no" if "why_not" in record else "yes"
    cells = (f"`{name}`", record["what"], place, source, licence, state)
    return f"| {' | '.join(cells)} |"


@pytest.mark.parametrize("name", names())
def test_a_card_is_complete(name):
    record = card(name)
    assert set(record) >= NEEDED
    assert ("why_not" in record) != ("convert" in record)
    licences = ("None stated", "GPL-3 of the", "Open Data Commons")
    assert record["licence"].startswith(licences)
    if record["licence"].startswith("None stated"):
        assert "do not hand it on" in record["licence"]
    for figure in record["figures"]:
        assert set(figure) == {"figure", "split", "command", "page"}
    if "convert" in record:
        columns = set(record["convert"].get("columns", {}))
        assert set(record["arrays"]) <= columns | set(record["holds"])
        assert record["source"]["most_mb"] > 0
        assert re.search(r"[0-9a-f]{8}|1\.0\.0", record["source"]["url"])
        assert all(re.fullmatch("[0-9a-f]{64}", s) for s in record["arrays"].values())


@pytest.mark.parametrize("name", names())
def test_numbers_of_figures_are_on_their_page(name):
    """Every number of a figure is on the page that the card names for it."""
    for figure in card(name)["figures"]:
        page = (DOCS.parent / figure["page"]).read_text(encoding="utf-8")
        numbers = re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w])", figure["figure"])
        assert numbers
        for number in numbers:
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.]*\d)", page), (
                number
            )


@pytest.mark.parametrize("name", names())
def test_the_page_of_recorded_touches_has_the_set(name):
    assert row(name) in (DOCS / "reference/data.md").read_text("utf-8"), row(name)
