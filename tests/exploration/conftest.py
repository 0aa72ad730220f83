"""The ball world for every test of exploration."""

import ball_world
import pytest


@pytest.fixture(scope="session")
def world():
    """The module `ball_world`."""
    return ball_world


@pytest.fixture
def arm(world):
    return world.BallArm()


@pytest.fixture
def sensor(world, arm):
    return world.BallSensor(arm)
