"""The package imports lerobot, which has an environment of its own."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("lerobot") else ["lerobot_camera_palpate"]
