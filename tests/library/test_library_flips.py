"""Single flipped bits in a library: found, named, and mended from what is redundant."""

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
    repair_library,
)

OUTCOMES = ("no matter", "restored", "set aside", "refused")
KINDS = ("database", "images", "arrays", "changes")


def _touches(seed, n_touches=12):
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, 5, 6), dtype=np.uint8),
        object=rng.choice(["mug", "pen", "cap"], n_touches),
        force_n=rng.uniform(0.5, 2, n_touches),
        press=np.arange(n_touches),
        position_mm=rng.normal(size=(n_touches, 3)),
        note=rng.choice(["slow", "quick"], n_touches),
        no_contact=np.full((5, 6), seed, np.uint8),
    )


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A library with every kind of change in its past."""
    place = tmp_path_factory.mktemp("sound") / "library"
    with TouchLibrary.open(place, create=True) as library:
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
    return place


@pytest.fixture
def folder(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "library")


def _known(folder, repaired=False):
    """Return all that a library says of its touches, and what it warned of.

    Images of retracted touches may be lost for good, which a repair cannot mend.
    """
    with (
        TouchLibrary.open(folder) as library,
        warnings.catch_warnings(record=True) as w,
    ):
        warnings.simplefilter("always")
        rows = sorted(library.list(limit=None, retracted=True))
        held = [row.id for row in rows if not (repaired and row.retracted)]
        by_id = {key: library.image(key).tobytes() for key in held}
        touches = library.touches("object is not null")
        some = library.touches("session = s2 and force_n > 1")
        columns = {n: c.tolist() for n, c in {**touches.columns, **some.whole}.items()}
        numbers = len(library), library.count("note = slow"), library.stats()[:4]
        told = touches.images.tobytes(), some.columns["force_n"].tolist()
        # A change of the past decides which names are free.
        base = library.no_contact("s3")
        rest = library.objects(), library.sensors(), base is None or base.tolist()
    return (rows, by_id, columns, numbers, told, rest), [str(one.message) for one in w]


def _flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def _files(folder, kind):
    if kind == "database":
        return [folder / "library.sqlite"]
    return sorted(path for path in (folder / kind).rglob("*") if path.is_file())


def _campaign(sound, scratch, n_flips, seed):
    """Flip one bit at a time; return what became of it, counted."""
    rng = random.Random(seed)
    truth = _known(sound)[0], _known(sound, repaired=True)[0]
    table = Counter()
    for number in range(n_flips):
        kind = KINDS[0] if number % 2 else rng.choice(KINDS[1:])
        folder = shutil.copytree(sound, scratch / "flipped", dirs_exist_ok=True)
        path = rng.choice(_files(folder, kind))
        bit = rng.randrange(8 * path.stat().st_size)
        if kind == "images":  # twelve or three of 5 x 6 bytes after a header of 128
            pixels = range(128 * 8, (128 + 30 * len(np.load(path))) * 8)
            kind = "pixels" if bit in pixels else "sheets"
        _flip(path, bit)
        where = f"{path.name} bit {bit}"
        outcome = _outcome(folder, truth, where)
        table[kind, outcome] += 1
        table[kind, "tried"] += 1
        shutil.rmtree(folder)
    return table


def _outcome(folder, truths, where):
    """Judge one flip; bare exceptions and warnings that are not ours end the test."""
    truth, mended = truths
    try:
        known, told = _known(folder)
    except LibraryError:
        known, told = None, []
    try:
        with TouchLibrary.open(folder) as library:
            found = not library.check().ok
    except LibraryError:
        found = True
    assert known in (None, truth) or told, f"silently wrong: {where}"
    assert found or known == truth, f"check saw nothing: {where}"
    if not found:
        return "no matter"
    try:
        repair_library(folder)
    except LibraryError as error:
        # A flipped version may be a newer one's.
        return "refused" if "Update palpate" in str(error) else f"failed: {error}"
    with TouchLibrary.open(folder) as library:
        report = library.check()
    assert report.ok, f"{where}: {report}"
    try:
        after, _ = _known(folder, repaired=True)
    except LibraryError as error:
        raise AssertionError(f"unreadable after repair: {where}: {error}") from error
    lost = any("retracted cannot come back" in p.what for p in report.problems)
    return "restored" if after == mended and not lost else "set aside"


def _assert_nothing_redundant_is_lost(table):
    """Labels and changes stand twice; pixels and no-contact images stand once."""
    assert {outcome for _, outcome in table} <= {*OUTCOMES, "tried"}
    for kind in ("database", "sheets", "changes"):
        assert table[kind, "tried"]
        assert not table[kind, "set aside"]
    print(dict(sorted(table.items())))


def test_fifty_flips_are_never_silently_wrong(sound, tmp_path):
    table = _campaign(sound, tmp_path, 50, seed=1)
    _assert_nothing_redundant_is_lost(table)
    assert table["database", "restored"] > 5


@pytest.mark.slow
def test_two_thousand_flips_are_never_silently_wrong(sound, tmp_path):
    _assert_nothing_redundant_is_lost(_campaign(sound, tmp_path, 2000, seed=2))
