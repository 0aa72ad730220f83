"""A mirror sends names, sizes, numbers and times that could hold up a computer."""

import hashlib
import io
import time
import zipfile
from errno import ENOSPC
from http.server import SimpleHTTPRequestHandler
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from palpate import Touches
from palpate.datasets import card, fetch, where

from .conftest import png, refusal_of, zipped

# pooch leaves the socket of a failed download open.
pytestmark = [
    pytest.mark.filterwarnings("ignore:(tactip4|mattress|taxel10x10):UserWarning"),
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]
ROOT = "dataset-image/Dataset-shapes"
PICTURE = f"{ROOT}/cuboid/_3.png"  # the set has a picture of this name


@pytest.fixture
def small_sources(monkeypatch):
    """Let every source have at most 1 MB."""

    def small(name):
        record = card(name)
        return {**record, "source": {**record["source"], "most_mb": 1}}

    monkeypatch.setattr("palpate.datasets._fetch.card", small)


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


def test_a_zip_with_a_very_long_list_is_not_read(sources, pins, monkeypatch):
    monkeypatch.setattr("palpate.datasets._fetch._LONGEST_LIST", 400)
    sources.put("tactip4", zipped(pins[0]))
    refusal_of("tactip4", "list of files must have at most")


def test_a_picture_of_very_many_pixels_is_refused(sources, pins):
    large = png(np.zeros((3000, 3000), np.uint8))
    sources.put("tactip4", zipped({**pins[0], f"{ROOT}/prism/_8.png": large}))
    refusal_of("tactip4", "at most 307200 pixels, got 3000 x 3000")


def listed(sources, texts):
    """Put files of the set mattress on the server, with the list of their sums."""
    lines = []
    for n, text in enumerate(texts, start=1):
        name = f"experiment-ii/S1/Air_Mat/Matrix_Air_B{n}.txt"
        sources.put("mattress", text, f"files/pmd/1.0.0/{name}")
        lines.append(f"{hashlib.sha256(text).hexdigest()} {name}\n")
    return sources.put("mattress", "".join(lines).encode())


WHOLE = b"\n".join([b"1 " * 27] * 64)


def test_files_of_a_list_are_bounded_by_their_sum(sources, small_sources):
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
    sources, pins, monkeypatch
):
    sources.put("tactip4", zipped(pins[0]))

    def drip(self, source, outputfile):
        for byte in source.read():
            outputfile.write(bytes([byte]))
            outputfile.flush()
            time.sleep(0.05)

    monkeypatch.setattr("palpate.datasets._fetch._MOST_S", 0.5)
    with monkeypatch.context() as patch:
        patch.setattr(SimpleHTTPRequestHandler, "copyfile", drip)
        with pytest.raises(ValueError, match="must be sent within"):
            fetch("tactip4")
    monkeypatch.setattr("palpate.datasets._fetch._MOST_S", 60.0)
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
