"""How time and memory grow with touches, objects and pixels: `growth.py [--quick]`.

    python benchmarks/growth.py                # measures, writes growth.json, draws
    python benchmarks/growth.py --picture DIR  # draws what was measured
    python benchmarks/growth.py --shop [N]     # N of the rows of very many, into it
    python benchmarks/growth.py --spread       # two workers beside one process, into it

Of very many objects, each has two faces, a recorded touch and noise of its own each;
half of the touches met are of either. Asked are 1,000 touches of them, beside a
nearest-mean classifier of scaled features; one object more is learnt and one forgotten,
and the model is written and read.

What is spread over a cluster is encoding pictures of 120 x 120 from Parquet, and the
sums of 2,000 landmarks: in this process, then by two Dask workers of one thread, which
keep the memory that they have (docs/howto/machines.md), in turn. By the clock that
takes two idle cores; CPU time of the busier worker says what they would take there.

Each size is learnt in a process of its own, on one thread, until one takes longer than
`LONGEST_S` of CPU time. Objects and touches are those of `default` on vectors of 71
features: features of recorded touches of a dome (drawn vectors without PALPATE_DATA),
drawn again with a tenth of their spread as noise. Pixels are whole drawn domes.
Memory is read from Linux's /proc. Exponents are slopes of log time over log size,
fitted to the larger half of the sizes up to `KERNELS`, beyond which `default` learns
through landmarks.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "growth.json"
N_FEATURES, LONGEST_S, N_ASKED, N_ROUNDS = 71, 240, 20, 2
KERNELS = 10_000
# Without these, Dask workers give memory back to the system at every step.
KEEP_MEMORY = {
    "MALLOC_TRIM_THRESHOLD_": "134217728",
    "MALLOC_MMAP_THRESHOLD_": "67108864",
}
# Objects and touches of each, of a shop and of a fleet.
SHOP = [(10_000, 5), (10_000, 20), (100, 10_000)]
FIGURES = {
    "learning_s": "learning (s of CPU)",
    "memory_mb": "memory of learning (MB)",
    "belief_ms": "a touch to its belief (ms)",
}
# What grows: sizes, and (objects, touches of each, pixels) of a size.
WAYS: dict[str, tuple[list[int], Any]] = {
    "touches": (
        [250, 500, 1000, 2000, 4000, 8000, 16000, 32000],
        lambda n: (10, n // 10, 0),
    ),
    "objects": ([10, 30, 100, 300, 1000, 3000, 10000], lambda n: (n, 4, 0)),
    "pixels": ([60, 120, 240, 480], lambda n: (10, 20, n)),
}


def main() -> None:
    """Measure every size, or one of them in this process, or draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the three smallest sizes")
    parser.add_argument("--picture", type=Path, metavar="FOLDER")
    parser.add_argument("--one", nargs=3, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--shop", nargs="?", type=int, const=len(SHOP))
    parser.add_argument("--spread", action="store_true")
    parser.add_argument("--one-shop", nargs=2, type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one_shop:
        print(json.dumps(shop(*options.one_shop)))
        return
    if options.shop:
        keep("shop", [in_a_process("--one-shop", s) for s in SHOP[: options.shop]])
        return
    if options.spread:
        keep("spread", spread())
        return
    if options.one:
        print(json.dumps(learnt(*options.one)))
        return
    if not options.picture:
        rows = {way: measured(way, 3 if options.quick else None) for way in WAYS}
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    draw(options.picture or HERE.parent / "docs" / "images")


def keep(name: str, rows: list[dict[str, Any]]) -> None:
    """Write rows beside those that were measured before."""
    before = json.loads(RESULTS.read_text(encoding="utf-8"))
    text = json.dumps(before | {name: {"rows": rows}}, indent=1) + "\n"
    RESULTS.write_text(text, encoding="utf-8")


def measured(way: str, most: int | None) -> dict[str, Any]:
    """Learn each size of one way in turn, and fit how cost grows."""
    sizes, of_size = WAYS[way]
    rows: list[dict[str, Any]] = []
    for size in sizes[:most]:
        rows.append({"size": size, **in_a_process("--one", of_size(size))})
        if "refused" in rows[-1] or rows[-1]["learning_s"] > LONGEST_S:
            break
    return {"rows": rows}


def in_a_process(option: str, size: Sequence[int]) -> dict[str, Any]:
    """Return the row that a process of its own measures, or how it was `refused`."""
    command = [sys.executable, __file__, option, *map(str, size)]
    environment = os.environ | dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
    )
    completed = subprocess.run(command, capture_output=True, text=True, env=environment)
    row = {"refused": (completed.stderr.strip().splitlines() or ["killed"])[-1]}
    if not completed.returncode:
        row = json.loads(completed.stdout)
    print(option, size, row, flush=True)
    return row


def exponent(rows: list[dict[str, Any]], key: str) -> float:
    """Return how a figure grows with the size, fitted to the larger sizes."""
    fitted = [row for row in rows if row["size"] <= KERNELS]
    half = fitted[-max(3, -(-len(fitted) // 2)) :]
    at, figures = ([row[name] for row in half] for name in ("size", key))
    return float(np.polyfit(np.log(at), np.log(figures), 1)[0])


def learnt(n_objects: int, n_each: int, side: int) -> dict[str, float]:
    """Learn one size; return CPU times, and memory beside the touches."""
    from palpate.recognition import ObjectRecogniser

    touches = pictures(n_objects, n_each, side) if side else vectors(n_objects, n_each)
    recogniser = ObjectRecogniser()
    recogniser.max_memory_gb = 16.0
    # From here on the kernel counts the peak of this process anew.
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak_mb()
    cpu = time.process_time()
    recogniser.fit(touches)
    learning_s = time.process_time() - cpu
    tested = [
        touches[[k]] for k in range(0, len(touches), max(1, len(touches) // N_ASKED))
    ]
    belief = recogniser.start()
    cpu = time.process_time()
    for touch in tested:
        belief.update(touch)
        belief.decide()
    return {
        "learning_s": learning_s,
        "memory_mb": max(_peak_mb() - before, 1.0),
        "belief_ms": 1e3 * (time.process_time() - cpu) / len(tested),
    }


def shop(n_objects: int, n_each: int) -> dict[str, float]:
    """Learn very many touches; return CPU times, memory, and shares right."""
    from palpate.recognition import ObjectRecogniser

    touches, tested = with_faces(n_objects, n_each)
    recogniser, clock = ObjectRecogniser(), time.process_time
    Path("/proc/self/clear_refs").write_text("5")
    before, begun = _peak_mb(), clock()
    recogniser.fit(touches)
    row = {"objects": n_objects, "each": n_each, "learning_s": clock() - begun}
    row["memory_mb"] = _peak_mb() - before
    belief, begun = recogniser.start(), clock()
    for k in range(N_ASKED):
        belief.update(tested[[k]])
        belief.decide()
    row["belief_ms"] = 1e3 * (clock() - begun) / N_ASKED
    row["right"] = float((recogniser.predict(tested) == tested.object).mean())
    row["nearest_mean"] = right_by_means(touches, tested)
    begun = clock()
    recogniser.add_object("one more", tested[:n_each])
    row["adding_s"], begun = clock() - begun, clock()
    recogniser.forget_object("one more")
    row["forgetting_s"] = clock() - begun
    with TemporaryDirectory() as folder:
        path = recogniser.save(Path(folder) / "shop.palpate")
        row["file_mb"], begun = path.stat().st_size / 1e6, clock()
        ObjectRecogniser.load(path)
        row["loading_s"] = clock() - begun
    return row


def spread() -> list[dict[str, Any]]:
    """Measure the spread parts in this process and by two workers; return rows."""
    from distributed import Client, LocalCluster
    from joblib import parallel_config

    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": ":0"}
    os.environ.update(KEEP_MEMORY)
    rows = []
    with (
        TemporaryDirectory() as folder,
        LocalCluster(2, **options) as cluster,
        Client(cluster) as client,
    ):
        for name, work in spread_parts(Path(folder)).items():
            with parallel_config("dask"):
                work()  # workers import what they need
            for _ in range(N_ROUNDS):
                with parallel_config("sequential"):
                    wall, cpu = timed(work)
                before = client.run(time.process_time)
                with parallel_config("dask"):
                    wall_spread, _ = timed(work)
                after = client.run(time.process_time)
                busy = [after[worker] - before[worker] for worker in after]
                row = {"part": name, "one_s": wall, "one_cpu_s": cpu}
                row |= {"two_s": wall_spread, "two_cpu_s": sorted(busy)}
                rows.append(row)
                print(row, flush=True)
    return rows


def spread_parts(folder: Path) -> dict[str, Any]:
    """Return the parts that are spread, by name, as functions."""
    from palpate.classifiers._landmarks import LandmarkRegression, Landmarks
    from palpate.library import TouchLibrary
    from palpate.recognition import ObjectRecogniser, _learning
    from palpate.touches import ParquetTouches

    touches = pictures(20, 100, 120)
    with TouchLibrary.open(folder / "library", create=True) as library:
        library.add(touches)
        library.export(folder / "touches.parquet")
    source = ParquetTouches(folder / "touches.parquet")
    few = touches[:: len(touches) // 200]
    learnt = ObjectRecogniser().fit(few).learnt()
    vectors = np.random.default_rng(0).normal(size=(60_000, N_FEATURES))
    codes = np.arange(len(vectors)) % 10
    marks = vectors[:: len(vectors) // 2000]
    landmarks = Landmarks(marks, (marks**2).sum(axis=1), 0.5 / (2 * N_FEATURES))
    how = landmarks, np.zeros(N_FEATURES), 0.03
    taught = vectors, codes, np.arange(10)
    return {
        "encoding": lambda: _learning.encoded(learnt.encoder, learnt.contact, source),
        "sums": lambda: LandmarkRegression(*how).learn(taught),
    }


def timed(work: Any) -> tuple[float, float]:
    """Return seconds by the clock and of CPU of this process."""
    from palpate._parallel import on_one_thread

    begun, cpu = time.perf_counter(), time.process_time()
    with on_one_thread():
        work()
    return time.perf_counter() - begun, time.process_time() - cpu


def with_faces(n_objects: int, n_each: int) -> tuple[Any, Any]:
    """Draw touches of objects of two faces to learn, and 1,000 to ask about."""
    from palpate import Touches

    rng = np.random.default_rng(0)
    recorded = recorded_features(rng)
    spread = recorded.std(axis=0)
    faces = recorded[rng.integers(len(recorded), size=(n_objects, 2))]
    faces = faces + 0.3 * spread * rng.normal(size=faces.shape)

    def met(objects: Any) -> Any:
        drawn = faces[objects, rng.integers(2, size=len(objects))]
        drawn = drawn + 0.4 * spread * rng.normal(size=drawn.shape)
        names = np.array([f"object {k:05d}" for k in objects])
        return Touches(drawn[:, np.newaxis], object=names, geometry="none")

    objects = np.repeat(np.arange(n_objects), n_each)
    return met(objects), met(rng.integers(n_objects, size=1000))


def right_by_means(touches: Any, tested: Any) -> float:
    """Return the share right of the nearest mean of scaled features."""
    from sklearn.neighbors import NearestCentroid
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    means = make_pipeline(StandardScaler(), NearestCentroid())
    means.fit(touches.images[:, 0], touches.object)
    return float(means.score(tested.images[:, 0], tested.object))


def vectors(n_objects: int, n_each: int) -> Any:
    """Draw touches from features of recorded ones, objects about some of them."""
    from palpate import Touches

    rng = np.random.default_rng(0)
    recorded = recorded_features(rng)
    spread = recorded.std(axis=0)
    centres = recorded[rng.integers(len(recorded), size=n_objects)]
    centres = centres + 0.3 * spread * rng.normal(size=centres.shape)
    drawn = np.repeat(centres, n_each, axis=0)
    drawn += 0.1 * spread * rng.normal(size=drawn.shape)
    names = np.repeat([f"object {k:05d}" for k in range(n_objects)], n_each)
    return Touches(drawn[:, np.newaxis], object=names, geometry="none")


def recorded_features(rng: np.random.Generator) -> Any:
    """Return `N_FEATURES` principal components of recorded discs, or drawn vectors."""
    from sklearn.decomposition import PCA

    from palpate import Touches
    from palpate.images import DomeCrop

    file = Path(os.environ.get("PALPATE_DATA", "")) / "bathtip" / "bathtip50.npz"
    if not file.exists():
        return rng.normal(size=(500, N_FEATURES))
    touches = Touches.load(file)
    discs = DomeCrop(size=48).fit_transform(touches.images[::8])
    return PCA(N_FEATURES).fit_transform(discs.reshape(len(discs), -1))


def pictures(n_objects: int, n_each: int, side: int) -> Any:
    """Draw discs of objects with dents of their own, `side` pixels."""
    from paired import drawn
    from palpate import Touches

    images, objects = drawn(n_objects, n_each, (side, side), seed=0)
    return Touches(images, object=objects, geometry="dome")


def _peak_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if "VmHWM" in line) / 1024


def draw(folder: Path) -> None:
    """Write growth.png: time of learning, memory and time of a belief over size."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    plt.style.use(str(HERE.parent / "docs" / "palpate.mplstyle"))
    kept = json.loads(RESULTS.read_text(encoding="utf-8"))
    kept = {way: kept[way] for way in WAYS}
    figure, axes = plt.subplots(1, 3, figsize=(10.8, 3.6), layout="constrained")
    for axis, (key, label) in zip(axes, FIGURES.items(), strict=True):
        for (way, result), marker in zip(kept.items(), "os^", strict=True):
            rows = [row for row in result["rows"] if "refused" not in row]
            power = exponent(rows, key)
            print(f"{label}, {way}: {power:.2f}")
            axis.plot(
                [row["size"] for row in rows],
                [row[key] for row in rows],
                marker=marker,
                label=f"{way}: size^{power:.1f}",
            )
        axis.set(xscale="log", yscale="log", xlabel="size", title=label)
        low, high = axis.get_ylim()
        axis.set_ylim(low, high * (high / low) ** 0.4)  # the legend's place
        axis.legend(fontsize="small", loc="upper left")
    figure.savefig(folder / "growth.png", dpi=120)


if __name__ == "__main__":
    main()
