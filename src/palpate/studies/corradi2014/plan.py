"""The plan of the Corradi 2014 study: sizes, touches, and the paper's figures."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..._checks import check_option
from ..._types import Singles
from ...images import (
    DerivativeMagnitude,
    DomeCrop,
    repose,
)
from ...simulation import TacTipPins, simulate_touches
from ...touches import Touches
from .. import Archive, Codes, Plan, coded

# Table 2: (our sensor, TacTip) on the image, then on the derivative.
TABLE_2: dict[str, dict[str, tuple[float, float]]] = {
    "hu": {"image": (5.3, 10.4), "derivative": (5.1, 13.2)},
    "zernike": {"image": (2.0, 2.5), "derivative": (1.9, 3.8)},
    "oriented-pca": {"image": (2.6, 5.9), "derivative": (1.8, 5.4)},
    "zernike-pca": {"image": (1.5, 2.6), "derivative": (1.4, 2.9)},
    "scaled-pixels": {"image": (37.1, 37.9), "derivative": (10.4, 1378.8)},
}
# Fig. 3, the one value that the text gives, in per cent.
BEST = {("zernike-pca", "1-NN", "image"): 96.4}
PAPER_ENCODINGS = tuple(TABLE_2)
VARIANTS = ("image", "derivative")
CLASSIFIERS = ("1-NN", "network", "SVMs", "naive Bayes")

# Numbers of features that are tried; Zernike moments end with a whole order.
HU = (1, 2, 3, 4, 5, 6, 7)
MOMENTS = (3, 8, 15, 24, 35, 48, 71)
PRINCIPAL = (2, 4, 7, 11, 16, 22, 30, 40)
SQUARES = (4, 9, 25, 49, 100, 169)
COUNTS: dict[str, tuple[int, ...]] = {
    "hu": HU,
    "zernike": MOMENTS,
    "zernike-noll-abs": MOMENTS,
    "oriented-pca": PRINCIPAL,
    "zernike-pca": PRINCIPAL,
    "scaled-pixels": SQUARES,
}
# Encodings by name: (encoding, options, variant) of each part.
Part = tuple[str, dict[str, Any], str]
CANDIDATES: dict[str, tuple[Part, ...]] = {
    "zernike": (("zernike", {}, "image"),),
    "zernike to order 20": (("zernike", {"order": 20}, "image"),),
    "zernike to order 30": (("zernike", {"order": 30}, "image"),),
    "zernike, image and derivative": tuple(("zernike", {}, v) for v in VARIANTS),
    "polar gradients": (("polar-gradients", {}, "image"),),
    "polar gradients and zernike to order 30": (
        ("polar-gradients", {}, "image"),
        ("zernike", {"order": 30}, "image"),
    ),
}
Images = Singles

TACTIP = Archive(Path("tactip4") / "tactip4.npz", "a real dome with pins")
SIZE = 128  # pixels of a disc
N_GROUPS = 5  # parts of a recording, left out in turn
# Two touches whose standardised discs correlate above this show the same picture.
SAME = 0.99


@dataclass(frozen=True)
class Corradi2014Plan(Plan):
    """Sizes of the study; the defaults are the whole of it.

    Half of the `n_touches` of each simulated shape choose with. `runs` are of
    randomised fivefold cross-validation, `slow_runs` those for the network and the
    support vector machines; `choice_runs` choose the number of components for 1-NN,
    `slow_choice_runs` for the others; every `choice_step`-th number is tried. To name
    categories of unseen objects, in at most `fold_limit` folds, every `thinning`-th
    training touch is learnt, fewer by half for the paper's classifiers, and once more
    where something is chosen. Every `recorded_step`-th recorded touch is used; with
    `recorded_upright` shapes are named upright too, not only with test touches turned.
    Inner folds choose among `candidates`; the first is the one to beat.
    """

    n_touches: int = 50
    encodings: tuple[str, ...] = tuple(COUNTS)
    runs: int = 20
    slow_runs: int = 3
    choice_runs: int = 20
    slow_choice_runs: int = 1
    choice_step: int = 1
    thinning: int = 2
    recorded_step: int = 1
    recorded_upright: bool = True
    fold_limit: int = 5
    candidates: tuple[str, ...] = ("zernike-pca", *CANDIDATES)
    first_look: ClassVar[Mapping[str, Any]] = {
        "n_touches": 20,
        "encodings": PAPER_ENCODINGS,
        "runs": 2,
        "slow_runs": 1,
        "choice_runs": 1,
        "slow_choice_runs": 1,
        "choice_step": 4,
        "recorded_step": 8,
        "recorded_upright": False,
        "fold_limit": 1,
        "candidates": ("zernike-pca", "zernike", "zernike to order 20"),
    }

    def __post_init__(self) -> None:
        self.check_counts("runs", "slow_runs", "choice_runs", "slow_choice_runs")
        self.check_counts("thinning", "recorded_step", "fold_limit", "choice_step")
        self.check_counts("n_touches", at_least=10)
        self.check_counts("seed", at_least=0)
        for name in self.encodings:
            check_option("encodings", name, COUNTS)

    def counts(self, encoding: str) -> tuple[int, ...]:
        """Numbers of components to try, always with the largest."""
        tried = COUNTS[encoding]
        return tuple(reversed(tried[::-1][:: self.choice_step]))


@dataclass(frozen=True, eq=False)
class Shapes:
    """One set of touches, cut to standardised discs; `data` is its name in the rows.

    `images` (n_touches, n, n) are those of each variant, `test_images` the same as they
    look when they test, None if no different. Of each touch, `codes` are labels,
    `groups` recordings or blocks of one (0 to 4 in each half), and `half` is 0 where
    it chooses, 1 where it is reported.
    """

    data: str
    images: dict[str, Images]
    test_images: dict[str, Images] | None
    codes: Codes
    groups: Codes
    half: Codes


def simulated_shapes(plan: Corradi2014Plan) -> Iterator[Shapes]:
    """Press the seven shapes with the dome and with its pins, ten recordings each."""
    for data, camera in (("simulated", None), ("simulated-pins", TacTipPins())):
        touches = simulate_touches(
            "shapes",
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
    test_images = variants(_frame_discs(shown))
    yield Shapes("tactip4, test turned", standing, test_images, codes, groups, half)


def variants(discs: Images) -> dict[str, Images]:
    """Return standardised discs and their standardised derivatives."""
    steepness = DerivativeMagnitude().fit_transform(discs)
    return {"image": discs, "derivative": DomeCrop.standardise(steepness)}


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
    blank = np.zeros_like(images[:1])
    return DomeCrop(SIZE).fit(blank).transform(images)
