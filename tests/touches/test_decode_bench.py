"""The benchmark of decoding measures what it says, on a small folder."""

import pytest

from palpate.bench import run_bench


def test_rows_tell_time_and_memory(monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    rows = run_bench("decode", repeats=1, n_pictures=24)
    assert [row["name"] for row in rows] == [
        "24 x 640 x 480 uint8 JPEG drawn folder cpu",
        "24 x 640 x 480 uint8 JPEG drawn folder wall",
        "24 x 640 x 480 uint8 JPEG drawn folder an eighth of the size, the least cpu",
    ]
    *ours, least = rows
    assert least["peer_ms"] == ours[0]["peer_ms"]
    for row in ours:
        assert row["array_mib"] == 24 * 640 * 480 / 2**20
        assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])
        # The array itself was in memory; the interpreter alone takes over 10 MiB.
        assert row["peak_mib"] > row["array_mib"] + 10
        assert row["peak_mib"] >= row["peak_before_mib"]
