"""Benchmarks: timing, rows, peers that compute the same, and right answers."""

from importlib import import_module

import numpy as np
import pytest
from numpy.testing import assert_allclose
from threadpoolctl import threadpool_info

import mutants
from palpate.encodings import ZernikeMoments
from speed import BENCHES, encodings, library, one_thread, run_bench
from speed import row as row_of


def test_one_thread_limits_the_linear_algebra():
    with one_thread():
        assert all(pool["num_threads"] == 1 for pool in threadpool_info())


def test_a_row_says_how_much_faster_ours_is():
    assert row_of("size", 2.0, "peer", 6.0, n=1) == {
        "name": "size",
        "ours_ms": 2.0,
        "peer": "peer",
        "peer_ms": 6.0,
        "ratio": 3.0,
        "n": 1,
    }
    absent = row_of("size", 2.0, "peer", None, reason="peer is not installed")
    assert absent["ratio"] is None
    with pytest.raises(ValueError, match="reason must be given"):
        row_of("size", 2.0, "peer", None)


@pytest.mark.parametrize("name", mutants.CORE)
def test_a_fault_is_asked_of_tests_that_are_there(name):
    assert (mutants.ROOT / "src" / "palpate" / name).is_file()
    assert [path.name for path in mutants.tests_of(name) if not path.is_file()] == []


def test_peers_compute_the_same_moments(rng):
    images = rng.uniform(0.1, 1, size=(2, 20, 20))
    ours = ZernikeMoments(6, method="sample").fit_transform(images)
    # Rounding: every peer must agree within 1e-10.
    assert_allclose(encodings.dense_basis(20, 6)(images), ours, atol=1e-10)
    for peer, (encode, _) in encodings._peers(20, 6).items():
        if encode is None or peer == "dense basis":
            continue
        moments = np.asarray(encode(images[:1])).ravel()
        # mahotas divides by the sum of the image.
        assert_allclose(moments / moments[0], ours[0] / ours[0, 0], atol=1e-10)


def test_rows_name_size_type_mode_and_batch(monkeypatch):
    monkeypatch.setattr(
        encodings, "find_spec", lambda name: None if name == "mahotas" else name
    )
    monkeypatch.setattr(encodings, "_centrosome", lambda size, order: np.sum)
    rows = run_bench("zernike", size=16, order=4, n_touches=3, seconds=0.002)
    names = {row["name"] for row in rows}
    assert len(rows) == 3 * len(names) == 36
    assert "16 x 16 float64 sample single" in names
    assert "16 x 16 uint8 exact batch 3" in names
    of_absent = [row for row in rows if row["peer"] == "mahotas"]
    assert len(of_absent) == len(names)
    assert all("not installed" in row["reason"] for row in of_absent)


def test_no_tested_touch_is_stored():
    stored, labels, new = library._features(None, 5000, 22, seed=0)
    assert stored.shape == (5000, 22)
    assert (labels[:100] == 0).all()
    assert not set(map(tuple, new.round(9))) & set(map(tuple, stored.round(9)))


@pytest.mark.slow
def test_learning_is_measured_beside_a_plain_svm_and_learning_again():
    rows = run_bench("learning", n_objects=3, n_each=8, many=4, many_each=20)
    assert [row["name"] for row in rows] == [
        "learning 3 objects x 8 touches 120 x 120 default",
        "learning 4 objects x 20 touches 120 x 120 default",
        "adding ten touches at 50",
        "adding an object of 20 touches at 50",
        "page learning again 72 touches wall",
    ]
    assert all(row["ratio"] > 0 for row in rows)


@pytest.fixture(scope="module")
def likelihood_rows():
    return run_bench("likelihood", seconds=0.001)


def test_likelihood_has_a_row_for_every_size_and_peer(likelihood_rows):
    # Three peers, three sizes, single and batch.
    assert len(likelihood_rows) == 3 * 3 * 2
    assert len({(row["name"], row["peer"]) for row in likelihood_rows}) == len(
        likelihood_rows
    )
    assert "50 objects x 94 touches, 22 features, float32 batch 64" in {
        row["name"] for row in likelihood_rows
    }


def test_the_likelihoods_that_are_timed_are_right(likelihood_rows):
    # The classifier promises this in single precision, wherever the touch is.
    assert max(row["error_nats"] for row in likelihood_rows) < 1e-3


@pytest.mark.slow
def test_every_peer_has_a_row_and_the_true_problem_is_solved():
    rows = run_bench("mkl", seconds=0.02, large=False)
    assert "MKLpy EasyMKL" in {row["peer"] for row in rows}
    beside_svc = [row for row in rows if row["peer"] == "22 SVC fits"]
    assert beside_svc
    assert all(row["gap"] <= 1e-6 for row in beside_svc)


@pytest.mark.slow
def test_stages_and_encodings_have_rows(monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    rows = run_bench("encodings", seconds=1e-3, names=["hu", "scaled-pixels"])
    assert [row["name"] for row in rows] == [
        "640 x 480 drawn decoding",
        "640 x 480 drawn rim finding",
        "640 x 480 drawn cropping",
        "640 x 480 drawn standardising",
        "640 x 480 drawn disc of a picture hu",
        "640 x 480 drawn encoding hu",
        "640 x 480 drawn encoding scaled-pixels",
    ]
    for row in rows[5:]:
        shares = [row[f"share_{part}"] for part in ("decode", "rim", "crop", "encode")]
        # Per cent of one sum.
        assert sum(shares) == pytest.approx(100)
        crop = rows[2]["ours_ms"] + rows[3]["ours_ms"]
        assert row["touch_ms"] == pytest.approx(crop + row["ours_ms"])
    assert rows[4]["peer"] == rows[5]["peer"] == "OpenCV"
    assert (rows[6]["ratio"], rows[6]["reason"]) == (None, "no package has it")


def test_a_folder_without_pictures_is_refused(tmp_path):
    with pytest.raises(ValueError, match="32 pictures in bathtip/originals, got 0"):
        run_bench("encodings", data=tmp_path)


def test_a_small_run_has_every_row(monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
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


def test_every_benchmark_that_is_listed_is_there():
    for name, (file, _) in BENCHES.items():
        module = import_module(f"speed.{file}")
        assert callable(getattr(module, f"bench_{name.replace('-', '_')}"))


@pytest.mark.slow
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
        # The array itself was in memory; the interpreter alone takes over 10 MiB.
        assert row["peak_mib"] > row["array_mib"] + 10
        assert row["peak_mib"] >= row["peak_before_mib"]
