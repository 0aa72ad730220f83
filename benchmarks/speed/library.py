"""Kernel densities per touch, and a library of touches as it grows.

Densities stand beside a bare matrix product and two float64 peers. The product is the
floor: any exact density has to multiply the new touches by all stored ones.
scikit-learn's trees return wrong densities in this many dimensions, so its
`KernelDensity` gets one leaf that holds everything.

Of a library: adding, opening, reading, bytes, and likelihoods. Features are those of
real touches of the dome camera (the folder PALPATE_DATA names), drawn with replacement
per object, with normal noise of 0.3 times each object's standard deviation per feature;
without the folder, features of random places. The touches recognised are real ones that
were held out. Resampled touches crowd about the few that were really made, which
flatters an index: the share of equal decisions says how it does here, not on a million
touches that are all different. The library itself holds small images (10 x 10 uint8)
drawn at random.
"""

import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from sklearn.decomposition import PCA
from sklearn.neighbors import KernelDensity

from palpate._types import Array, Floats
from palpate.classifiers import KernelDensityBayes, KernelDensityIndex
from palpate.encodings import ZernikeMoments
from palpate.images import DomeCrop
from palpate.library import TouchLibrary
from palpate.touches import Touches

from . import Row, cpu_ms, one_thread, real_touches, row, wall_ms

SHAPES = ((10, 60), (50, 24), (50, 94))  # objects, touches of each
BATCHES = (1, 64)  # touches asked at once

Measure = Callable[[Floats], Floats]
SIZES = (10_000, 100_000)  # touches in a library
LARGE = (1_000_000,)  # the same, which takes minutes
N_OBJECTS = 50  # as the BathTip's recordings
N_TESTED = 192  # of its held-out touches, three batches
NOISE = 0.3  # of a feature's deviation, on touches drawn again
WIDTHS = (22, 71)  # features: few, and Zernike moments of a disc
_PRODUCT = "float32 matrix product"
_AT_ONCE = 50_000  # touches drawn at a time
_NO_PEER = "nothing to compare with"
_ADDED_SINGLY, _STREAMED, _CALLERS = 50, 1000, 32  # touches; and threads that add
# Actions on a library that was just opened.
_ACTIONS: dict[str, Callable[[TouchLibrary], object]] = {
    "opened": lambda library: None,
    "opened, 50 listed": lambda library: library.list(limit=50),
    "opened, filtered by force": lambda library: library.list("force_n > 0.9999"),
    "opened, counted by two columns": lambda library: library.count(
        'force_n > 0.5 and session = "day 1"'
    ),
    "opened, objects counted": lambda library: library.objects(),
    "opened, selected": lambda library: library.select(),
    "opened, 10,000 read": lambda library: library.touches("order < 10000"),
}


def bench_likelihood(
    *, n_features: int = 22, seconds: float = 0.3, random_state: int = 0
) -> list[Row]:
    """Time log-likelihoods per touch; `error_nats` is our largest from float64."""
    rng = np.random.default_rng(random_state)
    rows = []
    with one_thread():
        for n_objects, n_each in SHAPES:
            labels = np.repeat(np.arange(n_objects), n_each)
            centres = rng.normal(size=(n_objects, n_features))
            stored = centres[labels] + rng.normal(size=(len(labels), n_features))
            size = f"{n_objects} objects x {n_each} touches, {n_features} features"
            model = KernelDensityBayes(precision="single").fit(stored, labels)
            peers = _peers(stored, labels)
            for n_touches in BATCHES:
                new = rng.normal(size=(n_touches, n_features))
                mode = "single" if n_touches == 1 else f"batch {n_touches}"
                name = f"{size}, float32 {mode}"
                reference = peers["scipy cdist + logsumexp, float64"](new)
                error = float(np.abs(model.log_likelihood(new) - reference).max())
                ours = cpu_ms(partial(model.log_likelihood, new), seconds) / n_touches
                for peer, measure in peers.items():
                    ms = cpu_ms(partial(measure, new), seconds) / n_touches
                    rows.append(row(name, ours, peer, ms, error_nats=error))
    return rows


def _peers(stored: Floats, labels: Array) -> dict[str, Measure]:
    """Return the peers that are measured beside ours; preparation is free."""
    columns = np.ascontiguousarray(stored.T, dtype=np.float32)
    deviations = stored.std(axis=0, ddof=1)
    whitened = stored / deviations
    parts = np.split(whitened, np.flatnonzero(np.diff(labels)) + 1)
    trees = [KernelDensity(leaf_size=len(part)).fit(part) for part in parts]
    log_volume = np.log(deviations).sum()
    gaussian = log_volume + stored.shape[1] * np.log(2 * np.pi) / 2

    def one_leaf(new: Floats) -> Floats:
        x = new / deviations
        scores = [tree.score_samples(x) for tree in trees]
        return np.asarray(np.stack(scores, axis=1) - log_volume)

    def written_out(new: Floats) -> Floats:
        x = new / deviations
        sums = [logsumexp(cdist(x, p, "sqeuclidean") / -2, axis=1) for p in parts]
        counts = [len(part) for part in parts]
        return np.asarray(np.stack(sums, axis=1) - np.log(counts) - gaussian)

    return {
        _PRODUCT: lambda new: np.asarray(new.astype(np.float32) @ columns),
        "scipy cdist + logsumexp, float64": written_out,
        "scikit-learn KernelDensity leaf_size=n": one_leaf,
    }


def bench_library(
    sizes: tuple[int, ...] = SIZES, *, seconds: float = 0.5, random_state: int = 0
) -> list[Row]:
    """Measure libraries of `sizes` touches, and exact and indexed likelihoods."""
    real = _real_features()
    kind = "random" if real is None else "resampled real"
    rows: list[Row] = []
    with one_thread():
        for size in sizes:
            with tempfile.TemporaryDirectory() as folder:
                rows += _store_rows(Path(folder), size, random_state)
            for n_features in WIDTHS:
                stored, labels, new = _features(real, size, n_features, random_state)
                name = f"{size:,} {kind} touches of {n_features} features"
                rows += _likelihood_rows(name, stored, labels, new, seconds)
    return rows


def bench_library_large(*, seconds: float = 0.5, random_state: int = 0) -> list[Row]:
    """Measure at 10^6 touches; takes about ten minutes and 3 GB."""
    return bench_library(LARGE, seconds=seconds, random_state=random_state)


def _store_rows(folder: Path, size: int, seed: int) -> list[Row]:
    """Add, open, list and count; times are of the wall, as disks take them."""
    with TouchLibrary.open(folder / "library", create=True) as library:
        rows = _adding_rows(library, partial(_save_bare, folder), size, seed)
    for name, action in _ACTIONS.items():

        def opened(action: Callable[[TouchLibrary], object] = action) -> None:
            with TouchLibrary.open(folder / "library") as library:
                action(library)

        title = f"{size:,} touches {name} (wall)"
        rows.append(row(title, wall_ms(opened), reason=_NO_PEER))
    return rows


def _adding_rows(
    library: TouchLibrary, bare: Callable[[], object], size: int, seed: int
) -> list[Row]:
    """Add `size` touches, some singly, some from several callers; `bare` is a file."""

    def add_all() -> None:
        for first in range(0, size, _AT_ONCE):
            library.add(_touches(first, min(_AT_ONCE, size - first), seed))

    added_ms, stats = wall_ms(add_all) / size, library.stats()
    single = _touches(size, _ADDED_SINGLY, seed + 1)
    stream = list(_touches(size + _ADDED_SINGLY, _STREAMED, seed + 1))
    # In turn: flushes take now more, now less.
    pairs = [(wall_ms(partial(library.add, t)), wall_ms(bare)) for t in single]
    single_ms, bare_ms = np.median(pairs, axis=0).tolist()
    with ThreadPoolExecutor(_CALLERS) as pool:
        all_ms = wall_ms(lambda: list(pool.map(library.add, stream)))
    added: dict[str, Any] = {
        "touches_per_s": 1e3 / added_ms,
        "bytes_per_touch": (stats.database_bytes - size * 100) / size,
    }
    streamed: dict[str, Any] = {"touches_per_s": 1e3 * _STREAMED / all_ms}
    by_callers = f"touches streamed to {size:,} by {_CALLERS} callers (wall)"
    compared = partial(row, peer="numpy.save + fsync", peer_ms=bare_ms)
    return [
        compared(f"{size:,} touches added, per touch (wall)", added_ms, **added),
        compared(f"one touch added to {size:,} (wall)", single_ms),
        compared(by_callers, all_ms / _STREAMED, **streamed),
    ]


def bench_library_sizes(
    data: str | Path | None = None, *, n_touches: int = 200
) -> list[Row]:
    """Measure what recorded touches take on the disk, beside the files they came in.

    Pictures of a camera, presses of an array and frames of a gel; one touch alone, and
    all of them read. Times are of the CPU.
    """
    folder = real_touches(data)
    if folder is None:
        none = float("nan")
        return [row("recorded touches", none, reason="PALPATE_DATA names no folder")]
    sets = {
        "JPEGs of a dome, 640 x 480": folder / "bathtip" / "originals",
        "dome, 120 x 120 uint8": folder / "bathtip" / "bathtip50.npz",
        "array, 10 x 10 float64": folder / "taxel10x10" / "taxel10x10.npz",
        "gel, 160 x 120 x 3 uint8": folder / "sessions" / "digit_survey.npz",
    }
    with one_thread():
        return [_sizes_row(name, path, n_touches) for name, path in sets.items()]


def _sizes_row(name: str, path: Path, n_touches: int) -> Row:
    if path.is_dir():
        pattern = r"_name_(?P<object>[a-z]+_\w+?)_at_"
        empty = path / "baselineForCalibration.jpg"
        touches = Touches.load(path, name_pattern=pattern, no_contact=empty)[:n_touches]
    else:
        touches = Touches.load(path)[:n_touches]
    files = touches.files
    n_bytes = touches.images.nbytes if files is None else sum(map(len, files))
    with tempfile.TemporaryDirectory() as scratch:
        with TouchLibrary.open(scratch, create=True) as library:
            added = time.process_time()
            library.add(touches)
            added = time.process_time() - added
        with TouchLibrary.open(scratch) as library:  # nothing is left in its log
            read = time.process_time()
            library.touches()
            read = time.process_time() - read
            held = library.stats().database_bytes
    return row(
        f"{name}: {len(touches)} read, per touch",
        1e3 * read / len(touches),
        reason=_NO_PEER,
        added_ms=1e3 * added / len(touches),
        bytes_per_touch=held / len(touches),
        share_of_given=held / n_bytes,
    )


def _save_bare(folder: Path) -> None:
    """Write one durable file and nothing else."""
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        np.save(file, np.zeros((10, 10), np.uint8))
        file.flush()
        os.fsync(file.fileno())


def _touches(first: int, count: int, seed: int) -> Touches:
    rng = np.random.default_rng((seed, first))
    number = first + np.arange(count)
    return Touches(
        rng.integers(0, 256, (count, 10, 10), dtype=np.uint8),
        object=np.char.add("object ", (number % N_OBJECTS).astype(str)),
        session=np.char.add("day ", (number // 5000).astype(str)),
        episode=np.char.add("visit ", (number // 500).astype(str)),
        order=number,
        force_n=rng.random(count),
        position_mm=rng.normal(size=(count, 3)).astype(np.float32),
    )


def _likelihood_rows(
    name: str, stored: Floats, labels: Array, new: Floats, seconds: float
) -> list[Row]:
    model = KernelDensityBayes().fit(stored, labels)
    batches = {"single": new[:1], "batch 64": new[:64]}

    def each_ms(ask: Callable[[Floats], object]) -> dict[str, float]:
        return {
            mode: cpu_ms(partial(ask, batch), seconds) / len(batch)
            for mode, batch in batches.items()
        }

    columns = np.ascontiguousarray(model.points_.T, dtype=np.float32)
    exact = each_ms(model.log_likelihood)
    product = each_ms(lambda new: new[:, : len(columns)].astype(np.float32) @ columns)
    size = {"megabytes": (model.points_.nbytes + model.tiles_.nbytes) / 2**20}
    rows = [
        row(f"{name}, exact {mode}", ms, _PRODUCT, product[mode], **size)
        for mode, ms in exact.items()
    ]
    started = time.process_time()
    try:
        index = KernelDensityIndex(model)
    except ImportError as error:
        none = float("nan")
        return [*rows, row(f"{name}, index", none, "exact", reason=str(error))]
    facts = {
        "build_s": time.process_time() - started,
        "megabytes": (index.weights_.nbytes + index.packed_.nbytes) / 2**20,
        **index.quality(new)._asdict(),
    }
    for mode, ms in each_ms(index.log_likelihood).items():
        rows.append(row(f"{name}, index {mode}", ms, "exact", exact[mode], **facts))
    return rows


def _real_features() -> tuple[Floats, Array] | None:
    """Return Zernike magnitudes and objects of half the real touches, or None."""
    path = (real_touches(None) or Path()) / "bathtip" / "bathtip50.npz"
    if not path.is_file():
        return None
    touches = Touches.load(path)[::2]
    discs = DomeCrop().fit(touches.images, no_contact=touches.no_contact)
    images = discs.transform(touches.images)
    moments = ZernikeMoments(order=15, drop_constant=True).fit_transform(images)
    return moments, np.unique(np.asarray(touches.object), return_inverse=True)[1]


def _features(
    real: tuple[Floats, Array] | None, size: int, n_features: int, seed: int
) -> tuple[Floats, Array, Floats]:
    """Return stored features, their objects, and features of held-out touches."""
    rng = np.random.default_rng(seed)
    if real is None:
        objects = np.repeat(np.arange(N_OBJECTS), 40)
        centres = rng.normal(size=(N_OBJECTS, max(WIDTHS)))
        values = centres[objects] + rng.normal(size=(len(objects), max(WIDTHS)))
    else:
        values, objects = real
    if n_features < values.shape[1]:
        values = PCA(n_features, random_state=0).fit_transform(values)
    held_out = np.arange(len(values)) % 10 == seed % 10
    learnt, of_learnt = values[~held_out], objects[~held_out]
    labels = np.repeat(np.arange(N_OBJECTS), size // N_OBJECTS)
    stored = np.empty((len(labels), values.shape[1]))
    for place in range(N_OBJECTS):
        of_object = learnt[of_learnt == place]
        rows = labels == place
        drawn = of_object[rng.integers(0, len(of_object), int(rows.sum()))]
        noise = NOISE * of_object.std(axis=0) * rng.normal(size=drawn.shape)
        stored[rows] = drawn + noise
    return stored, labels, values[held_out][:N_TESTED]
