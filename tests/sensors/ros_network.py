"""A network of its own for both wires of ROS 2, and the robot on it, another process.

For tests, those of `plugs/ros` too, and for `benchmarks/clients.py`.
"""

import atexit
import json
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from ros_robot import pressed

from palpate import ObjectRecogniser, Touches

ROBOT = Path(__file__).with_name("ros_robot.py")
N_NUMBERS, FIRST_PORT = 50, 17_700
LOOPBACK = """<CycloneDDS><Domain id="any">
<General><AllowMulticast>false</AllowMulticast><Interfaces>
<NetworkInterface address="127.0.0.1"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


def own_number():
    """Take a number that no other process of this machine has while this one lives.

    Domains and endpoints follow from it: processes of one number would hear each other,
    whether they are of one run of the tests or of two.
    """
    for number in range(N_NUMBERS):
        reserved = socket.socket()
        try:
            reserved.bind(("127.0.0.1", FIRST_PORT + number))
        except OSError:
            reserved.close()
            continue
        atexit.register(reserved.close)
        return number
    raise RuntimeError(f"{N_NUMBERS} processes of tests run on this machine already.")


NUMBER = own_number()


def variables(endpoint=""):
    """Return the environment of what meets at this endpoint, and on the loopback."""
    return {
        "CYCLONEDDS_URI": LOOPBACK,
        "ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["{endpoint}"]',
        "ZENOH_SESSION_CONFIG_URI": "",
    }


@contextmanager
def router(endpoint):
    """Route as `ros2 run rmw_zenoh_cpp rmw_zenohd` does; yield the router's session."""
    import zenoh

    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"router"')
    configuration.insert_json5("listen/endpoints", json.dumps([endpoint]))
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration) as session:
        yield session


@contextmanager
def robot(**todo):
    """Start the robot; yield its process."""
    command = [sys.executable, str(ROBOT), json.dumps(todo)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def heard_by(process, limit_s=120):
    """Wait for a robot to be done; return what it sent and heard."""
    return json.loads(process.communicate(timeout=limit_s)[0])


def learn(path, kinds=("rows",) * 16 + ("columns",) * 16, shape=(12, 12)):
    """Write a model of ridges along rows and along columns, of the robot's own pad."""
    rng = np.random.default_rng(0)
    images = np.stack([pressed(rng, kind, shape) for kind in kinds])
    rest = np.full(shape, 60, np.uint8)
    touches = Touches(images, object=list(kinds), no_contact=rest)
    return ObjectRecogniser().fit(touches).save(path)


def eventually(is_so, limit_s=10.0):
    """Wait until something is so, not longer; return whether it is."""
    end_s = time.monotonic() + limit_s
    while not is_so() and time.monotonic() < end_s:
        time.sleep(0.02)
    return is_so()
