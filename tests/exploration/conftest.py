"""The ball world, and touches of three objects by the simulated arm."""

import pytest
from ball_world import BallArm, BallSensor

from palpate.exploration import explore_to_learn
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, find_object


@pytest.fixture
def arm():
    return BallArm()


@pytest.fixture
def sensor(arm):
    return BallSensor(arm)


@pytest.fixture(scope="session")
def taught():
    """Touches of a box, a mug and a pen, put down six times, on all their faces."""
    things = [find_object(name) for name in ("box", "mug", "pen")]
    camera = DomeCamera(image_shape=(48, 48), n_nodes=24)
    return explore_to_learn(things, 36, camera, n_sessions=6, faces="all")


@pytest.fixture(scope="session")
def recogniser(taught):
    return ObjectRecogniser(rehearse=False).fit(taught)
