"""One process, two workers and a Dask cluster agree; a worker that dies is survived."""

import os
import pickle
import signal
import time
from functools import partial
from threading import Thread

import numpy as np
import pytest
from joblib import parallel_config
from numpy.testing import assert_allclose

from palpate import ObjectRecogniser, Touches, __version__, _parallel
from palpate._parallel import results_of
from palpate.classifiers import _kernel_ridge, _landmarks

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
    """Return features that take some arithmetic, so that rounding could differ."""
    values = np.linalg.svd(touches.images.astype(float), compute_uv=False)
    return np.log1p(values)


@pytest.fixture
def filled(library, rng):
    """A library of more touches than are encoded at once."""
    library.add(Touches(rng.normal(size=(2000, 12, 12)), object=["a", "b"] * 1000))
    return library


@pytest.mark.slow
def test_a_library_is_encoded_alike_everywhere(filled, on_cluster):
    chosen = filled.select()
    with parallel_config("sequential"):
        alone = chosen.features("alone", _spectrum)
    with parallel_config("loky", n_jobs=2):
        local = chosen.features("local", _spectrum)
    remote = chosen.features("remote", _spectrum)
    # The same arithmetic on the same machine: only the order of threads could differ.
    assert_allclose(local, alone, rtol=0, atol=1e-10)
    assert_allclose(remote, alone, rtol=0, atol=1e-10)


def _slow_sum(number, block, folder):
    """Leave a file named after this worker's process, so that the test can kill it."""
    (folder / f"{number}.{os.getpid()}").touch()
    time.sleep(0.3)
    return number**2 + float(block.sum())


@pytest.mark.slow
def test_tasks_of_a_dead_worker_are_done_again_whatever_they_hold(on_cluster, tmp_path):
    """A worker gets SIGKILL while it works; the scheduler holds all its tasks."""
    blocks = [np.full(1000, number / 1000) for number in range(12)]
    tasks = [(number, block, tmp_path) for number, block in enumerate(blocks)]
    results = results_of(_slow_sum, len(tasks), tasks.__getitem__)
    first = next(results)
    newest = max(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime)
    os.kill(int(newest.name.split(".")[1]), signal.SIGKILL)
    assert [first, *results] == pytest.approx([n**2 + n for n in range(12)])
    assert len({path.name.split(".")[1] for path in tmp_path.iterdir()}) >= 2


@pytest.mark.slow
def test_a_task_that_fails_raises_its_own_error(on_cluster):
    with pytest.raises(ZeroDivisionError):
        list(results_of(divmod, 3, lambda n: (1, n)))


def _dies(number):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_not_tried_for_ever(
    cluster, on_cluster, monkeypatch
):
    """Dask gives up after four dead workers, here after one."""
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)
    with pytest.raises(OSError, match="must fit into the memory of one worker"):
        list(results_of(_dies, 1, lambda n: (n,)))


def test_a_worker_with_another_palpate_is_refused():
    function = pickle.dumps(len)
    assert _parallel._unpacked(function, __version__) is len
    with pytest.raises(RuntimeError, match=r"must have palpate 0\.0\.1, got one with"):
        _parallel._unpacked(function, "0.0.1")


def _marked(folder, touches):
    (folder / f"{os.getpid()}").touch()
    time.sleep(20)
    return _spectrum(touches)


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["workers", "scheduler"])
def test_a_cluster_that_goes_away_for_good_ends_in_a_sentence(
    filled, tmp_path, monkeypatch, lost
):
    """The sentence comes within the longest absence, and nothing half done is kept."""
    monkeypatch.setattr(_parallel, "LONGEST_ABSENCE_S", 3.0)
    marks = tmp_path / "marks"
    marks.mkdir()
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "silence_logs": 50}
    with distributed.LocalCluster(1, dashboard_address=":0", **options) as short_lived:

        def leave():
            while not any(marks.iterdir()):
                time.sleep(0.05)
            short_lived.scale(0) if lost == "workers" else short_lived.close()

        with distributed.Client(short_lived.scheduler_address, timeout=2):
            leaving = Thread(target=leave)
            leaving.start()
            begun = time.monotonic()
            with (
                parallel_config("dask"),
                pytest.raises(OSError, match=r"Nothing was written\. Start it again"),
            ):
                filled.select().features("key", partial(_marked, marks))
            leaving.join()
    assert time.monotonic() - begun < 40
    assert not [*(filled.folder / "features").rglob("*.npz")]


@pytest.mark.slow
def test_the_command_learns_parquet_alike_everywhere(
    cluster, library, tmp_path, palpate, rng, monkeypatch
):
    """Of 20 objects, 60 touches a row group; there are landmarks, and many tasks."""
    pq = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(_kernel_ridge, "_MOST_TARGETS", 5000)
    monkeypatch.setattr(_landmarks, "TOUCHES_A_TASK", 100)
    monkeypatch.setattr("palpate.touches._sources._AT_ONCE", 1)
    centres = np.repeat(rng.normal(size=(20, 3, 8)), 30, axis=0)
    images = centres + 0.4 * rng.normal(size=centres.shape)
    touches = Touches(
        images, object=np.repeat([f"part {k}" for k in range(20)], 30), geometry="none"
    )
    library.add(touches)
    path = tmp_path / "set.parquet"
    library.export(path)
    pq.write_table(pq.read_table(path), path, row_group_size=60)
    options = {"one": [], "cluster": ["--cluster", cluster.scheduler_address]}
    answers = []
    for name, where in options.items():
        output = tmp_path / f"{name}.palpate"
        learnt = palpate.answer("learn", path, "-o", output, *where)
        assert learnt["n_train_touches"] == len(touches)
        answers.append(ObjectRecogniser.load(output).log_likelihood(touches[::20]))
    # The same arithmetic in the same blocks, added in the same order.
    assert_allclose(answers[1], answers[0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_the_same_study_gives_the_same_figures_everywhere(cluster, monkeypatch):
    """A small study runs in one process, in two, and on a cluster."""
    from palpate.studies import run_study
    from palpate.studies.liu2014 import Liu2014Plan

    monkeypatch.delenv("PALPATE_DATA", raising=False)
    small = {"parts": (3, 7), "n_presses": 4, "loads_kgf": (2.0,), "covers_mm": (0.9,)}
    plan = Liu2014Plan.quick(protocol="nested", **small)

    def figures(workers):
        study = run_study("liu2014", workers=workers, plan=plan, progress=False)
        return [row["ours"] for row in study["rows"]]

    with parallel_config("loky", n_jobs=1):
        expected = figures(1)
    with parallel_config("loky", n_jobs=2):
        assert_allclose(figures(2), expected, rtol=0, atol=1e-10)
    with distributed.Client(cluster.scheduler_address), parallel_config("dask"):
        assert_allclose(figures(-1), expected, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_the_command_evaluates_alike_everywhere(cluster, tmp_path, palpate, rng):
    """Of two categories of two objects each, processes share the folds."""
    kind, number = np.repeat([0, 1], 40), np.tile(np.repeat([0, 1], 20), 2)
    images = rng.normal(size=(2, 3, 24))[kind] + 0.5 * rng.normal(size=(80, 3, 24))
    objects = [f"{k}{o}" for k, o in zip(kind, number, strict=True)]
    touches = Touches(images, object=objects, category=kind, geometry="none")
    touches.save(tmp_path / "t.npz")
    arguments = ["--train", tmp_path / "t.npz", "--split", "unseen-objects"]
    arguments += ["--label", "category", "--touches", "1,3", "--orders", 2]
    one, two = ("--workers", 1), ("--workers", 2)
    expected, *answers = (
        palpate.answer("evaluate", *arguments, *where)
        for where in (one, two, ("--cluster", cluster.scheduler_address))
    )
    for answer in answers:
        for key in ("accuracy", "log_loss", "ece"):
            # The same arithmetic on the same machine, one thread or several.
            assert answer[key] == pytest.approx(expected[key], rel=0, abs=1e-10)
