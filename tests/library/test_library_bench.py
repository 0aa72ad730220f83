"""The benchmark of libraries runs at a small size and has the rows it promises."""

import pytest

from palpate.bench import BENCHES, run_bench


@pytest.fixture(autouse=True)
def _without_real_touches(monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)


def test_a_small_run_has_every_row():
    pytest.importorskip("faiss")
    rows = run_bench("library", sizes=(500,), seconds=0.005)
    names = [row["name"] for row in rows]
    assert len(set(names)) == len(names) == 10 + 2 * 4
    assert all(row["ours_ms"] > 0 for row in rows)
    added = rows[0]
    assert added["touches_per_s"] == pytest.approx(1000 / added["ours_ms"])
    assert 100 < added["bytes_per_touch"] < 3000
    streamed = rows[2]
    assert "streamed" in streamed["name"]
    assert streamed["touches_per_s"] == pytest.approx(1000 / streamed["ours_ms"])
    indexed = [row for row in rows if "index" in row["name"]]
    assert all(0 <= row["equal_decisions"] <= 1 for row in indexed)
    assert all("random" in row["name"] for row in indexed)
    assert all(row["ratio"] is not None or row["reason"] for row in rows)


def test_the_benchmarks_are_listed():
    assert {"library", "library-large"} <= set(BENCHES)
