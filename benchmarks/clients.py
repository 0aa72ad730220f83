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
import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palpate import ObjectRecogniser, Touches
from palpate.sensors import RosSensor
from palpate.web import LiveSession, RosPublisher

HERE = Path(__file__).parent
ROBOT = HERE.parent / "tests" / "sensors" / "ros_robot.py"
DOMAIN, ENDPOINT = 140, "tcp/127.0.0.1:17448"
NETWORK = """<CycloneDDS><Domain id="any">
<General><AllowMulticast>false</AllowMulticast><Interfaces>
<NetworkInterface address="127.0.0.1"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
SIZES, RATES_HZ = ((120, 120), (480, 640)), (30, 120)


class CountedSensor(RosSensor):
    """Keeps the stamp of every frame that came through, in nanoseconds."""

    def _grab(self):
        readings = super()._grab()
        for reading in readings:
            header = self.header_at(reading.device_time_s)
            self.stamps.append(header.sec * 10**9 + header.nanosec)
        return readings


@contextmanager
def router():
    """What `ros2 run rmw_zenoh_cpp rmw_zenohd` starts."""
    import zenoh

    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"router"')
    configuration.insert_json5("listen/endpoints", json.dumps([ENDPOINT]))
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration):
        yield


def learn(shape, folder):
    """Return the file of a model of two ridges, of pictures of this size."""
    sys.path.insert(0, str(ROBOT.parent))
    from ros_robot import pressed

    path = folder / f"{shape[0]}x{shape[1]}.palpate"
    if not path.exists():
        rng = np.random.default_rng(0)
        kinds = ["rows", "columns"] * 8
        images = np.stack([pressed(rng, kind, shape) for kind in kinds])
        rest = np.full(shape, 60, np.uint8)
        touches = Touches(images, object=kinds, no_contact=rest)
        ObjectRecogniser().fit(touches).save(path)
    return path


@contextmanager
def robot(wire, **todo):
    """Start the robot; yield its process."""
    todo = {"via": wire, "domain": DOMAIN, "endpoint": ENDPOINT, **todo}
    command = [sys.executable, str(ROBOT), json.dumps(todo)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def recognising(wire, model):
    """Run a live session on the robot's topic that publishes what it believes."""
    via = "zenoh" if wire == "zenoh" else "dds"
    sensor = CountedSensor("/pad", domain=DOMAIN, via=via)
    sensor.stamps = []
    with LiveSession(sensor, model=model) as session, ExitStack() as stack:
        session.take_baseline()
        publisher = RosPublisher(session, f"ros:/palpate?domain={DOMAIN}&via={via}")
        stack.callback(publisher.close)
        yield session


def measured(wire, rate_hz, shape, n_presses, model, program):
    """Return the row of one rate and size: frames lost, times to the belief."""
    kinds = ["rows", "columns"] * (n_presses // 2)
    todo = {"rate_hz": rate_hz, "shape": shape, "kinds": kinds, "program": program}
    with robot(wire, **todo) as process, recognising(wire, model) as session:
        sensor, before = session.watch.sensor, session.watch.sensor.n_dropped
        heard = json.loads(process.communicate(timeout=600)[0])
        stamps, n_dropped = {*sensor.stamps}, sensor.n_dropped - before
    sent = heard["sent"][heard["from"] :]
    pairs = zip(heard["belief"], heard["ends"], strict=False)  # or beliefs are wanting
    waits = [belief["at"] - end for belief, end in pairs]
    median, most = np.percentile(waits, [50, 99]) / 1e6 if waits else (np.nan,) * 2
    return {
        "frames": len(sent),
        "lost": len({*sent} - stamps) + n_dropped,
        "touches": n_presses,
        "beliefs": len(heard["belief"]),
        "median_ms": float(median),
        "p99_ms": float(most),
        "stamped": sum(one["stamp"] in stamps for one in heard["belief"]),
    }


def restarted(wire, model, program):
    """Return how many beliefs a robot hears that comes after one that was killed."""
    todo = {"shape": SIZES[0], "rate_hz": 60, "program": program}
    with ExitStack() as stack:
        first = stack.enter_context(robot(wire, kinds=["rows"] * 99, **todo))
        session = stack.enter_context(recognising(wire, model))
        await_(lambda: len(session.episode.touches) >= 2)
        first.kill()
        first.wait()
        await_(lambda: bool(session.watch.sensor.lost))
        second = stack.enter_context(robot(wire, kinds=["rows"] * 4, **todo))
        heard = json.loads(second.communicate(timeout=120)[0])
        # The first's last press may end with the second's first frame.
        return sum(one["stamp"] in heard["sent"] for one in heard["belief"])


def resized(wire, model, program):
    """Return what is said of a topic that changes its size; no frame may be wrong."""
    todo = {"shape": SIZES[0], "rate_hz": 60, "program": program}
    with (
        robot(wire, kinds=["rows"] * 3, other_shape=(60, 60), **todo) as process,
        recognising(wire, model) as session,
    ):
        heard = json.loads(process.communicate(timeout=120)[0])
        sensor = session.watch.sensor
        await_(lambda: sensor.n_dropped >= 30)
        late = {*heard["sent"][-35:-5]} & {*sensor.stamps}
        right = len(heard["belief"]) == 3 and not late
        return sensor.n_dropped if right else 0


def await_(ready, limit_s=60.0):
    """Wait until something is so; give up after a while."""
    end_s = time.monotonic() + limit_s
    while not ready() and time.monotonic() < end_s:
        time.sleep(0.02)


def check(wire, n_presses, folder, program):
    """Print the rows of one wire; return whether all is right."""
    right = True
    for shape in SIZES:
        model = learn(shape, folder)
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
    n_beliefs = restarted(wire, learn(SIZES[0], folder), program)
    print(f"{wire}: killed and restarted: {n_beliefs} of 4 beliefs", flush=True)
    n_refused = resized(wire, learn(SIZES[0], folder), program)
    print(f"{wire}: another size: {n_refused} of 30 frames refused", flush=True)
    return right and n_beliefs == 4 and n_refused == 30


def main():
    """Check every wire that is installed; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=60)
    parser.add_argument("--wires", nargs="*", default=["dds", "zenoh"])
    parser.add_argument("--fastdds", default="", help="program of fastdds_wire.cpp")
    options = parser.parse_args()
    os.environ["CYCLONEDDS_URI"] = NETWORK
    os.environ["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints=["{ENDPOINT}"]'
    wires = [*options.wires, *(["fastdds"] if options.fastdds else [])]
    print("| wire | size | Hz | frames lost | beliefs | median ms | 99 % ms |")
    print("|---|---|---|---|---|---|---|", flush=True)
    right = True
    with TemporaryDirectory() as folder:
        for wire in wires:
            with router() if wire == "zenoh" else nullcontext():
                right &= check(wire, options.presses, Path(folder), options.fastdds)
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
