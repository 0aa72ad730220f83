"""What benchmarks are made of: timing, rows, peers that compute the same, features."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from threadpoolctl import threadpool_info

from palpate.bench import _encodings, _library, one_thread, row, run_bench
from palpate.encodings import ZernikeMoments


def test_one_thread_limits_the_linear_algebra():
    with one_thread():
        assert all(pool["num_threads"] == 1 for pool in threadpool_info())


def test_a_row_says_how_much_faster_ours_is():
    assert row("size", 2.0, "peer", 6.0, n=1) == {
        "name": "size",
        "ours_ms": 2.0,
        "peer": "peer",
        "peer_ms": 6.0,
        "ratio": 3.0,
        "n": 1,
    }
    absent = row("size", 2.0, "peer", None, reason="peer is not installed")
    assert absent["ratio"] is None
    with pytest.raises(ValueError, match="reason must be given"):
        row("size", 2.0, "peer", None)


def test_peers_compute_the_same_moments(rng):
    images = rng.uniform(0.1, 1, size=(2, 20, 20))
    ours = ZernikeMoments(6, method="sample").fit_transform(images)
    # Rounding: 1e-10 is asked of every peer.
    assert_allclose(_encodings.dense_basis(20, 6)(images), ours, atol=1e-10)
    for peer, (encode, _) in _encodings._peers(20, 6).items():
        if encode is None or peer == "dense basis":
            continue
        found = np.asarray(encode(images[:1])).ravel()
        # mahotas divides by the sum of the image.
        assert_allclose(found / found[0], ours[0] / ours[0, 0], atol=1e-10)


def test_rows_name_size_type_mode_and_batch(monkeypatch):
    monkeypatch.setattr(
        _encodings, "find_spec", lambda name: None if name == "mahotas" else name
    )
    monkeypatch.setattr(_encodings, "_centrosome", lambda size, order: np.sum)
    rows = run_bench("zernike", size=16, order=4, n_touches=3, seconds=0.002)
    names = {r["name"] for r in rows}
    assert len(rows) == 3 * len(names) == 36
    assert "16 x 16 float64 sample single" in names
    assert "16 x 16 uint8 exact batch 3" in names
    for r in rows:
        if r["peer"] == "mahotas":
            assert r["ratio"] is None
            assert "not installed" in r["reason"]
        else:
            assert r["ratio"] == r["peer_ms"] / r["ours_ms"]


def test_stored_and_tested_touches_are_apart():
    stored, labels, new = _library._features(None, 5000, 22, seed=0)
    assert stored.shape == (5000, 22)
    assert (labels[:100] == 0).all()
    assert not set(map(tuple, new.round(9))) & set(map(tuple, stored.round(9)))


@pytest.mark.slow
def test_learning_is_measured_beside_a_plain_svm_and_learning_again():
    rows = run_bench("learning", n_objects=3, n_each=8, many=4, many_each=20)
    assert [r["name"] for r in rows] == [
        "learning 3 objects x 8 touches 120 x 120 default",
        "learning 4 objects x 20 touches 120 x 120 default",
        "adding ten touches at 50",
        "adding an object of 20 touches at 50",
        "page learning again 72 touches wall",
    ]
    assert all(r["ratio"] == r["peer_ms"] / r["ours_ms"] > 0 for r in rows)
