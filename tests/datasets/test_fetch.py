"""Sets are fetched from a local server once, checked, and whole or not at all."""

import hashlib
from errno import ENOSPC
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.datasets import card, fetch, load, names, where

from .conftest import files_in, refusal_of, zipped

pytestmark = pytest.mark.filterwarnings("ignore:tactip4:UserWarning")


def test_a_set_becomes_an_archive_once(sources, pins, tmp_path):
    files, levels = pins
    sources.put("tactip4", zipped({**files, "README.md": b"pins"}))
    with pytest.warns(UserWarning, match="tactip4: ") as warned:
        path = fetch("tactip4")
    with np.load(path) as archive:
        assert [*archive] == ["images", "object", "frame"]
    touches = Touches.load(path)
    assert touches.object.tolist() == ["cuboid"] * 3 + ["prism"] * 2
    assert touches.columns["frame"].tolist() == [1, 2, 10, 1, 2]  # 4 is not in the card
    assert_array_equal(touches.images, levels[[0, 1, 2, 4, 3]])
    messages = [str(warning.message) for warning in warned]
    assert "no SHA-256 of the source was known" in messages[0]
    assert "images, object, frame are not the arrays behind the figures" in messages[1]
    assert files_in(tmp_path / "fetched") == [
        ".fetched/tactip4.sha256",
        "tactip4/tactip4.npz",
    ]
    assert fetch("tactip4") == path
    assert_array_equal(load("tactip4").images, touches.images)
    assert len(sources.requests) == 1


def test_the_first_hash_is_kept_and_another_is_refused(sources, pins):
    content = zipped(pins[0])
    place = sources.put("tactip4", content)
    path = fetch("tactip4")
    path.unlink()
    kept = hashlib.sha256(content).hexdigest()
    changed = zipped({**pins[0], "more.txt": b"changed"})
    place.write_bytes(changed)
    got = hashlib.sha256(changed).hexdigest()
    with pytest.raises(ValueError, match=f"{kept}.*{got}.*delete .*tactip4.sha256"):
        fetch("tactip4")
    assert not path.exists()
    place.write_bytes(content)
    assert fetch("tactip4").is_file()


def test_a_whole_download_is_not_requested_again(sources, pins, monkeypatch):
    sources.put("tactip4", zipped(pins[0]))

    def no_room(*_, **__):
        raise OSError(ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", no_room)
        with pytest.raises(OSError, match="No space left"):
            fetch("tactip4")
    assert files_in(where() / "tactip4") == []
    fetch("tactip4")
    assert len(sources.requests) == 1


def test_a_full_disk_leaves_no_part_of_a_download(sources, pins, monkeypatch):
    import pooch

    sources.put("tactip4", zipped(pins[0]))

    def no_room(self, url, output_file, _):
        Path(output_file).write_bytes(b"half")
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(pooch.HTTPDownloader, "__call__", no_room)
    refusal_of("tactip4", "No space left", OSError)


def test_a_download_that_is_cut_off_leaves_nothing(sources, pins, monkeypatch):
    from http.server import SimpleHTTPRequestHandler

    content = zipped(pins[0])
    sources.put("tactip4", content)

    def half(self, source, outputfile):
        outputfile.write(source.read(len(content) // 2))

    monkeypatch.setattr(SimpleHTTPRequestHandler, "copyfile", half)
    refusal_of("tactip4", r"cut off.*`mirror`", OSError)


def test_an_interruption_leaves_nothing(sources, pins):
    sources.put("tactip4", zipped(pins[0]))

    def stop(stage):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fetch("tactip4", progress=stop)
    assert files_in(where()) == []


def test_without_a_network_one_sentence_says_what_to_do(tmp_path):
    pytest.importorskip("pooch")
    # Port 9 of this computer answers nobody.
    with pytest.raises(
        OSError, match=r"cannot be reached.*network.*`mirror`"
    ) as refusal:
        fetch("tactip4", folder=tmp_path, mirror="http://127.0.0.1:9")
    assert "\n" not in str(refusal.value)


def test_what_the_source_has_no_more_is_named(sources):
    with pytest.raises(OSError, match=r"404.*tactip-cnn-bayes.*`mirror`"):
        fetch("tactip4")


@pytest.mark.parametrize("mirror", ["ftp://lab", "file:///etc", "lab", "https:///x"])
def test_a_mirror_is_an_address(mirror, tmp_path):
    pytest.importorskip("pooch")
    with pytest.raises(ValueError, match="mirror must begin with https"):
        fetch("tactip4", folder=tmp_path, mirror=mirror)


def test_a_mirror_goes_before_the_environment(sources, pins, monkeypatch):
    sources.put("tactip4", zipped(pins[0]))
    monkeypatch.setenv("PALPATE_DATA_MIRROR", "http://127.0.0.1:9")
    assert fetch("tactip4", mirror=sources.address + "/").is_file()


def test_what_is_too_large_is_refused_before_it_is_there(sources, monkeypatch):
    place = sources.put("tactip4", b"")
    with place.open("wb") as file:
        file.truncate(501 * 10**6)  # a sparse file
    refusal_of("tactip4", "at most 500 MB, got 501")


def test_no_path_of_a_zip_leads_out(sources, pins, tmp_path):
    files, _ = pins
    hostile = {
        "../../../../escaped/cuboid/_1.png": files[min(files)],
        "/etc/cuboid/_2.png": files[min(files)],
        "..\\..\\_3.png": b"",
    }
    sources.put("tactip4", zipped({**files, **hostile}))
    fetch("tactip4")
    assert not list(tmp_path.rglob("*escaped*"))
    assert {p.split("/")[0] for p in files_in(where())} == {".fetched", "tactip4"}


@pytest.mark.parametrize("damage", ["no zip", "cut", "changed"])
def test_a_damaged_zip_is_deleted(damage, sources, pins):
    content = bytearray(zipped(pins[0]))
    if damage == "changed":
        content[100:140] = bytes(40)
    kept = {"no zip": b"<html>", "cut": content[:-30]}.get(damage, content)
    place = sources.put("tactip4", bytes(kept))
    refusal_of("tactip4", r"tactip4: .*fetch it again")
    place.write_bytes(zipped(pins[0]))
    assert fetch("tactip4").is_file()


def test_a_source_of_another_layout_is_refused(sources):
    sources.put("tactip4", zipped({"new/place.png": b""}))
    with pytest.raises(ValueError, match=r"files like .*laid out in another way"):
        fetch("tactip4")


def test_a_list_of_checksums_is_believed_file_by_file(sources):
    text = b"1 " * 27 + b"\n"
    inside = "experiment-ii/S1/Air_Mat/Matrix_Air_B1.txt"
    root = "files/pmd/1.0.0"
    sources.put("mattress", text * 64, f"{root}/{inside}")
    other = hashlib.sha256(b"").hexdigest()
    sums = f"{other} {inside}\n{other} ../../etc/passwd\nno line\n"
    place = sources.put("mattress", sums.encode())
    refusal_of("mattress", other)
    true = hashlib.sha256(text * 64).hexdigest()
    place.write_text(sums.replace(other, true, 1))
    with pytest.warns(UserWarning, match="mattress: "):
        touches = Touches.load(fetch("mattress"))
    assert (touches.images == 1).all()
    assert touches.images.shape == (1, 64, 27)
    assert touches.session.tolist() == ["air"]
    assert "passwd" not in "".join(sources.requests)


# pooch leaves the socket of a failed download open.
@pytest.mark.filterwarnings("ignore:mattress", "ignore:unclosed:ResourceWarning")
def test_files_that_were_fetched_are_not_requested_again(sources):
    first, second = (b"\n".join([n * 27] * 64) for n in (b"1 ", b"2 "))
    fetched, lacking = (f"experiment-ii/S1/Air_Mat/Matrix_Air_B{n}.txt" for n in (1, 2))
    hashes = [hashlib.sha256(text).hexdigest() for text in (first, second)]
    sums = f"{hashes[0]} {fetched}\n{hashes[1]}  {lacking}\n"
    sources.put("mattress", sums.encode())
    sources.put("mattress", first, f"files/pmd/1.0.0/{fetched}")
    with pytest.raises(OSError, match="404"):
        fetch("mattress")
    sources.put("mattress", second, f"files/pmd/1.0.0/{lacking}")
    assert len(Touches.load(fetch("mattress"))) == 2
    assert sum(path.endswith(fetched) for path in sources.requests) == 1


def test_what_cannot_be_fetched_says_why(tmp_path):
    for name in names():
        if "why_not" in card(name):
            with pytest.raises(ValueError, match="See its page"):
                fetch(name, folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_where_follows_the_environment_and_the_system(monkeypatch, tmp_path):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    monkeypatch.delenv("PALPATE_DATA_HOME")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert where() == tmp_path / "palpate"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert where() == tmp_path / ".cache" / "palpate"
    monkeypatch.setattr("sys.platform", "darwin")
    assert where() == tmp_path / "Library" / "Caches" / "palpate"
    monkeypatch.setenv("PALPATE_DATA_HOME", "home")
    assert str(where()) == "home"
    monkeypatch.setenv("PALPATE_DATA", "mine")
    assert str(where()) == "mine"
    assert str(where("given")) == "given"


def test_touches_of_a_ready_model_are_refused_before_it_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_DATA_HOME", str(tmp_path))
    with pytest.raises(ValueError, match=r"^name must be one of .*, got 'sim-array'\."):
        load("sim-array")
    assert not [*tmp_path.iterdir()]
