"""Calibrations as JSON files: small, readable, and with nothing to execute."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._types import Floats

_FORMAT, _VERSION = "palpate taxel calibration", 1
_NUMBERS = ("gain", "offset", "noise", "dead_zone_kpa", "saturation_kpa")
LEARNT = (*_NUMBERS, "dead", "image_shape", "highest_load_kpa")


def write_calibration(
    path: str | Path, params: dict[str, Any], learnt: dict[str, Any]
) -> None:
    """Write parameters and learnt values; null stands for NaN and infinity."""
    content: dict[str, Any] = {"format": _FORMAT, "version": _VERSION}
    content["params"] = params
    for name in LEARNT:
        value = learnt[name]
        content[name] = _to_lists(value) if name in _NUMBERS else value
    content["dead"] = learnt["dead"].tolist()
    text = json.dumps(content, indent=1, allow_nan=False)
    Path(path).write_text(text + "\n", encoding="utf-8")


def read_calibration(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read parameters and learnt values, or say what is wrong with the file."""
    content = _read(Path(path))
    try:
        params = dict(content["params"])
        learnt: dict[str, Any] = {name: _to_array(content[name]) for name in _NUMBERS}
        learnt["dead"] = np.array(content["dead"], dtype=bool)
        learnt["image_shape"] = tuple(int(side) for side in content["image_shape"])
        learnt["highest_load_kpa"] = float(content["highest_load_kpa"])
    except (KeyError, TypeError, ValueError) as error:
        raise _bad(path, f"{error!r} while reading it") from error
    _check(path, learnt)
    return params, learnt


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise type(error)(
            f"path must name a calibration that save() wrote, got {path}: "
            f"{error.strerror}. Check the path, or calibrate the array."
        ) from error
    except ValueError as error:
        raise _bad(path, "it is not JSON") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _bad(path, f'its "format" is not "{_FORMAT}"')
    if content.get("version") != _VERSION:
        raise _bad(
            path, f"its version is {content.get('version')!r}, known is {_VERSION}"
        )
    return content


def _check(path: str | Path, learnt: dict[str, Any]) -> None:
    dead = learnt["dead"]
    for name in (*_NUMBERS, "dead"):
        if learnt[name].shape != learnt["image_shape"]:
            raise _bad(path, f"{name} is not of shape {learnt['image_shape']}")
    # Infinity, "no saturation was seen", is written as null too.
    missing = np.isnan(learnt["saturation_kpa"]) & ~dead
    learnt["saturation_kpa"][missing] = np.inf
    for name in _NUMBERS:
        if np.isnan(learnt[name][~dead]).any():
            raise _bad(path, f"{name} lacks values of taxels that are not dead")
    if not (learnt["gain"][~dead] > 0).all():
        raise _bad(path, "gain must be positive for taxels that are not dead")


def _bad(path: str | Path, reason: str) -> ValueError:
    return ValueError(
        f"path must be a calibration that save() wrote, got {path}: {reason}. "
        "Calibrate the array again."
    )


def _to_lists(values: Floats) -> list[Any]:
    objects = values.astype(object)
    objects[~np.isfinite(values)] = None
    lists: list[Any] = objects.tolist()
    return lists


def _to_array(lists: list[Any]) -> Floats:
    return np.array(lists, dtype=np.float64)
