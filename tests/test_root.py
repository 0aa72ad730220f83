"""Helpers of all subpackages: files written whole, extras, parallel tasks, colours."""

import errno
import os
import re
import stat
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate._checks import check_number, check_positive
from palpate._durable import PARTIAL, replacing, write_text
from palpate._extras import install, needed
from palpate._image_estimator import central_moments
from palpate._numbers import exp, otsu_thresholds
from palpate._page import COLOURS
from palpate._parallel import in_parallel

STYLE = Path(__file__).parents[1] / "docs" / "palpate.mplstyle"


def test_a_file_is_replaced_whole(tmp_path):
    target = tmp_path / "kept"
    write_text(target, "old")
    target.chmod(0o600)
    mode = target.stat().st_mode
    with replacing(target) as file:
        file.write(b"new")
        file.flush()
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert target.stat().st_mode == mode  # read by whom it was read before
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


@pytest.mark.parametrize("error", [TypeError, KeyboardInterrupt])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, error):
    target = tmp_path / "kept"
    write_text(target, "old")

    def fails():
        with replacing(target) as file:
            file.write(b"half")
            raise error

    with pytest.raises(error):
        fails()
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_file_and_folder_are_flushed_in_this_order(tmp_path, monkeypatch):
    """The file is flushed first, then its name; killing a process cannot show it."""
    flushed = []

    def fsync(handle):
        folder = stat.S_ISDIR(os.fstat(handle).st_mode)
        flushed.append("folder" if folder else "file")

    monkeypatch.setattr(os, "fsync", fsync)
    write_text(tmp_path / "kept", "x")
    assert flushed == ["file", "folder"]


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP, errno.EIO])
def test_folders_that_cannot_be_flushed_are_passed_over(tmp_path, monkeypatch, number):
    """Some network file systems flush files alone; other errors stay errors."""
    flush = os.fsync

    def fsync(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(number, os.strerror(number))
        flush(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    expected = pytest.raises(OSError) if number == errno.EIO else nullcontext()
    with expected:
        write_text(tmp_path / "kept", "x")
    assert (tmp_path / "kept").read_bytes() == b"x"


def test_a_link_is_followed(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    write_text(target, "old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


def test_the_refusal_names_package_extra_and_command():
    sentence = r'A report needs no_such, which is not installed: pip install "palpate\['
    with pytest.raises(ImportError, match=sentence):
        needed("no_such.inner", "plot", "A report")
    assert install("plot") == 'pip install "palpate[plot]"'
    assert needed("math", "plot", "Nothing").pi > 3


def test_results_keep_the_order_of_their_tasks():
    assert in_parallel(divmod, [(7, 2), (9, 4)], "dividing", n_jobs=2) == [
        (3, 1),
        (2, 1),
    ]


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        ValueError("I/O error: No space left on device (os error 28)"),
    ],
)
def test_a_full_disk_is_reported_by_the_name_that_was_asked_for(tmp_path, error):
    """The second error is how safetensors reports a full disk."""
    target = tmp_path / "model.palpate"
    write_text(target, "old")
    with pytest.raises(OSError, match="No space left") as refusal, replacing(target):
        raise error
    assert refusal.value.filename == str(target)
    assert refusal.value.errno == errno.ENOSPC
    assert [path.name for path in tmp_path.iterdir()] == ["model.palpate"]


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    """The error has the name of the target, not of the temporary file."""
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "kept"
    with pytest.raises(OSError, match="Not a directory") as refusal:
        write_text(target, "new")
    assert refusal.value.filename == str(target)
    assert PARTIAL not in str(refusal.value)


@pytest.mark.parametrize("value", [10**400, -(10**400), float("inf"), float("nan")])
@pytest.mark.parametrize("check", [check_number, check_positive])
def test_numbers_that_no_float_holds_are_refused_by_name(check, value):
    with pytest.raises(ValueError, match=r"^rate must be .*finite.*, got "):
        check("rate", value)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_exponentials_are_numpys_but_for_the_last_bit(rng, kind):
    values = rng.uniform(-80, 80, size=(5, 7, 31)).astype(kind)
    # Two steps of the type, of numbers around 1.
    rtol = 4 * np.finfo(kind).eps
    expected = np.exp(values.astype(np.float64))
    assert_allclose(exp(values), expected, rtol=rtol)
    assert exp(values).dtype == kind
    # Results are the same wherever values lie in memory, and in another layout.
    assert_array_equal(exp(values[2, 3, 5:8].copy()), exp(values)[2, 3, 5:8])
    assert_allclose(exp(values[:, ::2].T), expected[:, ::2].T, rtol=rtol)
    assert exp(values[:0]).shape == (0, 7, 31)
    assert exp(kind(0) * values[0, 0, 0]) == 1
    limits = np.array([-np.inf, -1e30, -1.0, 0.0, np.inf, np.nan], kind)
    assert_allclose(exp(limits), [0, 0, np.exp(-1), 1, np.inf, np.nan], rtol=rtol)
    output = np.empty(values.shape, np.float64)
    exp(values, out=output)
    assert_allclose(output, expected, rtol=rtol)
    assert exp(values, out=values) is not None
    assert_allclose(values, expected, rtol=rtol)


def test_central_moments_are_their_definition(rng):
    image = rng.uniform(size=(5, 7))
    moments = central_moments(image[np.newaxis])
    x, y = np.meshgrid(np.arange(7) - 3.0, np.arange(5) - 2.0)
    middle_x, middle_y = (
        (image * x).sum() / image.sum(),
        (image * y).sum() / image.sum(),
    )
    assert_allclose([moments.x[0], moments.y[0]], [middle_x, middle_y])
    for p in range(4):
        for q in range(4):
            direct = (image * (x - middle_x) ** p * (y - middle_y) ** q).sum()
            # Sums of 35 numbers of at most 27 * 8.
            assert_allclose(moments.mu[0, q, p], direct, atol=1e-11)


def test_an_image_without_mass_has_its_middle_in_the_middle():
    moments = central_moments(np.zeros((1, 4, 6)))
    assert (moments.mass[0], moments.x[0], moments.y[0]) == (0, 0, 0)


def test_otsu_splits_as_opencv_does(rng):
    images = rng.integers(0, 256, (40, 33, 33), dtype=np.uint8)
    images[20:] //= 16
    for image, threshold in zip(
        images, otsu_thresholds(images.reshape(40, -1)), strict=True
    ):
        expected, _ = cv2.threshold(image, 0, 255, cv2.THRESH_OTSU)
        assert_array_equal(image > threshold, image > expected)


def test_otsu_beats_every_other_threshold(rng):
    image = rng.normal(size=(6, 6))
    (best,) = otsu_thresholds(image.reshape(1, -1))

    def between(threshold):
        high = image > threshold
        share = high.mean()
        return share * (1 - share) * (image[high].mean() - image[~high].mean()) ** 2

    others = [between(level) for level in np.sort(image.ravel())[:-1]]
    assert_allclose(between(best), max(others))


def test_otsu_follows_a_change_of_scale(touches):
    rows = touches.reshape(12, -1)
    assert_allclose(otsu_thresholds(3 * rows + 10), 3 * otsu_thresholds(rows) + 10)
    assert np.isnan(otsu_thresholds(np.full((1, 81), 40.0))).all()


# Machado, Oliveira and Fernandes 2009 (doi:10.1109/TVCG.2009.113), severity 1.
SEEN_BY = {
    "everybody": np.eye(3),
    "no long cones": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no middle cones": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no short cones": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


@pytest.mark.parametrize("eyes", SEEN_BY)
def test_the_colours_of_pictures_differ_for_the_colour_blind(eyes):
    style = STYLE.read_text("utf-8")
    (cycle,) = re.findall(r"axes.prop_cycle: .*\[(.*)\]", style)
    codes = [*re.findall(r"[0-9a-f]{6}", cycle), "fbfaf7"]
    assert [f"#{code}" for code in codes[:-1]] == list(COLOURS)
    srgb = np.array([[int(c[i : i + 2], 16) / 255 for i in (0, 2, 4)] for c in codes])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    lab = _lab((linear @ np.transpose(SEEN_BY[eyes])).clip(0, 1))
    distances = np.linalg.norm(lab[:, None] - lab[None], axis=2)
    # A difference of 2.3 is just visible side by side; ten is enough on thin lines.
    assert distances[np.triu_indices(len(codes), 1)].min() > 10


def _lab(linear):
    """Return CIE L*a*b* (D65) of linear sRGB, (n, 3)."""
    xyz = linear @ np.transpose(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    f = np.cbrt(xyz / [0.9505, 1.0, 1.089])  # white; no colour here is near black
    return np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1
    )
