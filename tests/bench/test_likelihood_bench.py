"""The likelihood benchmark: every size beside every peer, and right answers."""

import pytest

from palpate.bench import run_bench


@pytest.fixture(scope="module")
def rows():
    return run_bench("likelihood", seconds=0.001)


def test_every_size_beside_every_peer(rows):
    # Three peers, three sizes, single and batch.
    assert len(rows) == 3 * 3 * 2
    assert len({(row["name"], row["peer"]) for row in rows}) == len(rows)
    assert "50 objects x 94 touches, 22 features, float32 batch 64" in {
        row["name"] for row in rows
    }
    for row in rows:
        assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])


def test_what_is_timed_is_right(rows):
    # What the classifier promises in single precision, wherever the touch is.
    assert max(row["error_nats"] for row in rows) < 1e-3
