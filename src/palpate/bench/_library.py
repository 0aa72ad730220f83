"""A library of touches as it grows: adding, opening, bytes, and likelihoods.

Features are those of real touches of the dome camera (the folder PALPATE_DATA names),
drawn with replacement per object, with normal noise of 0.3 times each object's
standard deviation per feature; without the folder, features of random places. The
touches recognised are real ones that were held out. Resampled touches crowd about the
few that were really made, which flatters an index: the share of equal decisions says
how it does here, not on a million touches that are all different.

The library itself holds small images (10 x 10 uint8) drawn at random.
"""

import os
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..classifiers import KernelDensityBayes, KernelDensityIndex
from ..library import TouchLibrary
from ..touches import Touches
from ._timing import cpu_ms, one_thread, row

SIZES = (10_000, 100_000)
LARGE = (1_000_000,)
N_OBJECTS = 50
N_TESTED = 192
NOISE = 0.3
WIDTHS = (22, 71)
_AT_ONCE = 50_000
_ADDED_SINGLY = 20

Rows = list[dict[str, object]]


def bench_library(
    sizes: tuple[int, ...] = SIZES, *, seconds: float = 0.5, random_state: int = 0
) -> Rows:
    """Measure a library and exact and indexed likelihoods at several sizes.

    Parameters
    ----------
    sizes : tuple of int, default=(10_000, 100_000)
        Touches in the library, over 50 objects.
    seconds : float, default=0.5
        CPU time to spend on each figure of a millisecond.
    random_state : int, default=0

    Returns
    -------
    list of dict
        Rows with `name`, `ours_ms`, `peer`, `peer_ms`, `ratio`, and per kind of row
        `touches_per_s`, `bytes_per_touch`, `megabytes`, `build_s`,
        `equal_decisions`, `error_nats`.
    """
    real = _real_features()
    kind = "random" if real is None else "resampled real"
    rows: Rows = []
    with one_thread():
        for size in sizes:
            with tempfile.TemporaryDirectory() as folder:
                rows += _store_rows(Path(folder), size, random_state)
            for n_features in WIDTHS:
                stored, labels, new = _features(real, size, n_features, random_state)
                name = f"{size:,} {kind} touches of {n_features} features"
                rows += _likelihood_rows(name, stored, labels, new, seconds)
    return rows


def bench_library_large(*, seconds: float = 0.5, random_state: int = 0) -> Rows:
    """Measure at 10^6 touches; takes about ten minutes and 3 GB."""
    return bench_library(LARGE, seconds=seconds, random_state=random_state)


def _store_rows(folder: Path, size: int, seed: int) -> Rows:
    """Add, open, list and count; times are of the wall, as disks take them."""
    started = time.perf_counter()
    with TouchLibrary.open(folder / "library", create=True) as library:
        for first in range(0, size, _AT_ONCE):
            library.add(_touches(first, min(_AT_ONCE, size - first), seed))
        added_s = time.perf_counter() - started
        stats = library.stats()
        raw = size * 100
        single = _touches(size, _ADDED_SINGLY, seed + 1)
        started = time.perf_counter()
        for touch in single:
            library.add(touch)
        single_ms = (time.perf_counter() - started) * 1e3 / _ADDED_SINGLY
    bare_ms = _bare_ms(folder, single)
    peer = "numpy.save + fsync"
    size_bytes = (stats.database_bytes + stats.image_bytes - raw) / size
    rows = [
        row(
            f"{size:,} touches added, per touch (wall)",
            added_s * 1e3 / size,
            peer,
            bare_ms,
            touches_per_s=size / added_s,
            bytes_per_touch=size_bytes,
        ),
        row(f"one touch added to {size:,} (wall)", single_ms, peer, bare_ms),
    ]
    no_peer = {"peer": "", "peer_ms": None, "reason": "nothing to compare with"}
    actions = {
        "opened": lambda one: None,
        "opened, 50 listed": lambda one: one.list(limit=50),
        "opened, filtered by force": lambda one: one.list("force_n > 0.9999"),
        "opened, objects counted": lambda one: one.objects(),
    }
    for name, action in actions.items():
        started = time.perf_counter()
        with TouchLibrary.open(folder / "library") as library:
            action(library)
        taken = (time.perf_counter() - started) * 1e3
        rows.append(row(f"{size:,} touches {name} (wall)", taken, **no_peer))  # type: ignore[arg-type]
    return rows


def _bare_ms(folder: Path, touches: Touches) -> float:
    """Return what one durable file alone costs, in ms of the wall."""
    started = time.perf_counter()
    for number, image in enumerate(touches.images):
        with (folder / f"{number}.npy").open("wb") as file:
            np.save(file, image)
            file.flush()
            os.fsync(file.fileno())
    return (time.perf_counter() - started) * 1e3 / len(touches)


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
    name: str, stored: NDArray, labels: NDArray, new: NDArray, seconds: float
) -> Rows:
    """Time the exact sums, then the index beside them."""
    model = KernelDensityBayes().fit(stored, labels)
    megabytes = (model.points_.nbytes + model.tiles_.nbytes) / 2**20
    exact, rows = {}, []
    for batch in (1, 64):
        mode = "single" if batch == 1 else f"batch {batch}"
        ask = partial(model.log_likelihood, new[:batch])
        exact[mode] = cpu_ms(ask, seconds) / batch
        rows.append(
            row(
                f"{name}, exact {mode}",
                exact[mode],
                "float32 matrix product",
                cpu_ms(_product(model, new[:batch]), seconds) / batch,
                megabytes=megabytes,
            )
        )
    started = time.process_time()
    try:
        index = KernelDensityIndex(model)
    except ImportError as error:
        reason = {"reason": str(error)}
        return [*rows, row(f"{name}, index", float("nan"), "exact", None, **reason)]
    build_s = time.process_time() - started
    quality = index.quality(new)
    for batch, mode in ((1, "single"), (64, "batch 64")):
        ask = partial(index.log_likelihood, new[:batch])
        rows.append(
            row(
                f"{name}, index {mode}",
                cpu_ms(ask, seconds) / batch,
                "exact",
                exact[mode],
                build_s=build_s,
                megabytes=(index.weights_.nbytes + index.packed_.nbytes) / 2**20,
                equal_decisions=quality.equal_decisions,
                error_of_best_nats=quality.error_of_best_nats,
                error_nats=quality.error_nats,
                error_of_posterior=quality.error_of_posterior,
            )
        )
    return rows


def _product(model: KernelDensityBayes, new: NDArray) -> partial[NDArray]:
    columns = np.ascontiguousarray(model.points_.T, dtype=np.float32)
    return partial(np.matmul, new[:, : len(columns)].astype(np.float32), columns)


def _real_features() -> tuple[NDArray, NDArray] | None:
    """Return Zernike magnitudes and objects of half the real touches, or None."""
    from ..encodings import ZernikeMoments
    from ..images import DomeCrop

    path = Path(os.environ.get("PALPATE_DATA", "")) / "bathtip" / "bathtip50.npz"
    if not path.is_file():
        return None
    touches = Touches.load(path)[::2]
    discs = DomeCrop().fit(touches.images, no_contact=touches.no_contact)
    images = discs.transform(touches.images)
    moments = ZernikeMoments(order=15, drop_constant=True).fit_transform(images)
    assert touches.object is not None
    return moments, np.unique(touches.object, return_inverse=True)[1]


def _features(
    real: tuple[NDArray, NDArray] | None, size: int, n_features: int, seed: int
) -> tuple[NDArray, NDArray, NDArray]:
    """Return stored features, their objects, and features of held-out touches."""
    rng = np.random.default_rng(seed)
    values, objects = _random_features(rng) if real is None else real
    if n_features < values.shape[1]:
        from sklearn.decomposition import PCA

        values = PCA(n_features, random_state=0).fit_transform(values)
    held_out = np.arange(len(values)) % 10 == seed % 10
    known, of_known = values[~held_out], objects[~held_out]
    labels = np.repeat(np.arange(N_OBJECTS), size // N_OBJECTS)
    stored = np.empty((len(labels), values.shape[1]))
    for place in range(N_OBJECTS):
        own = known[of_known == place]
        mine = labels == place
        drawn = own[rng.integers(0, len(own), int(mine.sum()))]
        stored[mine] = drawn + NOISE * own.std(axis=0) * rng.normal(size=drawn.shape)
    return stored, labels, values[held_out][:N_TESTED]


def _random_features(rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    objects = np.repeat(np.arange(N_OBJECTS), 40)
    centres = rng.normal(size=(N_OBJECTS, max(WIDTHS)))
    return centres[objects] + rng.normal(size=(len(objects), max(WIDTHS))), objects
