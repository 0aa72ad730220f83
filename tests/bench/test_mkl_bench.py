"""The benchmark of multiple kernel learning: rows, and that what is timed is solved."""

import numpy as np
import pytest

from palpate.bench import _mkl


@pytest.fixture(scope="module")
def rows():
    return _mkl.bench_mkl(seconds=0.05)


def test_every_peer_has_a_row_or_a_reason(rows):
    assert {row["peer"] for row in rows} == {"22 SVC fits", "MKLpy EasyMKL"}
    for row in rows:
        if row["peer_ms"] is None:
            assert row["ratio"] is None
            assert "make bench" in row["reason"]
        else:
            assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])


def test_the_true_problem_is_solved(rows):
    assert all(row["gap"] <= 1e-6 for row in rows)


def test_kernels_have_a_mean_diagonal_of_one(rng):
    kernels = _mkl.paper_kernels(rng.normal(size=(9, 4)))
    assert kernels.shape == (22, 9, 9)
    np.testing.assert_allclose(np.einsum("kii->k", kernels), 9)
