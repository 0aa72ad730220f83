"""The study of sessions: rows of every way, controls, a ceiling and an alarm."""

from functools import partial

import numpy as np
import pytest

from palpate import Touches
from palpate.simulation import DomeCamera, simulate_touches
from palpate.studies import STUDIES

TINY = {
    "sessions": 2,
    "touches_each": 5,
    "touches": (1, 3),
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


def test_it_is_shown(result, tmp_path):
    titles = [title for title, _, _ in STUDIES["sessions"].tables(result)]
    assert titles == ["simulated dome", "simulated array", "jumped", "two_days"]
    pytest.importorskip("matplotlib")
    page = STUDIES["sessions"].write_report(tmp_path / "sessions.html", result)
    assert "two_days" in page.read_text()
