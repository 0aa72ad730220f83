"""The benchmark of multiple kernel learning: rows, and that what is timed is solved."""

import pytest

from palpate.bench import run_bench


@pytest.fixture(scope="module")
def rows():
    return run_bench("mkl", seconds=0.02, large=False)


def test_every_peer_has_a_row_or_a_reason(rows):
    assert {"22 SVC fits", "MKLpy EasyMKL"} <= {row["peer"] for row in rows}
    for row in rows:
        if row["peer_ms"] is None:
            assert row["ratio"] is None
            assert row["reason"]
        else:
            assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])


def test_the_true_problem_is_solved(rows):
    beside_svc = [row for row in rows if row["peer"] == "22 SVC fits"]
    assert beside_svc
    assert all(row["gap"] <= 1e-6 for row in beside_svc)
