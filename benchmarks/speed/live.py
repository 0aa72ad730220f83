"""Speed of learning and touching: to the new belief, frames to a page, the next lesson.

`latency` starts from a 640 x 480 JPEG in memory, with 90 training touches of each of 50
objects, on one core. The pictures are drawn: domes with dents at random places; what is
measured is time, not recognition.

`live` runs everything in this process: a replayed sensor, the server, and a client that
reads its websocket as a page does. Wall time counts here, since a stream is paced by
its sensor; the CPU time of the whole process stands beside it.

`learning` measures learning, and adding to what was learnt, beside a plain SVM.
"""

import json
import tempfile
import time
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from pathlib import Path
from time import process_time
from timeit import timeit
from typing import Any

import numpy as np

from palpate._types import Array, PresetName
from palpate.library import TouchLibrary
from palpate.recognition import ObjectRecogniser
from palpate.touches import Touches, decode_bytes

from . import N_COLS, N_ROWS, Row, coded, drawn_dome, one_thread, row, wall_ms

STAGES = ("decode", "clean up", "encode", "likelihood", "belief")
_N_TOUCHES = 12  # seen by the page
_OFFERED_HZ = 30.0  # of a camera
_STREAM = f"{N_COLS} x {N_ROWS} uint8 replay"
_WAYS = ("frame to", "touch to belief at")
_alone = partial(row, reason="no other tool shows a belief over objects live")


def bench_latency(
    n_objects: int = 50,
    n_each: int = 90,
    n_asked: int = 200,
    presets: tuple[PresetName, ...] = ("default", "corradi2015"),
) -> list[Row]:
    """Measure stages of single touches: median and 99th percentile of wall time, ms."""
    train = drawn_touches(n_objects, n_each, small=False)
    test = drawn_touches(n_objects, -(-n_asked // n_objects), seed=1, small=False)
    pictures = [coded(image) for image in test.images[:n_asked]]
    rows = []
    with one_thread():
        for preset in presets:
            recogniser = ObjectRecogniser(preset).fit(train)
            for picture in pictures[:3]:
                _stage_seconds(recogniser, picture)
            seconds = np.array([_stage_seconds(recogniser, p) for p in pictures])
            stages = np.column_stack([seconds, seconds.sum(axis=1)]) * 1e3
            for name, ms in zip((*STAGES, "in all"), stages.T, strict=True):
                title = f"{n_objects} objects {preset} {name}"
                late = float(np.quantile(ms, 0.99))
                facts = {"p99_ms": late, "reason": "no peer does this"}
                rows.append(row(title, float(np.median(ms)), "none", None, **facts))
    return rows


def _stage_seconds(recogniser: ObjectRecogniser, picture: bytes) -> list[float]:
    """Return the seconds of each stage of one touch, the second of its episode."""
    encoder = recogniser.encoder_
    belief = recogniser.start()
    clock = time.perf_counter
    times = [clock()]
    touch = Touches(decode_bytes(picture)[np.newaxis])
    times.append(clock())
    cleaned = encoder.clean(touch)
    recogniser.contact_.flags(touch, cleaned)
    times.append(clock())
    features = encoder.encode_fully(cleaned)[0]
    times.append(clock())
    log_likelihood = recogniser.classifier_.log_likelihood(features)
    times.append(clock())
    belief.update_from_log_likelihood(log_likelihood, features=features)
    belief.decide()
    times.append(clock())
    return np.diff(times).tolist()


def bench_live(seconds: float = 8.0) -> list[Row]:
    """Measure the live loop at 640 x 480, 30 frames offered, for some seconds each.

    Milliseconds per frame at the client (33.3 is all), from a touch to its belief
    there, and per frame of a 16 x 16 array at 100 Hz.
    """
    with one_thread():
        return [*_watched(seconds), _array_row(seconds)]


def _watched(seconds: float) -> list[Row]:
    """Serve a replayed camera that recognises, and read its websocket."""
    from websockets.sync.client import connect

    from palpate.sensors import ReplaySensor
    from palpate.web import LiveSession, PageServer, create_app

    # A dome touched by a round and a long thing.
    rng = np.random.default_rng(0)
    kinds = {"ball": (55.0, 55.0), "edge": (24.0, 110.0)}
    touches = Touches(
        [drawn_dome(rng, size) for size in kinds.values() for _ in range(_N_TOUCHES)],
        object=np.repeat(list(kinds), _N_TOUCHES),
        no_contact=drawn_dome(None),
        geometry="dome",
    )
    with tempfile.TemporaryDirectory() as folder:
        model = ObjectRecogniser().fit(touches).save(Path(folder) / "m.palpate")
        sensor = ReplaySensor(touches, rate_hz=_OFFERED_HZ, hold=4, gap=4)
        session = LiveSession(sensor, model=model)
        app = create_app(session, "bench")
        with PageServer().running(app, log_level="error") as address:
            socket = f"{address.replace('http', 'ws')}ws?token=bench"
            with connect(socket, max_size=None) as page:
                page.recv()
                return _page_rows(page, seconds)


def _page_rows(page: Any, seconds: float) -> list[Row]:
    """Count frames, bytes and touches that reach a client in some seconds."""
    n_frames, n_bytes = 0, 0
    to_belief_ms: list[float] = []
    began_s, began_cpu_s = time.monotonic(), time.process_time()
    while (left_s := began_s + seconds - time.monotonic()) > 0:
        try:
            message = page.recv(timeout=left_s)
        except TimeoutError:
            break
        if isinstance(message, bytes):
            n_frames, n_bytes = n_frames + 1, n_bytes + len(message)
            continue
        event = json.loads(message)
        if event["kind"] == "touch":
            touch = event["episode"]["touches"][-1]
            transit_ms = 1e3 * (time.time() - touch["time_s"])
            to_belief_ms.append(touch["latency_ms"] + transit_ms)
    taken_s, cpu_s = time.monotonic() - began_s, time.process_time() - began_cpu_s
    n_counted, latencies_ms = max(1, n_frames), to_belief_ms or [float("nan")]
    streamed: Row = {"frames_per_s": n_frames / taken_s}
    streamed["kib_per_frame"] = n_bytes / n_counted / 1024
    frame, touched = (f"{_STREAM} {what} page" for what in _WAYS)
    median, n_touches = float(np.median(latencies_ms)), len(to_belief_ms)
    return [
        _alone(f"{frame} wall", 1e3 * taken_s / n_counted, **streamed),
        _alone(f"{frame} cpu", 1e3 * cpu_s / n_counted),
        _alone(f"{touched} median", median, n_touches=n_touches),
        _alone(f"{touched} greatest", float(max(latencies_ms))),
    ]


def _array_row(seconds: float) -> Row:
    """Follow a 16 x 16 array at 100 Hz and count what is lost."""
    from palpate.sensors import ReplaySensor, TouchDetector

    images = np.random.default_rng(0).integers(0, 255, (20, 16, 16)).astype(np.uint8)
    sensor = ReplaySensor(Touches(images), rate_hz=100, hold=5, gap=5)
    detector = TouchDetector(sensor.no_contact())
    n_frames = n_touches = 0
    with sensor:
        began_s, began_cpu_s = time.monotonic(), time.process_time()
        while time.monotonic() - began_s < seconds:
            n_touches += detector.update(sensor.read_next()) is not None
            n_frames += 1
        cpu_s = time.process_time() - began_cpu_s
        return _alone(
            "16 x 16 uint8 array 100 Hz frame cpu",
            1e3 * cpu_s / n_frames,
            frames_per_s=n_frames / (time.monotonic() - began_s),
            n_lost=sensor.n_dropped,
            n_touches=n_touches,
        )


def bench_learning(
    n_objects: int = 10, n_each: int = 60, many: int = 50, many_each: int = 90
) -> list[Row]:
    """Measure learning and adding, CPU time, and the page's next lesson, by the clock.

    Each once: learning takes seconds, and is as long the second time.
    """
    with one_thread():
        few = drawn_touches(n_objects, n_each)
        rows = [_learnt(few, n_objects, n_each)]
        touches = drawn_touches(many, many_each)
        rows.append(_learnt(touches, many, many_each))
        return [*rows, *_added(touches), _lesson(drawn_touches(6, 12))]


def drawn_touches(
    n_objects: int, n_each: int, seed: int = 0, *, small: bool = True
) -> Touches:
    """Draw touches of objects whose dents differ, `small` ones of 120 x 120 pixels."""
    import cv2

    rng = np.random.default_rng(seed)
    numbers = np.repeat(np.arange(n_objects), n_each)
    sizes = [(20.0 + 7 * (n % 10), 20.0 + 12 * (n // 10 % 9)) for n in numbers]
    images: list[Array] = [drawn_dome(rng, size) for size in sizes]
    if small:
        shrink = partial(cv2.resize, dsize=(120, 120), interpolation=cv2.INTER_AREA)
        images = [shrink(image[:, 80:560]) for image in images]
    names = [f"object {n:04d}" for n in numbers]
    return Touches(np.stack(images), object=names, geometry="dome")


def _cpu_once(function: Callable[[], object]) -> float:
    return 1e3 * timeit(function, timer=process_time, number=1)


def _learnt(touches: Touches, n_objects: int, n_each: int) -> Row:
    from sklearn.decomposition import PCA
    from sklearn.pipeline import make_pipeline
    from sklearn.svm import SVC

    pixels = touches.images.reshape(len(touches), -1) / 255.0
    peer = make_pipeline(PCA(0.95, svd_solver="full"), SVC(C=100))
    ours = _cpu_once(lambda: ObjectRecogniser().fit(touches))
    theirs = _cpu_once(lambda: peer.fit(pixels, touches.object))
    name = f"learning {n_objects} objects x {n_each} touches 120 x 120 default"
    return row(name, ours, "scikit-learn PCA and SVC of pixels", theirs)


def _added(touches: Touches) -> list[Row]:
    """Add ten touches to an object, then an object, beside learning with the same."""
    names = np.unique(touches.columns["object"])
    first = np.flatnonzero(touches.columns["object"] == names[0])
    last = np.flatnonzero(touches.columns["object"] == names[-1])
    before = np.setdiff1d(np.arange(len(touches)), [*first[-10:], *last])
    recogniser = ObjectRecogniser().fit(touches[before])
    more, other = touches[first[-10:]], touches[last]
    tasks: dict[str, Callable[[ObjectRecogniser], object]] = {
        "adding ten touches": lambda r: r.extend_object(str(names[0]), more),
        f"adding an object of {len(last)} touches": lambda r: r.add_object(
            "new", other
        ),
    }
    rows = []
    for name, task in tasks.items():
        # A copy lacks the kept results that make adding quick.
        without = deepcopy(recogniser)
        quick, slow = (_cpu_once(partial(task, r)) for r in (recogniser, without))
        rows.append(row(f"{name} at {len(before)}", quick, "learning all again", slow))
    return rows


def _lesson(touches: Touches) -> Row:
    """Learn the library of the page again after one more lesson."""
    from palpate.web._learning import learn_in_process

    with tempfile.TemporaryDirectory() as folder:
        place, model = Path(folder) / "library", Path(folder) / "m.palpate"
        with TouchLibrary.open(place, create=True) as library:
            library.add(touches[:-1])
            first = wall_ms(lambda: learn_in_process(place, model, None))
            library.add(touches[-1:])
            again = wall_ms(lambda: learn_in_process(place, model, model))
    name = f"page learning again {len(touches)} touches wall"
    return row(name, again, "the first, whose process starts", first)
