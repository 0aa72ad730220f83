"""Single flipped bits in a library and in its log: never silently wrong."""

import random
import shutil
import warnings
from collections import Counter

import numpy as np
import pytest

from palpate import Touches
from palpate.library import (
    LibraryError,
    SensorDescription,
    TouchLibrary,
    check_library,
    repair_library,
)


def _touches(seed, n_touches=12):
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, 5, 6), dtype=np.uint8),
        object=rng.choice(["mug", "pen", "cap"], n_touches),
        force_n=rng.uniform(0.5, 2, n_touches),
        press=np.arange(n_touches),
        position_mm=rng.normal(size=(n_touches, 3)),
        note=rng.choice(["slow", "quick"], n_touches),
        wave=rng.normal(size=(n_touches, 40)),
        no_contact=np.full((5, 6), seed, np.uint8),
    )


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A library with every kind of change in its past, with and without its log.

    Most of the second is in a log that nobody has emptied, as after a kill.
    """
    place = tmp_path_factory.mktemp("sound")
    with TouchLibrary.open(place / "lab", create=True) as library:
        for seed in range(6):
            pad = SensorDescription("pad", "array", "kPa", 4.0, "array")
            library.add(_touches(seed), session=f"s{seed}", sensor=pad)
        library.rename_object("mug", "cup")
        library.add(_touches(7, 3), session="later")
        library.merge_objects("cap", "cup")
        library.retract(object="pen", reason="wet")
        library.restore(
            [row.id for row in library.list("press < 4", limit=None, retracted=True)]
        )
        shutil.copytree(place / "lab", place / "log")
    for shared in place.glob("*/library.sqlite-shm"):
        shared.unlink()
    assert (place / "log" / "library.sqlite-wal").stat().st_size > 100_000
    return place


def _truth(folder):
    """Return all that a library says, and what it warned of."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with TouchLibrary.open(folder) as library:
            rows = library.list(limit=None, retracted=True)
            touches = library.touches()
            known = (
                {row.id: (row, library.image(row.id).tobytes()) for row in rows},
                [row.id for row in rows],
                {n: c.tolist() for n, c in touches.columns.items()},
                {n: c.tolist() for n, c in touches.whole.items()},
                touches.images.tobytes(),
                library.select("session = s2 and force_n > 1").touch_id.tolist(),
                (library.count("note = slow"), library.stats()[:5]),
                (library.objects(), library.sensors(), library.history()),
                np.asarray(library.no_contact("s3")).tolist(),
            )
    return known, [str(warning.message) for warning in warned]


def _flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def _outcome(folder, truth, where):
    """Judge one flip; a bare exception, or a wrong answer without a word, fails."""
    try:
        known, warned = _truth(folder)
    except LibraryError:
        known, warned = None, []
    report = check_library(folder)
    told = not report.ok or bool(warned)
    assert known in (None, truth) or told, f"silently wrong: {where}"
    assert known == truth or not report.ok, f"check saw nothing: {where}"
    if report.ok:
        return "no matter"
    before = {p.name: p.read_bytes() for p in folder.glob("library.sqlite")}
    try:
        done = repair_library(folder)
    except LibraryError as error:
        # A flipped version is a newer one's; of a header nothing can be read.
        assert before == {p.name: p.read_bytes() for p in folder.glob("library.sqlite")}
        return "newer" if "Update palpate" in str(error) else "refused"
    left = check_library(folder)
    assert left.ok, f"{where}: {left}"
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list(limit=None, retracted=True)]
        images = {key: library.image(key).tobytes() for key in ids}
    assert ids == [key for key in truth[1] if key in images], where
    assert all(truth[0][key][1] == image for key, image in images.items()), where
    assert len(ids) + len(done.lost) >= len(truth[1]) or not done.rebuilt, where
    n_lost = len(truth[1]) - len(ids)
    return ("restored", "one lost")[n_lost] if n_lost < 2 else "several lost"


def _campaign(sound, scratch, name, suffix, n_flips, seed):
    """Flip one bit at a time anywhere in a file; return what became of it, counted."""
    rng = random.Random(seed)
    truth, warned = _truth(shutil.copytree(sound / name, scratch / "truth"))
    assert not warned
    table = Counter()
    for _ in range(n_flips):
        folder = shutil.copytree(sound / name, scratch / "flipped")
        path = folder / f"library.sqlite{suffix}"
        bit = rng.randrange(8 * path.stat().st_size)
        _flip(path, bit)
        table[_outcome(folder, truth, f"{path.name} bit {bit}")] += 1
        shutil.rmtree(folder)
    print(dict(table))
    return table


@pytest.mark.parametrize(("name", "suffix"), [("lab", ""), ("log", "-wal")])
@pytest.mark.slow
def test_thirty_flips_each_are_never_silently_wrong(sound, tmp_path, name, suffix):
    table = _campaign(sound, tmp_path, name, suffix, 30, seed=1)
    assert table["refused"] <= 3  # of a damaged header nothing can be read
    assert sum(table.values()) - table["no matter"] > 5
    if not suffix:  # a page of rows; of a log all that comes after the flipped bit
        assert table["several lost"] <= 6


@pytest.mark.slow
@pytest.mark.parametrize(("name", "suffix"), [("lab", ""), ("log", "-wal")])
def test_three_hundred_flips_each_are_never_silently_wrong(
    sound, tmp_path, name, suffix
):
    _campaign(sound, tmp_path, name, suffix, 300, seed=2)
