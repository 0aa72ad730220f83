"""What a robot on ROS 2's wires gets of palpate: frames lost, from stamp to belief.

`python benchmarks/clients.py` (`make check-clients`): over DDS, zenoh and, where
`--fastdds PROGRAM` names what was made of `fastdds_wire.cpp`, Fast DDS, another process
(`tests/sensors/ros_robot.py`) presses a pad and hears beliefs, at 30 and 120 Hz, 120 x
120 and 640 x 480; then it is killed and comes back, and its topic changes its size. The
time is from the stamp of the first frame after a press, which ends the touch, until
the robot has the belief. Exit code 1 where a belief is wanting or more than 1 % of the
frames, which are published best effort, are lost.
"""

import argparse
import os
import sys
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palpate.sensors._ros import RosSensor
from palpate.web import LiveSession

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "sensors"))
from ros_network import eventually, heard_by, learn, robot, router, variables

DOMAIN, ENDPOINT = 140, "tcp/127.0.0.1:17448"
SIZES, RATES_HZ = ((120, 120), (480, 640)), (30, 120)


class CountedSensor(RosSensor):
    """Keeps the stamp of every frame that came through, in nanoseconds."""

    def _grab(self):
        readings = super()._grab()
        for reading in readings:
            header = self.header_at(reading.device_time_s)
            self.stamps.append(header.sec * 10**9 + header.nanosec)
        return readings


def learnt(shape, folder):
    """Return the file of a model of two ridges, of pictures of this size."""
    path = folder / f"{shape[0]}x{shape[1]}.palpate"
    return path if path.exists() else learn(path, ("rows", "columns") * 8, shape)


def pressing(wire, **todo):
    """Start the robot on a wire; yield its process."""
    return robot(via=wire, domain=DOMAIN, endpoint=ENDPOINT, **todo)


@contextmanager
def recognising(wire, model):
    """Run a live session on the robot's topic that publishes its beliefs."""
    via = "zenoh" if wire == "zenoh" else "dds"
    sensor = CountedSensor("/pad", domain=DOMAIN, via=via)
    sensor.stamps = []
    with LiveSession(sensor, model=model) as session, ExitStack() as stack:
        session.take_baseline()
        publisher = session.publish(f"ros:/palpate?domain={DOMAIN}&via={via}")
        stack.callback(publisher.close)
        yield session


def measured(wire, rate_hz, shape, n_presses, model, program):
    """Return the row of one rate and size: frames lost, times to the belief."""
    kinds = ["rows", "columns"] * (n_presses // 2)
    todo = {"rate_hz": rate_hz, "shape": shape, "kinds": kinds, "program": program}
    with pressing(wire, **todo) as process, recognising(wire, model) as session:
        sensor, before = session.watch.sensor, session.watch.sensor.n_dropped
        log = heard_by(process, 600)
        stamps, n_dropped = {*sensor.stamps}, sensor.n_dropped - before
    sent = log["sent"][log["from"] :]
    pairs = zip(log["belief"], log["ends"], strict=False)  # or beliefs are wanting
    waits = [belief["at"] - end for belief, end in pairs]
    median, most = np.percentile(waits, [50, 99]) / 1e6 if waits else (np.nan,) * 2
    return {
        "frames": len(sent),
        "lost": len({*sent} - stamps) + n_dropped,
        "touches": n_presses,
        "beliefs": len(log["belief"]),
        "median_ms": float(median),
        "p99_ms": float(most),
        "stamped": sum(belief["stamp"] in stamps for belief in log["belief"]),
    }


def restarted(wire, model, program):
    """Return how many beliefs a robot gets that follows one that was killed."""
    todo = {"shape": SIZES[0], "rate_hz": 60, "program": program}
    with ExitStack() as stack:
        first = stack.enter_context(pressing(wire, kinds=["rows"] * 99, **todo))
        session = stack.enter_context(recognising(wire, model))
        eventually(lambda: len(session.episode.touches) >= 2, 60)
        first.kill()
        first.wait()
        eventually(lambda: session.watch.sensor.lost, 60)
        second = stack.enter_context(pressing(wire, kinds=["rows"] * 4, **todo))
        log = heard_by(second)
        # The first's last press may end with the second's first frame.
        return sum(belief["stamp"] in log["sent"] for belief in log["belief"])


def resized(wire, model, program):
    """Return the frames dropped of a topic that changes its size; none may be wrong."""
    todo = {"shape": SIZES[0], "rate_hz": 60, "program": program}
    with (
        pressing(wire, kinds=["rows"] * 3, other_shape=(60, 60), **todo) as process,
        recognising(wire, model) as session,
    ):
        log = heard_by(process)
        sensor = session.watch.sensor
        eventually(lambda: sensor.n_dropped >= 30, 60)
        late = {*log["sent"][-35:-5]} & {*sensor.stamps}
        right = len(log["belief"]) == 3 and not late
        return sensor.n_dropped if right else 0


def check(wire, n_presses, folder, program):
    """Print the rows of one wire; return whether all is right."""
    right = True
    for shape in SIZES:
        model = learnt(shape, folder)
        for rate_hz in RATES_HZ:
            row = measured(wire, rate_hz, shape, n_presses, model, program)
            size = f"{shape[1]} x {shape[0]}"
            print(
                f"| {wire} | {size} | {rate_hz} | {row['lost']} of {row['frames']} | "
                f"{row['beliefs']} of {row['touches']} | {row['median_ms']:.1f} | "
                f"{row['p99_ms']:.1f} |",
                flush=True,
            )
            whole = 100 * row["lost"] <= row["frames"]
            whole &= row["stamped"] == row["beliefs"]
            right &= whole and row["beliefs"] == row["touches"]
    n_beliefs = restarted(wire, learnt(SIZES[0], folder), program)
    print(f"{wire}: killed and restarted: {n_beliefs} of 4 beliefs", flush=True)
    n_refused = resized(wire, learnt(SIZES[0], folder), program)
    print(f"{wire}: another size: {n_refused} of 30 frames refused", flush=True)
    return right and n_beliefs == 4 and n_refused == 30


def main():
    """Check every wire that is installed; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=60)
    parser.add_argument("--wires", nargs="*", default=["dds", "zenoh"])
    parser.add_argument("--fastdds", default="", help="program of fastdds_wire.cpp")
    options = parser.parse_args()
    os.environ.update(variables(ENDPOINT))
    wires = [*options.wires, *(["fastdds"] if options.fastdds else [])]
    print("| wire | size | Hz | frames lost | beliefs | median ms | 99 % ms |")
    print("|---|---|---|---|---|---|---|", flush=True)
    right = True
    with TemporaryDirectory() as folder:
        for wire in wires:
            with router(ENDPOINT) if wire == "zenoh" else nullcontext():
                right &= check(wire, options.presses, Path(folder), options.fastdds)
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
