"""Draw docs/images/dome-touches.png: simulated touches of every built-in object."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from palpate.simulation import (
    DomeCamera,
    TacTipPins,
    find_objects,
    simulate_touches,
)

SHEET = Path(__file__).parents[1] / "docs" / "images" / "dome-touches.png"
SIDE, N_TOUCHES, LABEL_WIDTH = 76, 6, 104

Picture = NDArray[np.uint8]


def main() -> None:
    camera = DomeCamera(image_shape=(SIDE, SIDE), noise_sd=0.0, texture_sd=0.0)
    shapes, things = find_objects("shapes"), find_objects(["household", "unseen"])
    rows = [_strip(thing, camera, "hemisphere") for thing in things]
    rows += [_strip(thing, camera, "above") for thing in shapes]
    rows += [_strip(thing, TacTipPins(), "above") for thing in shapes[:5:2]]
    half = (len(rows) + 1) // 2
    columns = [np.vstack(strips) for strips in (rows[:half], rows[half:])]
    short = columns[0].shape[0] - columns[1].shape[0]
    columns[1] = np.pad(columns[1], ((0, short), (0, 0)), constant_values=255)
    SHEET.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(SHEET), np.hstack(columns), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _strip(thing: Any, sensor: Any, strategy: str) -> Picture:
    """Return the name of an object and touches of it in a row."""
    touches = simulate_touches(
        thing, N_TOUCHES, sensor, strategy, drift=False, random_state=len(thing.name)
    )
    pictures = [_small(image) for image in touches.images]
    label = np.full((SIDE, LABEL_WIDTH), 255, np.uint8)
    name = thing.name + (" (pins)" if isinstance(sensor, TacTipPins) else "")
    at = (4, SIDE // 2 + 4)
    cv2.putText(label, name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.38, 0, 1, cv2.LINE_AA)
    return np.pad(np.hstack([label, *pictures]), ((0, 2), (0, 8)), constant_values=255)


def _small(image: Picture) -> Picture:
    return np.asarray(cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA))


if __name__ == "__main__":
    main()
