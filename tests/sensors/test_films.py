"""Films into touches by the detector: known presses come out, odd files are refused."""

import re

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.sensors import SensorError, TouchDetector

RATE_HZ = 20


def presses(n=3, colour=False):
    """Frames of nothing, then `n` presses of eight frames with eight between."""
    frames = [np.full((48, 64, 3), 90, np.uint8) for _ in range(12)]
    for press in range(n):
        for level in (20, 60, 100, 100, 100, 60, 20, 5):
            frame = np.full((48, 64, 3), 90, np.uint8)
            frame[10 : 30 + press, 20:40, 0 if colour else slice(3)] += np.uint8(level)
            frames.append(frame)
        frames += [np.full((48, 64, 3), 90, np.uint8) for _ in range(8)]
    return np.array(frames)


@pytest.fixture
def film(tmp_path):
    """Write red, green and blue frames without loss; return the path."""

    def write(frames, name="press.mkv"):
        path = tmp_path / name
        size = frames.shape[2], frames.shape[1]
        code = cv2.VideoWriter_fourcc(*"FFV1")
        out = cv2.VideoWriter(str(path), code, RATE_HZ, size)
        if not out.isOpened():
            pytest.skip("this OpenCV writes no FFV1")
        for frame in frames:
            out.write(frame[..., ::-1])
        out.release()
        return path

    return write


@pytest.mark.parametrize("colour", [False, True])
def test_each_press_is_a_touch(film, colour):
    frames = presses(3, colour)
    touches = TouchDetector().touches_in(film(frames), colour=colour)
    assert len(touches) == 3
    # The first frame that differs, at its time in the film.
    assert_allclose(touches.columns["time_s"], (12 + 16 * np.arange(3)) / RATE_HZ)
    assert (touches.columns["duration_s"] > 0.25).all()
    assert touches.channels == (("r", "g", "b") if colour else None)
    # FFV1 in 4:2:0 keeps grey to a level or two; edges of colours blur into neighbours.
    if not colour:
        peak = frames[12 + 3, ..., 0].astype(int)
        assert np.abs(touches.images[0].astype(int) - peak).max() <= 2


def test_frames_that_were_read_as_touches_are_a_stream():
    frames = presses(2)[..., 0]
    stream = Touches(frames, time_s=100 + np.arange(len(frames)) / RATE_HZ)
    touches = TouchDetector().touches_in(stream)
    assert_array_equal(touches.images, frames[[14, 30]])
    assert_allclose(touches.columns["time_s"], 100 + np.array([12, 28]) / RATE_HZ)
    assert_array_equal(touches.no_contact, frames[0])


def test_files_without_films_are_refused(tmp_path):
    (tmp_path / "text.mp4").write_bytes(b"hello" * 99)
    with pytest.raises(SensorError, match=r"a film that OpenCV .*got"):
        TouchDetector().touches_in(tmp_path / "text.mp4")
    with pytest.raises(SensorError, match="got no file there"):
        TouchDetector().touches_in(tmp_path / "missing.mp4")


def test_a_film_that_ends_early_is_refused(film):
    path = film(presses(3), "press.avi")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    # OpenCV before 4.11 does not even open it.
    early = r"must hold 60 frames, got \d+: it ends early|must be a film that OpenCV"
    with pytest.raises(SensorError, match=early):
        TouchDetector().touches_in(path)


def test_a_rest_that_moves_away_is_said_with_the_limit_that_helps():
    """A rest that moved by more than a tenth of a squeeze: the 7 after it are one."""
    images = presses(8)[..., 0]
    images[20:] += 9
    detector = TouchDetector()
    touches = detector.touches_in(Touches(images))
    assert len(touches) == 2
    limit = re.search(r"^2 touches begin .* 8 would at ([\d.]+) \(", detector.note)
    better = TouchDetector(begin=float(limit[1]))
    assert len(better.touches_in(Touches(images))) == 8
    assert better.note == ""


def test_squeezes_below_the_limit_are_counted():
    images = presses(3)[..., 0]
    faint = (images.astype(float) - 90) / 100 + 90
    rng = np.random.default_rng(0)
    stream = Touches(faint + rng.normal(0, 1e-3, faint.shape))
    detector = TouchDetector(begin=0.5)
    with pytest.raises(SensorError, match=r"3 would at .* 3 changes lay below"):
        detector.touches_in(stream)
    assert len(TouchDetector().touches_in(stream)) == 3


@pytest.mark.parametrize("codec", ["libsvtav1", "libx264"])
def test_films_that_opencv_may_not_decode_come_through_av(tmp_path, codec, monkeypatch):
    av = pytest.importorskip("av")
    frames = presses(2)
    path = tmp_path / "press.mp4"
    with av.open(str(path), "w") as film:
        try:
            stream = film.add_stream(codec, rate=RATE_HZ)
        except (av.FFmpegError, ValueError):
            pytest.skip(f"this av has no {codec}")
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for frame in frames:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        film.mux(stream.encode())
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: _NoDecoder())
    touches = TouchDetector().touches_in(path)
    assert_allclose(touches.columns["time_s"], [0.6, 1.4], atol=0.051)  # one frame
    peak = frames[12 + 3, ..., 0].astype(int)
    # The codec loses a little: 2 levels on average.
    assert np.abs(touches.images[0].astype(int) - peak).mean() < 2
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(SensorError, match="must be a film that OpenCV or FFmpeg"):
        TouchDetector().touches_in(path)


class _NoDecoder:
    """Answers as OpenCV does for a film that it does not decode."""

    def get(self, _):
        return 0.0

    def grab(self):
        return False

    def release(self):
        pass
