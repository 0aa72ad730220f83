"""A world without a simulator: a springy ball before an exact arm.

Everything about it is known on paper: the tip touches at `radius_mm` from the middle
and meets `stiffness_n_mm` beyond. Run as a program it gathers touches into a folder,
and prints the number of each once it is recorded, until it is killed.
"""

import sys
import time

import numpy as np

from palpate.exploration import Hemisphere, RandomHemisphere, gather


class BallArm:
    """An arm with a nearly quiet force sensor; remembers all that it did."""

    def __init__(self, radius_mm=40.0, stiffness_n_mm=0.2, delay_s=0.0):
        self.radius_mm, self.stiffness_n_mm = radius_mm, stiffness_n_mm
        self.delay_s = delay_s
        self.pose = Hemisphere().pose(0.0, 1.5)
        self.visited, self.retracts_mm = [], []
        self.stopped = False
        self.n_read = 0

    @property
    def force_n(self):
        distance = float(np.linalg.norm(self.pose.position_mm))
        return self.stiffness_n_mm * max(self.radius_mm - distance, 0.0)

    def move_to(self, pose):
        time.sleep(self.delay_s)
        self.pose = pose
        self.visited.append(pose)

    def read_pose(self):
        return self.pose

    def read_force(self):
        self.n_read += 1
        return self.force_n + 1e-6 * (self.n_read % 7)

    def retract(self, way_mm):
        self.retracts_mm.append(way_mm)
        self.pose = self.pose.advanced(-way_mm)

    def stop(self):
        self.stopped = True


class BallSensor:
    """Shows the direction from which the ball is touched, in 3 x 3 numbers."""

    image_shape = (3, 3)
    geometry = "none"

    def __init__(self, arm=None):
        self.arm = BallArm() if arm is None else arm

    def read(self):
        direction = np.asarray(self.arm.pose.direction)
        return np.outer(direction, direction)

    def no_contact(self):
        return None


class SlowlySure:
    """A recogniser and its belief: sure of "ball" after a number of touches."""

    def __init__(self, after=10**9, answer="ball", refusal=None):
        self.after, self.answer, self.refusal = after, answer, refusal
        self.images = []

    def start(self):
        return type(self)(self.after, self.answer, self.refusal)

    def update(self, touches):
        self.images.extend(touches.images)

    def decide(self, error, refusal):
        assert refusal == self.refusal
        return self.answer if len(self.images) >= self.after else None

    def reason(self, error, refusal):
        assert refusal == self.refusal
        return f"{len(self.images)} touches seen."


def main(folder, n_touches, delay_s):
    arm = BallArm(delay_s=float(delay_s))
    strategy = Announcing(Hemisphere(radius_mm=100), 5)
    gather(arm, BallSensor(arm), strategy, folder, n_touches=int(n_touches))
    print("done", flush=True)


class Announcing(RandomHemisphere):
    """Prints how many attempts are recorded whenever it chooses the next."""

    def next_pose(self, belief, history):
        print(len(history), flush=True)
        return super().next_pose(belief, history)


if __name__ == "__main__":
    main(*sys.argv[1:])
