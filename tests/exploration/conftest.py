"""The ball world for every test of exploration."""

import importlib.util
from pathlib import Path

import pytest

WORLD = Path(__file__).with_name("ball_world.py")


@pytest.fixture(scope="session")
def world():
    """The module `ball_world`."""
    spec = importlib.util.spec_from_file_location("ball_world", WORLD)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def arm(world):
    return world.BallArm()


@pytest.fixture
def sensor(world, arm):
    return world.BallSensor(arm)
