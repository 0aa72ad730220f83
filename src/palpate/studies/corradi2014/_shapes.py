"""The touches of the Corradi 2014 study: simulated shapes, and recorded ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...images import (
    Circle,
    DerivativeMagnitude,
    DomeCrop,
    Rims,
    crop_discs,
    repose,
    standardise_discs,
)
from ...simulation import BASIC_SHAPES, TacTipPins, simulate_touches
from ...touches import Touches
from .._touches import Archive, Codes, coded
from ._plan import Corradi2014Plan

Images = NDArray[np.float32]

TACTIP = Archive(
    Path("tactip4") / "tactip4.npz",
    "a real dome with pins",
    "github.com/marselap/tactip-cnn-bayes",
)
SIZE = 128
N_GROUPS = 5
# Two touches whose standardised discs correlate above this show the same picture.
SAME = 0.99


@dataclass(frozen=True, eq=False)
class Shapes:
    """One set of touches, cut to standardised discs; `data` is its name in the rows.

    `images` (n_touches, n, n) are those of each variant, `asked` the same as they look
    when they test, None if no different. Of each touch, `codes` are labels, `groups`
    recordings or blocks of one (0 to 4 in each half), and `half` is 0 where it
    chooses, 1 where it is reported.
    """

    data: str
    images: dict[str, Images]
    asked: dict[str, Images] | None
    codes: Codes
    groups: Codes
    half: Codes

    def only(self, variant: str) -> "Shapes":
        """Return the same touches without the other variant's images."""
        asked = None if self.asked is None else {variant: self.asked[variant]}
        return replace(self, images={variant: self.images[variant]}, asked=asked)


def simulated_shapes(plan: Corradi2014Plan) -> Iterator[Shapes]:
    """Press the seven shapes with the dome and with its pins, ten recordings each."""
    for data, camera in (("simulated", None), ("simulated-pins", TacTipPins())):
        touches = simulate_touches(
            BASIC_SHAPES,
            plan.n_touches,
            camera,
            "above",
            n_sessions=2 * N_GROUPS,
            random_state=plan.seed,
        )
        session = np.unique(touches.columns["session"], return_inverse=True)[1]
        discs = rim_discs(touches) if camera is None else _frame_discs(touches.images)
        images = variants(discs)
        codes = coded(touches)
        half, groups = session // N_GROUPS, session % N_GROUPS
        yield Shapes(data, images, None, codes, groups, half)


def recorded_shapes(
    touches: Touches, seed: int, *, upright: bool = True
) -> Iterator[Shapes]:
    """Give the recorded shapes upright, if asked, then with their test images turned.

    They come shape by shape in the order of recording: each shape's first half
    chooses, and a fifth of a half is a block of the recording.
    """
    codes = coded(touches)
    place = np.zeros(len(codes))
    for code in np.unique(codes):
        rows = np.flatnonzero(codes == code)
        place[rows] = np.arange(len(rows)) / len(rows)
    block = (place * 2 * N_GROUPS).astype(np.intp)
    half, groups = block // N_GROUPS, block % N_GROUPS
    standing = variants(_frame_discs(touches.images))
    if upright:
        yield Shapes("tactip4", standing, None, codes, groups, half)
    angle = np.random.default_rng([seed, 4]).uniform(0, 360, len(touches))
    turned = repose(touches.images, angle, edges="nearest", interpolation="cubic")
    # Cubic interpolation overshoots beside the pins; a camera's levels do not.
    shown = np.clip(turned, touches.images.min(), touches.images.max())
    asked = variants(_frame_discs(shown))
    yield Shapes("tactip4, test turned", standing, asked, codes, groups, half)


def variants(discs: Images) -> dict[str, Images]:
    """Return standardised discs and their standardised derivatives."""
    steepness = DerivativeMagnitude().fit_transform(discs)
    return {"image": discs, "derivative": standardise_discs(steepness)}


def near_duplicates(discs: Images) -> float:
    """Return the share of touches (per cent) that another one nearly repeats."""
    flat = discs.reshape(len(discs), -1)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
    alike = flat @ flat.T
    np.fill_diagonal(alike, -1)
    return float(100 * (alike.max(axis=1) > SAME).mean())


def rim_discs(touches: Touches) -> Images:
    """Cut each touch to the disc about its own rim, and standardise it."""
    crop = DomeCrop(SIZE).fit(touches.images, no_contact=touches.no_contact)
    return crop.transform(touches.images)


def _frame_discs(images: NDArray[Any]) -> Images:
    """Pins have no rim: the disc is the one inscribed in the frame."""
    circle = Circle.inscribed((images.shape[1], images.shape[2]))
    rims = Rims.of([circle] * len(images))
    return standardise_discs(crop_discs(images, rims, circle.radius, SIZE))
