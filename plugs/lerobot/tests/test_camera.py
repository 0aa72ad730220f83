"""A sensor of palpate is a camera of lerobot, and a camera of lerobot is a sensor."""

import json
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.sensors import SensorError, check_sensor

configs = pytest.importorskip("lerobot.cameras.configs")
utils = pytest.importorskip("lerobot.cameras.utils")
plugins = pytest.importorskip("lerobot.utils.import_utils")
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def replay(tmp_path):
    """Return the address of touches that are played, each for one frame."""

    def write(images, **columns):
        Touches(images, **columns).save(tmp_path / "t.npz")
        return f"replay:{tmp_path}/t.npz?rate=100&hold=1&gap=0"

    return write


def camera_of(**config):
    kind = configs.CameraConfig.get_choice_class("palpate")
    return utils.make_cameras_from_configs({"skin": kind(**config)})["skin"]


def test_lerobot_finds_the_camera_by_its_package():
    import lerobot_camera_palpate

    plugins.register_third_party_plugins()
    assert "palpate" in configs.CameraConfig.get_known_choices()
    assert "lerobot_camera_palpate" in sys.modules
    camera = camera_of(sensor="sim:mug?shape=48x64&rate=100")
    assert isinstance(camera, lerobot_camera_palpate.PalpateCamera)
    with camera:
        for image in (camera.read(), camera.async_read(2000), camera.read_latest()):
            assert image.shape == (48, 64, 3)
            assert image.dtype == np.uint8
            assert_array_equal(image[..., 0], image[..., 2])  # grey three times
    assert not camera.is_connected
    assert (camera.height, camera.width, camera.fps) == (48, 64, 100)


@pytest.mark.parametrize(
    ("images", "levels"),
    [
        ([[[0.0, 5.0, np.nan], [10.0, 20.0, -1.0]]], [[0, 128, 0], [255, 255, 0]]),
        (np.array([[[0, 5], [10, 20]]], np.uint8), [[0, 128], [255, 255]]),
    ],
)
def test_readings_become_levels(replay, images, levels):
    with camera_of(sensor=replay(images), low=0, high=10) as camera:
        image = camera.async_read(2000)
    assert image[..., 0].tolist() == levels


def test_colours_stay(replay):
    colours = np.random.default_rng(0).integers(0, 256, (1, 50, 60, 3), dtype=np.uint8)
    with camera_of(sensor=replay(colours, channels=["r", "g", "b"])) as camera:
        assert_array_equal(camera.async_read(2000), colours[0])


def test_odd_configurations_are_refused(replay):
    with pytest.raises(ValueError, match="height and width must be those of"):
        camera_of(sensor="sim:mug", height=3, width=4)
    with pytest.raises(ValueError, match="low must be below high"):
        camera_of(sensor="sim:mug", low=1, high=1)


def test_a_camera_of_lerobot_is_a_sensor():
    """The camera is our own, so that no device is needed."""
    sensor_of = pytest.importorskip("lerobot_camera_palpate.sensor").LeRobotSensor
    config = json.dumps({"sensor": "sim:mug?shape=48x64&rate=100"})
    check_sensor(sensor_of("palpate", image_shape=(48, 64), config=config))
    with pytest.raises(SensorError, match=r"must be one of .*opencv.*palpate"):
        sensor_of("nothing", image_shape=(48, 64)).connect()
    with pytest.raises(ValueError, match="must be a JSON object, got 'x'"):
        sensor_of("palpate", image_shape=(48, 64), config="x")
    missing = sensor_of("opencv", image_shape=(9, 9), config='{"index_or_path": 99}')
    with pytest.raises(SensorError, match="cannot be opened"):
        missing.connect()
