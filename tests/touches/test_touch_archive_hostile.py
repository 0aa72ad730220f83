"""Touch archives that are damaged, mean harm, or are no touch archives."""

import io
import os
import tracemalloc
import zipfile
from contextlib import suppress

import numpy as np
import pytest

from palpate import Touches
from palpate.touches import TouchesError


def npy(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array))
    return stream.getvalue()


def npy_header(text, version=b"\x01\x00"):
    body = text.encode() + b"\n"
    n_length = 2 if version[0] == 1 else 4
    return b"\x93NUMPY" + version + len(body).to_bytes(n_length, "little") + body


def described(shape, descr="|u1", fortran=False):
    return npy_header(repr({"descr": descr, "fortran_order": fortran, "shape": shape}))


def zipped(path, members, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return path


GOOD = ("images.npy", npy(np.zeros((2, 2, 2), np.uint8)))


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([("images.npy", b"")], "images.npy must be an array as numpy.save writes it"),
        ([("images.npy", b"\x93NUMPY\x03\x00")], "must be an array as numpy.save"),
        ([("images.npy", npy_header("1 + "))], "must be an array as numpy.save"),
        ([("images.npy", npy_header("[]"))], "must be an array as numpy.save"),
        ([("images.npy", npy_header("(" * 5000))], "must be an array as numpy.save"),
        ([("images.npy", npy_header("{'a': 1}"))], "must be an array as numpy.save"),
        ([("images.npy", npy_header("-" * 9000 + "1"))], "must be an array as numpy"),
        (
            [("images.npy", npy_header("0" * 20_000, b"\x02\x00"))],
            "header, expected 20001 bytes",
        ),
        ([("images.npy", described((-2, 2, 2)))], r"got shape \(-2, 2, 2\)"),
        ([("images.npy", described((2, 2, 2), "<U0"))], "got shape"),
        ([("images.npy", described((2, 2, 2), "|V3"))], "plain numbers or text"),
        ([("images.npy", described((2, 2, 2), "not a type"))], "as numpy.save writes"),
        (
            [("images.npy", described((2**40, 2**20, 2**20)) + bytes(8))],
            "must hold the 1208925819614629174706176 bytes .* got 8",
        ),
        ([("images.npy", described((2, 2, 2)) + bytes(7))], "8 bytes .* got 7"),
        ([("images.npy", described((2, 2, 2)) + bytes(9))], "8 bytes .* got 9"),
        ([GOOD, ("readme.txt", b"hello")], "another file, 'readme.txt'"),
        ([GOOD, ("folder/", b"")], "another file, 'folder/'"),
        ([("images", GOOD[1])], "another file, 'images'"),
        ([GOOD, ("object.npy", npy(["a"] * 3))], "object must have one row per touch"),
        ([GOOD, ("object.npy", npy(["a", ""]))], "empty label at touch 1"),
        (
            [GOOD, ("object.npy", described((2,), "<U1") + b"\xff\xff\xff\x7fa\0\0\0")],
            "characters outside Unicode",
        ),
        (
            [GOOD, ("object.npy", described((2,), ">U1") + b"\0\x11\0\0\0\0\0a")],
            "characters outside Unicode",
        ),
        ([GOOD, ("geometry.npy", npy("ball"))], "geometry must be one of"),
        ([("images.npy", npy(np.zeros((2, 4, 6, 3))))], "channels must name each"),
        ([("images.npy", npy(np.full((1, 1, 1), np.inf)))], "infinity in touch 0"),
        ([], "is not a touch archive.*it holds nothing"),
        (
            [("counts.npy", npy(np.zeros((5, 3)))), ("photo.npy", npy(7))],
            r"not a touch archive.*counts \(5 x 3 float64\), photo \(one int64\)",
        ),
        ([(f"a{i}.npy", b"") for i in range(1001)], r"at most 1000 arrays .* got 1001"),
    ],
)
def test_odd_archives_are_refused(tmp_path, members, message):
    path = zipped(tmp_path / "odd.npz", members)
    with pytest.raises(TouchesError, match=message) as refusal:
        Touches.load(path)
    assert str(path) in str(refusal.value)


def test_a_column_listed_as_whole_stays_a_column(tmp_path):
    names = ("set_whole_names.npy", npy(["object", "images", "extra", "absent"]))
    extra = ("extra.npy", npy([1, 2]))
    members = [GOOD, ("object.npy", npy(["a", "b"])), extra, names]
    touches = Touches.load(zipped(tmp_path / "t.npz", members))
    assert list(touches.columns) == ["object"]
    assert list(touches.whole) == ["extra"]


def test_pickles_are_refused_and_never_run(tmp_path):
    class Harm:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "harm"),)

    array = np.empty(2, dtype=object)
    array[0] = Harm()
    np.savez(tmp_path / "p.npz", images=np.zeros((2, 2, 2)), object=array)
    with pytest.raises(TouchesError, match=r"object.npy .* got Python objects"):
        Touches.load(tmp_path / "p.npz")
    assert not (tmp_path / "harm").exists()


def test_duplicate_members_are_refused(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = zipped(tmp_path / "d.npz", [GOOD, GOOD])
    with pytest.raises(TouchesError, match=r"different names, .* 'images.npy' twice"):
        Touches.load(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_inflate_without_limit_are_refused(tmp_path, method):
    path = zipped(tmp_path / "m.npz", [GOOD], method)
    with pytest.raises(TouchesError, match="stored or deflated, got zip method"):
        Touches.load(path)


def test_encrypted_members_are_refused(tmp_path):
    path = zipped(tmp_path / "e.npz", [GOOD])
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + offset] |= 1
    path.write_bytes(data)
    with pytest.raises(TouchesError, match="an encrypted member"):
        Touches.load(path)


def test_a_bomb_is_refused_before_it_inflates(tmp_path):
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, images=np.zeros((64, 1024, 1024), np.uint8))
    assert path.stat().st_size < 2**17
    tracemalloc.start()
    with pytest.raises(TouchesError, match=r"at most 16777216 bytes, got 67"):
        Touches.load(path, max_bytes=2**24)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def patched_size(path, size):
    """Make the zip directory and the local header promise another size."""
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = data.index(signature) + offset
        data[at : at + 4] = size.to_bytes(4, "little")
    path.write_bytes(data)


@pytest.mark.parametrize(("side", "n_bytes"), [(2, 2**26), (9, 0)])
def test_an_archive_that_lies_about_its_size_does_not_inflate(tmp_path, side, n_bytes):
    header = described((side, side, side))
    path = zipped(tmp_path / "liar.npz", [("images.npy", header + bytes(n_bytes))])
    patched_size(path, len(header) + side**3)
    tracemalloc.start()
    with pytest.raises(TouchesError, match=r"liar.npz must be a touch archive"):
        Touches.load(path)
    # zipfile inflates by chunks; 64 MiB would be the whole.
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


def test_files_that_are_no_archive_are_refused(tmp_path):
    for name, content in [("empty.npz", b""), ("text.npz", b"hello" * 99)]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(TouchesError, match=rf"{name} must be a touch archive"):
            Touches.load(tmp_path / name)
    (tmp_path / "bare.doc").write_bytes(b"hello")
    with pytest.raises(TouchesError, match="got another kind of file"):
        Touches.load(tmp_path / "bare.doc")
    (tmp_path / "press.mp4").write_bytes(b"hello")
    with pytest.raises(TouchesError, match="cut into touches, got a film"):
        Touches.load(tmp_path / "press.mp4")
    for name in ("missing", "missing.npz"):
        with pytest.raises(TouchesError, match="got nothing there"):
            Touches.load(tmp_path / name)
    for name in ("pipe.npz", "pipe.h5"):  # is not waited for
        os.mkfifo(tmp_path / name)
        with pytest.raises(TouchesError, match="got another kind of file"):
            Touches.load(tmp_path / name)


def test_an_unreadable_archive_says_so(tmp_path, monkeypatch):
    def refused(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    path = zipped(tmp_path / "t.npz", [GOOD])
    monkeypatch.setattr("zipfile.ZipFile", refused)
    with pytest.raises(TouchesError, match=r"t.npz must be readable.*permissions"):
        Touches.load(path)


def small_archive(path):
    Touches(
        np.arange(12, dtype=np.float32).reshape(3, 2, 2),
        object=["a", "b", "b"],
        no_contact=np.zeros((2, 2)),
    ).save(path)
    return path.read_bytes()


def test_every_truncation_is_refused(tmp_path):
    path = tmp_path / "t.npz"
    data = small_archive(path)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(TouchesError, match=r"t.npz"):
            Touches.load(path)


def test_damage_is_refused_or_changes_no_value(tmp_path):
    """A zip file has a checksum of everything but names; each byte is flipped once."""
    path = tmp_path / "t.npz"
    data = small_archive(path)

    def values():
        touches = Touches.load(path)
        others = (*touches.columns.values(), *touches.whole.values())
        return touches.images.tobytes(), {array.tobytes() for array in others}

    whole = values()
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << position % 8
        path.write_bytes(damaged)
        with suppress(TouchesError):
            assert values() == whole
