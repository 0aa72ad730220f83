"""Sets are fetched from a local server once, checked, and whole or not at all.

The server may also be a mirror that sends names, sizes, numbers and times that could
hold up a computer.
"""

import hashlib
import io
import re
import time
import tomllib
import zipfile
from errno import ENOSPC
from http.server import SimpleHTTPRequestHandler
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.io import savemat

from palpate import Touches
from palpate.datasets import card, fetch, load, names, where

from .conftest import files_in, png, refusal_of, zipped

# pooch leaves the socket of a failed download open.
pytestmark = [
    pytest.mark.filterwarnings("ignore:(tactip4|mattress|taxel10x10):UserWarning"),
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]


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


def test_without_a_home_the_cache_must_be_named(monkeypatch, tmp_path):
    """As in a container whose user has no entry among the users of the system."""

    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("PALPATE_DATA", raising=False)
    monkeypatch.delenv("PALPATE_DATA_HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setattr("pathlib.Path.home", no_home)
    with pytest.raises(ValueError, match=r"PALPATE_DATA_HOME must name.* Set it\."):
        where()
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert where() == tmp_path / "palpate"


def test_a_ready_model_that_cannot_be_kept_is_not_made(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PALPATE_DATA_HOME", str(tmp_path / "file"))
    with pytest.raises(OSError, match="Set PALPATE_DATA_HOME to another"):
        fetch("sim-array", progress=pytest.fail)


def test_touches_of_a_ready_model_are_refused_before_it_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_DATA_HOME", str(tmp_path))
    with pytest.raises(ValueError, match=r"^name must be one of .*, got 'sim-array'\."):
        load("sim-array")
    assert not [*tmp_path.iterdir()]


ROOT = "dataset-image/Dataset-shapes"
PICTURE = f"{ROOT}/cuboid/_3.png"  # the set has a picture of this name


@pytest.fixture
def small_sources(monkeypatch):
    """Let every source have at most 1 MB."""
    read = tomllib.loads

    def small(text):
        return read(re.sub(r"(?m)^most_mb = .*$", "most_mb = 1", text))

    monkeypatch.setattr(tomllib, "loads", small)


def long_names(archive):
    """Add the longest names of a zip; a pattern may take their square, or cube."""
    for n in range(20):
        archive.writestr(f"{ROOT}/cuboid/_{'0' * 65_000}{n}.png", b"")


@pytest.mark.parametrize(
    "add",
    [
        long_names,
        lambda archive: archive.writestr(PICTURE, bytes(10**6), zipfile.ZIP_BZIP2),
        lambda archive: archive.writestr(PICTURE, bytes(10**6), zipfile.ZIP_LZMA),
        lambda archive: archive.writestr(PICTURE, bytes(101 * 10**6)),
    ],
    ids=["names of 65 thousand letters", "bzip2", "LZMA", "would inflate too far"],
)
def test_what_could_hold_a_computer_up_is_passed_over(sources, pins, add):
    buffer = io.BytesIO(zipped(pins[0]))
    with zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        add(archive)
    sources.put("tactip4", buffer.getvalue())
    assert len(Touches.load(fetch("tactip4"))) == 5


def test_no_more_is_inflated_than_the_list_promises(sources, pins):
    """The zip lists a smaller size of one file than it has."""
    bomb = bytes(10**6)
    content = zipped({**pins[0], f"{ROOT}/prism/_8.png": bomb})
    size = len(bomb).to_bytes(4, "little")
    sources.put("tactip4", content.replace(size, (1000).to_bytes(4, "little")))
    refusal_of("tactip4", r"tactip4: .*The download was deleted")


def test_the_sum_of_a_zips_files_is_bounded(sources, pins, small_sources):
    large = {f"{ROOT}/prism/_{n}.png": bytes(300_000) for n in (13, 14, 16, 17)}
    sources.put("tactip4", zipped({**pins[0], **large}))
    refusal_of("tactip4", "files must have at most 1 MB, got 1")


def test_a_set_has_no_more_files_than_it_can_have(sources):
    files = {f"data/a_b/interaction_{n:04d}.jpg": b"" for n in range(901)}
    sources.put("digit_survey", zipped(files))
    refusal_of("digit_survey", "at most 900 files, got 901")


def test_a_zip_with_a_very_long_list_is_not_read(sources, pins, monkeypatch, lower):
    lower(monkeypatch, zip_list_bytes=400)
    sources.put("tactip4", zipped(pins[0]))
    refusal_of("tactip4", "list of files must have at most")


def test_a_picture_of_very_many_pixels_is_refused(sources, pins):
    large = png(np.zeros((3000, 3000), np.uint8))
    sources.put("tactip4", zipped({**pins[0], f"{ROOT}/prism/_8.png": large}))
    refusal_of("tactip4", "3000 x 3000 .* at most 307200 pixels")


def listed(sources, texts):
    """Put files of the set mattress on the server, with the list of their sums."""
    lines = []
    for n, text in enumerate(texts, start=1):
        name = f"experiment-ii/S1/Air_Mat/Matrix_Air_B{n}.txt"
        sources.put("mattress", text, f"files/pmd/1.0.0/{name}")
        lines.append(f"{hashlib.sha256(text).hexdigest()} {name}\n")
    return sources.put("mattress", "".join(lines).encode())


WHOLE = b"\n".join([b"1 " * 27] * 64)


@pytest.mark.parametrize("says_length", [True, False])
def test_files_of_a_list_are_bounded_by_their_sum(
    sources, small_sources, says_length, monkeypatch
):
    send = SimpleHTTPRequestHandler.send_header

    def send_others(self, name, value):
        if says_length or name != "Content-Length":
            send(self, name, value)

    monkeypatch.setattr(SimpleHTTPRequestHandler, "send_header", send_others)
    listed(sources, [WHOLE + b" " * 400_000 + b"%d" % n for n in range(4)])
    refusal_of("mattress", "the source must have at most 1 MB")
    assert len(sources.requests) == 4  # the list and three files


def test_a_list_names_no_more_files_than_the_set_can_have(sources):
    place = listed(sources, [WHOLE])
    lines = place.read_text()
    more = [lines.replace("_B1", f"_B{n}") for n in range(2, 700)]
    place.write_text(lines + "".join(more))
    refusal_of("mattress", "name at most 696, got 699")
    assert len(sources.requests) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (WHOLE.replace(b"1", b"-1", 1), "0 to 65535, got others"),
        (WHOLE.replace(b"1", b"65536", 1), "0 to 65535, got others"),
        (WHOLE[:-4], "mattress: .*reshape"),
        (WHOLE + b" " * 10**7, "at most 10000000 bytes"),
    ],
    ids=["negative", "large", "short", "long"],
)
def test_counts_that_are_none_are_refused(sources, text, message):
    listed(sources, [text])
    refusal_of("mattress", message)


def film(**arrays):
    buffer = io.BytesIO()
    savemat(buffer, arrays, do_compression=True)
    place = "Data_Analysis/Measurements_Collected/ball/ball_raster.mat"
    return zipped({place: buffer.getvalue()})


@pytest.mark.parametrize(
    ("content", "got"),
    [
        (film(D=np.ones((100, 901, 2))), "D"),
        (film(C=np.ones((100, 901))), "C of shape"),
        (film(C=np.array(["a", "b"])), "C of shape"),
        (film(C=np.ones((100, 1000, 300), np.uint8)), "C of shape"),
        (zipped({"Measurements_Collected/a/a_raster.mat": b"MATLAB"}), "be read"),
        (film(C=np.ones((100, 90, 2))), "taxel10x10: .*deleted"),
    ],
    ids=["other name", "flat", "text", "large", "no film", "short"],
)
def test_a_film_that_is_none_is_refused_in_a_sentence(sources, content, got):
    sources.put("taxel10x10", content)
    assert "fetch it again" in refusal_of("taxel10x10", got)


def test_a_source_that_sends_a_little_now_and_then_is_given_up(
    sources, pins, monkeypatch, lower
):
    sources.put("tactip4", zipped(pins[0]))

    def drip(self, source, outputfile):
        for byte in source.read():
            outputfile.write(bytes([byte]))
            outputfile.flush()
            time.sleep(0.05)

    lower(monkeypatch, fetch_s=0.5)
    with monkeypatch.context() as patch:
        patch.setattr(SimpleHTTPRequestHandler, "copyfile", drip)
        with pytest.raises(ValueError, match="must be sent within"):
            fetch("tactip4")
    lower(monkeypatch, fetch_s=60.0)
    assert fetch("tactip4").is_file()


def test_a_full_disk_leaves_no_part_of_the_files_beside_an_archive(
    sources, monkeypatch
):
    dark = png(np.zeros((480, 640), np.uint8))
    touch = "touch/01_box/01/touch_1_img_2_name_box_hst_at_2_0_1.jpg"
    sources.put("bathtip", zipped({touch: dark, "baselineForCalibration.jpg": dark}))
    write_bytes = Path.write_bytes

    def no_room(self, data):
        write_bytes(self, data[:1])
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", no_room)
    with pytest.raises(OSError, match="No space left"):
        fetch("bathtip")
    assert not [*(where() / "bathtip").iterdir()]
