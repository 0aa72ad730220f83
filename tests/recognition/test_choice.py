"""What kind of sensor it is, and which encoding is chosen for it."""

import numpy as np

from palpate import Touches
from palpate.images import repose
from palpate.recognition import ObjectRecogniser, find_geometry


def bars_and_discs(rng, n_each=30, side=16):
    """Presses of a bar and of a disc, anywhere and at any angle, on an array."""
    row, col = np.mgrid[:side, :side] - (side - 1) / 2
    bar = np.exp(-((row / 1.2) ** 2) - (col / 4.5) ** 2)
    disc = np.exp(-((row**2 + col**2) / 2.6**2))
    upright = np.repeat([bar, disc], n_each, axis=0)
    images = repose(
        upright, rng.uniform(0, 360, 2 * n_each), rng.uniform(-1, 1, (2 * n_each, 2))
    )
    images += 0.02 * rng.normal(size=images.shape)
    return Touches(images, object=np.repeat(["bar", "disc"], n_each))


def dome(rng, n=6, side=120):
    row, col = np.mgrid[:side, :side]
    images = []
    for _ in range(n):
        away = np.hypot(row - 60 - rng.normal(), col - 60 - rng.normal())
        images.append(np.where(away < 45, 120 + 0.5 * row, 10))
    return np.array(images) + rng.normal(size=(n, side, side))


def test_geometry_is_found(rng):
    assert find_geometry(Touches(dome(rng))) == "dome"
    assert find_geometry(Touches(rng.random((4, 10, 10)))) == "array"
    assert find_geometry(Touches(rng.random((4, 120, 160)))) == "plane"
    assert find_geometry(Touches(rng.random((4, 3, 24)))) == "none"


def test_what_touches_say_of_themselves_holds(rng):
    assert find_geometry(Touches(dome(rng), geometry="plane")) == "plane"
    assert find_geometry(Touches(rng.random((4, 20, 20)), geometry="none")) == "none"


def test_presses_at_any_angle_are_recognised(rng):
    learnt = ObjectRecogniser().fit(bars_and_discs(rng))
    chosen = learnt.chosen_
    assert chosen["geometry"] == "array"
    assert set(chosen["candidates"]) >= {"moments about the centroid"}
    losses = {name: c["log_loss"] for name, c in chosen["candidates"].items()}
    kept = [name for name in losses if name in chosen["encoding"]]
    # Several tell all left-out touches apart: less than this is rounding.
    assert min(losses[name] for name in kept) < min(losses.values()) + 1e-6
    test = bars_and_discs(np.random.default_rng(5))
    # A bar and a disc differ far beyond the noise.
    assert learnt.score(test) > 0.95


def test_dead_taxels_are_no_obstacle(rng):
    touches = bars_and_discs(rng)
    images = touches.images.copy()
    images[:, 3, 5] = np.nan
    dead = Touches(images, object=touches.object)
    learnt = ObjectRecogniser().fit(dead)
    assert np.isfinite(learnt.log_likelihood(dead)).all()


def test_same_seed_same_choice(rng):
    touches = bars_and_discs(rng)
    first, second = (ObjectRecogniser(random_state=4).fit(touches) for _ in range(2))
    assert first.chosen_ == second.chosen_
