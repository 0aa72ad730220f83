"""Time of learning, and of adding to what was learnt, beside a plain SVM.

The touches are drawn: discs of objects with dents of their own, 120 pixels a side. What
is measured is time, not recognition.
"""

import tempfile
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from pathlib import Path
from time import process_time
from timeit import timeit

import numpy as np

from .._types import Array
from ..library import TouchLibrary
from ..recognition import ObjectRecogniser
from ..touches import Touches
from ._timing import Row, drawn_dome, one_thread, row, wall_ms


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
    ways: dict[str, Callable[[ObjectRecogniser], object]] = {
        "adding ten touches": lambda r: r.extend_object(str(names[0]), more),
        f"adding an object of {len(last)} touches": lambda r: r.add_object(
            "new", other
        ),
    }
    rows = []
    for name, way in ways.items():
        without = deepcopy(recogniser)  # of which what makes adding quick is not part
        quick, slow = (_cpu_once(partial(way, r)) for r in (recogniser, without))
        rows.append(row(f"{name} at {len(before)}", quick, "learning all again", slow))
    return rows


def _lesson(touches: Touches) -> Row:
    """Learn what the page's library holds after one more lesson."""
    from ..web._learning import learn_apart

    with tempfile.TemporaryDirectory() as folder:
        place, model = Path(folder) / "library", Path(folder) / "m.palpate"
        with TouchLibrary.open(place, create=True) as library:
            library.add(touches[:-1])
            first = wall_ms(lambda: learn_apart(place, model, None))
            library.add(touches[-1:])
            again = wall_ms(lambda: learn_apart(place, model, model))
    name = f"page learning again {len(touches)} touches wall"
    return row(name, again, "the first, whose process starts", first)
