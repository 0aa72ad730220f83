"""One process, two workers and a Dask cluster agree; a worker that dies is survived."""

import json
import os
import signal
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from joblib import Parallel, delayed, parallel_config
from numpy.testing import assert_allclose

from palpate import Touches
from palpate._parallel import results_of
from palpate.cli import main
from palpate.library import TouchLibrary

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes; a dead one is replaced."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
    ) as started:
        yield started


@pytest.fixture
def on_cluster(cluster):
    with distributed.Client(cluster.scheduler_address) as client:
        client.wait_for_workers(2)
        with parallel_config("dask"):
            yield client


def _spectrum(touches):
    """Features that take some arithmetic, so that rounding could differ."""
    values = np.linalg.svd(touches.images.astype(float), compute_uv=False)
    return np.log1p(values)


@pytest.fixture
def library(tmp_path):
    """More touches than are encoded at once."""
    rng = np.random.default_rng(0)
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        opened.add(Touches(rng.normal(size=(2000, 12, 12)), object=["a", "b"] * 1000))
        yield opened


@pytest.mark.slow
def test_a_library_is_encoded_alike_everywhere(library, on_cluster):
    chosen = library.select()
    with parallel_config("sequential"):
        alone = chosen.features("alone", _spectrum)
    with parallel_config("loky", n_jobs=2):
        local = chosen.features("local", _spectrum)
    remote = chosen.features("remote", _spectrum)
    # The same arithmetic on the same machine: only the order of threads could differ.
    assert_allclose(local, alone, rtol=0, atol=1e-10)
    assert_allclose(remote, alone, rtol=0, atol=1e-10)


def _kinds():
    """Return touches of two categories of two objects each."""
    rng = np.random.default_rng(1)
    categories = rng.normal(size=(2, 3, 24))
    kind, one = np.repeat([0, 1], 40), np.tile(np.repeat([0, 1], 20), 2)
    images = categories[kind] + 0.5 * rng.normal(size=(80, 3, 24))
    return Touches(
        images,
        object=[f"{k}{o}" for k, o in zip(kind, one, strict=True)],
        category=kind,
        geometry="none",
    )


def _slow_square(number, folder):
    """Leave a mark with this worker's number, so that the test can kill it."""
    (folder / f"{number}.{os.getpid()}").touch()
    time.sleep(0.3)
    return number**2


@pytest.mark.slow
def test_a_worker_that_dies_is_survived(on_cluster, tmp_path):
    """SIGKILL one worker while it works: its task is done again by another."""
    run = Parallel(return_as="generator", batch_size=1)
    results = run(delayed(_slow_square)(n, tmp_path) for n in range(12))
    first = next(results)
    mine = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime)
    victim = int(mine[-1].name.split(".")[1])
    os.kill(victim, signal.SIGKILL)
    assert [first, *results] == [n**2 for n in range(12)]
    assert len({path.name.split(".")[1] for path in tmp_path.iterdir()}) >= 2


def _slow_sum(number, block, folder):
    return _slow_square(number, folder) + float(block.sum())


@pytest.mark.slow
def test_what_only_a_dead_worker_held_is_sent_again(on_cluster, tmp_path):
    """Joblib keeps an argument of more than 1 kB on one worker alone."""
    blocks = [np.full(1000, number / 1000) for number in range(12)]
    tasks = [(number, block, tmp_path) for number, block in enumerate(blocks)]
    results = results_of(_slow_sum, len(tasks), tasks.__getitem__)
    first = next(results)
    newest = max(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime)
    os.kill(int(newest.name.split(".")[1]), signal.SIGKILL)
    assert [first, *results] == pytest.approx([n**2 + n for n in range(12)])


@pytest.mark.slow
def test_the_same_study_gives_the_same_figures_everywhere(cluster, monkeypatch):
    """A small study in one process, two, and a cluster."""
    from palpate.studies import run_study
    from palpate.studies.liu2014 import Liu2014Plan

    monkeypatch.delenv("PALPATE_DATA", raising=False)
    small = {"parts": (3, 7), "n_presses": 4, "loads_kgf": (2.0,), "covers_mm": (0.9,)}
    plan = Liu2014Plan.quick(protocol="nested", **small)

    def figures(workers):
        done = run_study("liu2014", workers=workers, plan=plan, progress=False)
        return [row["ours"] for row in done["rows"]]

    with parallel_config("loky", n_jobs=1):
        one = figures(1)
    with parallel_config("loky", n_jobs=2):
        assert_allclose(figures(2), one, rtol=0, atol=1e-10)
    with distributed.Client(cluster.scheduler_address), parallel_config("dask"):
        assert_allclose(figures(-1), one, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_the_command_evaluates_alike_everywhere(cluster, tmp_path, capsys, monkeypatch):
    """`--workers` and `--cluster` lead to the same figures."""
    _kinds().save(tmp_path / "t.npz")
    given = ["--train", tmp_path / "t.npz", "--split", "unseen-objects", "--json"]
    given += ["--label", "category", "--touches", "1,3", "--orders", 2]
    places = {
        "one": ["--workers", 1],
        "two": ["--workers", 2],
        "cluster": ["--cluster", cluster.scheduler_address],
    }
    log_loss = {}
    for name, place in places.items():
        words = map(str, ["palpate", "evaluate", *given, *place])
        monkeypatch.setattr(sys, "argv", list(words))
        with suppress(SystemExit):
            main()
        log_loss[name] = json.loads(capsys.readouterr().out)["log_loss"]
    assert log_loss["two"] == pytest.approx(log_loss["one"], rel=0, abs=1e-10)
    assert log_loss["cluster"] == pytest.approx(log_loss["one"], rel=0, abs=1e-10)


@pytest.mark.slow
def test_folds_are_evaluated_alike_in_one_process_and_two():
    """Every category is left out once per fold; two processes share the folds."""
    from palpate.evaluation import Plan, evaluate

    touches = _kinds()
    plan = Plan(label="category", touches=(1, 3), orders=2)
    alone, _ = evaluate(touches, split="unseen-objects", plan=plan)
    with parallel_config("loky", n_jobs=2):
        shared, _ = evaluate(touches, split="unseen-objects", plan=plan)
    for key in ("accuracy", "log_loss", "ece"):
        for length, value in alone[key].items():
            # The same arithmetic on the same machine, one thread or several.
            assert abs(shared[key][length] - value) < 1e-10
