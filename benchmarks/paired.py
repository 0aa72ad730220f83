"""The speed of two revisions in one run: `paired.py BEFORE AFTER [--rounds 5]`.

    PALPATE_DATA=../data python benchmarks/paired.py v0.1.0 HEAD

Every program runs in a fresh process, on one thread, in turn with both revisions; who
goes first changes from round to round. Printed are CPU and wall time of each, and the
ratio after / before of each round: its median and its least and largest value. Without
PALPATE_DATA the recorded touches are drawn ones.
"""

import argparse
import json
import os
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from revisions import check_where, checked_out, python

N_PICTURES = 30
DRAWN_SHAPE = (480, 640)


def main() -> None:
    """Measure every program and print the table; JSON goes where it is asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before")
    parser.add_argument("after", nargs="?", help="default: the tree as it is")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", help=f"of {', '.join([*INSIDE, *WHOLE])}")
    parser.add_argument("--json", type=Path, help="write the times here too")
    options = parser.parse_args()
    names = options.only.split(",") if options.only else [*INSIDE, *WHOLE]
    with (
        checked_out(options.before) as before,
        checked_out(options.after) as after,
        tempfile.TemporaryDirectory() as folder,
    ):
        for root in (before, after):
            check_where(root)
        roots = {"before": before, "after": after}
        if {"latency", "files"} & {*names}:
            draw(Path(folder))
        if "latency" in names:
            prepared(roots, Path(folder))
        rows = {
            name: paired(name, roots, Path(folder), options.rounds) for name in names
        }
    show(rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def prepared(roots: dict[str, Path], folder: Path) -> None:
    """Learn 50 drawn objects with each revision."""
    for name, root in roots.items():
        print(f"learning 50 objects ({name})...", file=sys.stderr, flush=True)
        command = ["learn", "drawn.npz", "-o", f"{name}.palpate", "--json"]
        python(root, "-m", "palpate", *command, folder=folder)


def paired(
    name: str, roots: dict[str, Path], folder: Path, rounds: int
) -> dict[str, list[dict[str, float]]]:
    """Run one program in turn with both revisions; the first round is left out."""
    print(f"{name}...", file=sys.stderr, flush=True)
    times: dict[str, list[dict[str, float]]] = {"before": [], "after": []}
    for number in range(rounds + 1):
        order = ["before", "after"] if number % 2 else ["after", "before"]
        for which in order:
            seconds = measured(name, which, roots[which], folder)
            if number:
                times[which].append(seconds)
    return times


def measured(name: str, which: str, root: Path, folder: Path) -> dict[str, float]:
    """Return the seconds of one run: of the whole process, or as it measured itself."""
    if name in INSIDE:
        here = Path(__file__).resolve()
        output = python(root, here, "--inside", name, f"{which}.palpate", folder=folder)
        return json.loads(output)
    usage, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    python(root, *WHOLE[name], folder=folder)
    used, elapsed = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    cpu = used.ru_utime + used.ru_stime - usage.ru_utime - usage.ru_stime
    return {"cpu": cpu, "wall": elapsed - wall}


def show(rows: dict[str, dict[str, list[dict[str, float]]]]) -> None:
    """Print a line per program and clock."""
    print(
        f"{'program':12s} {'clock':5s} {'before':>10s} {'after':>10s}  after / before"
    )
    for name, times in rows.items():
        for clock in ("cpu", "wall"):
            old, new = (
                [seconds[clock] for seconds in times[w]] for w in ("before", "after")
            )
            ratios = [b / a for a, b in zip(old, new, strict=True)]
            print(
                f"{name:12s} {clock:5s} {1e3 * statistics.median(old):7.1f} ms "
                f"{1e3 * statistics.median(new):7.1f} ms  "
                f"{statistics.median(ratios):.3f} ({min(ratios):.3f}-{max(ratios):.3f})"
            )


def clocked(work: Callable[[], Any]) -> dict[str, float]:
    """Return CPU and wall seconds of a piece of work."""
    cpu, wall = time.process_time(), time.perf_counter()
    work()
    return {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall}


def learning(_: str) -> dict[str, float]:
    """Learn 60 touches of each of 10 objects with the preset `default`."""
    from palpate.recognition import ObjectRecogniser

    touches = recorded(n_objects=10, n_each=60)
    return clocked(lambda: ObjectRecogniser("default").fit(touches))


def learning_50(_: str) -> dict[str, float]:
    """Learn up to 90 touches of each of 50 objects with the preset `default`."""
    from palpate.recognition import ObjectRecogniser

    touches = recorded(n_objects=50, n_each=90)
    return clocked(lambda: ObjectRecogniser("default").fit(touches))


def adding(_: str) -> dict[str, float]:
    """Add ten touches to one of 50 objects of 3,900 touches in all."""
    from palpate.recognition import ObjectRecogniser

    touches = recorded(n_objects=50, n_each=100)
    object_rows = np.flatnonzero(touches.object == touches.object[0])
    others = np.delete(np.arange(len(touches)), object_rows[-10:])
    recogniser = ObjectRecogniser("default").fit(touches[others])
    name, more = str(touches.object[0]), touches[object_rows[-10:]]
    return clocked(lambda: recogniser.extend_object(name, more))


def rim(_: str) -> dict[str, float]:
    """Find the rim of 60 pictures of 480 x 640, of which a typical one is known."""
    from palpate.images import find_rims, typical_rim

    images = drawn(60, 1, DRAWN_SHAPE, seed=1)[0]
    near = typical_rim(images)
    return clocked(lambda: find_rims(images, near=near))


def hu(_: str) -> dict[str, float]:
    """Take Hu's moments of 60 discs of 480 x 480."""
    from palpate.encodings import HuMoments

    discs = drawn(60, 1, (480, 480), seed=1)[0].astype(np.float32)
    encoder = HuMoments().fit(discs)
    return clocked(lambda: encoder.transform(discs))


def files(_: str) -> dict[str, float]:
    """Read 200 recorded JPEGs of 640 x 480, or the drawn ones again and again."""
    from palpate.touches import decode_bytes

    source = Path(os.environ.get("PALPATE_DATA", "")) / "bathtip" / "originals"
    paths = sorted(source.glob("*/*/*.jpg")) or sorted(Path("pictures").iterdir())
    coded = [path.read_bytes() for path in (paths * 200)[:200]]
    decode_bytes(coded[0])  # imports the decoder
    return clocked(lambda: [decode_bytes(data) for data in coded])


def recorded(n_objects: int, n_each: int) -> Any:
    """Return touches of the recorded dome, or drawn ones where it is not there."""
    from palpate import Touches

    source = Path(os.environ.get("PALPATE_DATA", "")) / "bathtip" / "bathtip50.npz"
    if not source.exists():
        images, objects = drawn(n_objects, n_each, (120, 120), seed=2)
        return Touches(images, object=objects)
    touches = Touches.load(source)
    objects = np.asarray(touches.columns["object"])
    names = sorted(set(objects))[:: 50 // n_objects]
    rows = [np.flatnonzero(objects == name)[:n_each] for name in names]
    return touches[np.concatenate(rows)]


def latency(model: str) -> dict[str, float]:
    """Return the median over pictures: 640 x 480 JPEG in memory -> belief over 50."""
    from palpate import Touches
    from palpate.recognition import ObjectRecogniser
    from palpate.touches import decode_bytes

    recogniser = ObjectRecogniser.load(model)
    pictures = [path.read_bytes() for path in sorted(Path("pictures").iterdir())]

    def recognise(picture: bytes) -> None:
        belief = recogniser.start()
        belief.update(Touches(decode_bytes(picture)[np.newaxis]))
        belief.posterior  # noqa: B018

    for picture in pictures[:3]:
        recognise(picture)
    times = [clocked(lambda p=picture: recognise(p)) for picture in pictures]
    return {
        clock: statistics.median(seconds[clock] for seconds in times)
        for clock in ("cpu", "wall")
    }


def kernels(_: str) -> dict[str, float]:
    """Learn 30 vectors of 20 features of each of 3 classes with `MKLSVC`."""
    from palpate.classifiers import MKLSVC

    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(3), 30)
    features = rng.normal(size=(90, 20)) + rng.normal(size=(3, 20))[labels] * 0.7
    return clocked(lambda: MKLSVC().fit(features, labels))


def kernels_66(_: str) -> dict[str, float]:
    """Learn 66 pairs of 20 touches from 22 kernel matrices, C = 1 and 100, 20 times."""
    from palpate.classifiers import MKLSVC
    from palpate.classifiers.mkl import kernel_diagonals, paper_kernels
    from palpate.classifiers.mkl._kernels import kernel_stack

    rng = np.random.default_rng(0)
    codes = np.repeat(np.arange(12), 10)
    touches = 0.5 * rng.normal(size=(12, 20))[codes] + rng.normal(size=(120, 20))
    bank, zero = paper_kernels(), np.zeros(20)
    stack = kernel_stack(bank, touches, touches, zero)
    stack /= kernel_diagonals(bank, touches, zero).sum(axis=1)[:, None, None]
    kernel_matrices = np.ascontiguousarray(stack.transpose(1, 2, 0))
    machines = [
        MKLSVC(C=C, kernels="precomputed", probability=False) for C in (1.0, 100.0)
    ]
    machines[0].fit(kernel_matrices, codes)
    return clocked(
        lambda: [machine.fit(kernel_matrices, codes) for machine in machines * 20]
    )


def landmarks(_: str) -> dict[str, float]:
    """Learn 100,000 touches of 2 classes by `MKLSVC`, 4 kernels, 200 landmarks."""
    from palpate.classifiers import MKLSVC, GaussianKernel

    rng = np.random.default_rng(0)
    codes = rng.integers(2, size=100_000)
    touches = rng.normal(size=(len(codes), 20)) + 0.5 * np.eye(2, 20)[codes]
    bank = [GaussianKernel(sigma) for sigma in (2.0, 4.0, 8.0, 16.0)]
    machine = MKLSVC(C=1e5, kernels=bank, probability=False, random_state=0)
    return clocked(lambda: machine.fit(touches, codes))


def dome(side: int) -> dict[str, float]:
    """Press a simulated dome of `side` x `side` pixels on household things."""
    from palpate import simulation

    camera = simulation.DomeCamera(image_shape=(side, side))
    rng, approaches = np.random.default_rng(0), []
    for thing in simulation.HOUSEHOLD[:10]:  # those that every revision has
        placed = simulation.PlacedObject.resting(thing)
        for outward in rng.normal(size=(6, 3)):
            outward[2] = abs(outward[2])
            outward /= np.linalg.norm(outward)
            goal = placed.centre_mm + rng.normal(0, 5, 3)
            pose = simulation.SensorPose(goal + 300 * outward, -outward)
            approaches.append((placed, pose))
    for approach in approaches[::6]:
        camera.touch(*approach, rng=rng)
    return clocked(
        lambda: [camera.touch(*approach, rng=rng) for approach in approaches * 3]
    )


def draw(folder: Path) -> None:
    """Write 12 touches of each of 50 objects, and pictures of other touches."""
    import cv2

    images, objects = drawn(50, 12, DRAWN_SHAPE, seed=0)
    np.savez(folder / "drawn.npz", images=images, object=objects)
    (folder / "pictures").mkdir()
    for number, image in enumerate(drawn(N_PICTURES, 1, DRAWN_SHAPE, seed=1)[0]):
        cv2.imwrite(str(folder / "pictures" / f"{number:03d}.jpg"), image)


def drawn(n_objects: int, n_each: int, shape: tuple[int, int], seed: int) -> Any:
    """Return (images, labels): bright discs with a rim and an object's own dents."""
    rng = np.random.default_rng(seed)
    row, col = (np.arange(n, dtype=np.float32) for n in shape)
    radius = 0.45 * min(shape)
    images = np.empty((n_objects * n_each, *shape), np.uint8)
    for number in range(len(images)):
        object_rng = np.random.default_rng([9, number // n_each])
        y, x = np.array(shape) / 2 + rng.uniform(-3, 3, 2)
        distance = np.hypot(row[:, np.newaxis] - y, col - x)
        image = np.where(distance < radius, 120.0, 10.0) * (
            1 - 0.3 * (distance / radius) ** 2
        )
        for _ in range(3):
            dy, dx = object_rng.uniform(-0.4, 0.4, 2) * radius + rng.normal(0, 4, 2)
            width = object_rng.uniform(0.05, 0.2) * radius
            away2 = (row[:, np.newaxis] - y - dy) ** 2 + (col - x - dx) ** 2
            image += 80 * np.exp(-away2 / (2 * width**2)) * (distance < radius)
        noise = rng.normal(0, 2, shape)
        images[number] = np.clip(image + noise, 0, 255)
    return images, np.repeat([f"object {n:02d}" for n in range(n_objects)], n_each)


INSIDE = {
    "learning": learning,
    "learning 50": learning_50,
    "adding": adding,
    "latency": latency,
    "rim": rim,
    "hu": hu,
    "files": files,
    "MKLSVC": kernels,
    "MKLSVC 66": kernels_66,
    "landmarks": landmarks,
    "dome 150": lambda _: dome(150),
    "dome 300": lambda _: dome(300),
}
WHOLE: dict[str, list[str]] = {
    "import": ["-c", "import palpate.recognition"],
    "--help": ["-m", "palpate", "--help"],
}

if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        print(json.dumps(INSIDE[sys.argv[2]](sys.argv[3])))
    else:
        main()
