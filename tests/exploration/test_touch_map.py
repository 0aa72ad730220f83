"""The sums of a map of touches, each beside a slow reference from its formula."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration import TouchMap
from palpate.recognition import ObjectRecogniser

WIDTHS, SHARES = (0.08, 0.15, 0.3, 0.6), (0.03, 0.1, 0.3)


def in_patches(patch, seed=0, n_touches=90):
    """Two objects that change places on patches so wide (rad) about the vertical."""
    rng = np.random.default_rng(seed)
    patterns = np.random.default_rng(4).normal(size=(2, 3, 3))
    azimuth = rng.uniform(-np.pi, np.pi, 2 * n_touches)
    names = np.repeat(["one", "other"], n_touches)
    side = np.floor(azimuth / patch).astype(int) % 2
    pattern = np.where(names == "one", side, 1 - side)
    out = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    images = patterns[pattern] + 0.3 * rng.normal(size=(len(names), 3, 3))
    return Touches(images, object=names, direction=-out, geometry="none")


@pytest.fixture(scope="module")
def touches():
    return in_patches(np.pi / 4)


@pytest.fixture(scope="module")
def touch_map(touches):
    return TouchMap(n_turns=4).fit(ObjectRecogniser().fit(touches), touches)


@pytest.mark.parametrize("width", [0.05, 0.4])
def test_closeness_is_a_bell_of_the_width_about_each_place(touch_map, width):
    stations = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    share, touch_map = 0.1, copy.copy(touch_map)
    touch_map.set_kernels(width, share)
    for station, row in zip(stations, touch_map.closeness(stations), strict=True):
        for rows in touch_map.rows_of_object:
            distances = [np.linalg.norm(touch_map.places_[j] - station) for j in rows]
            # A thousandth of the top is left for what lies anywhere else.
            bell = [np.exp(-(d**2) / (2 * width**2)) + 1e-3 for d in distances]
            # The table of `exp` and distances by products are good to six digits.
            assert_allclose(row[rows], np.array(bell) / sum(bell), rtol=1e-5)
    features = touch_map.features_
    squared = [[((a - b) ** 2).sum() for a in features] for b in features]
    assert touch_map.bandwidth_ == pytest.approx(np.sqrt(share * np.mean(squared)))


def test_the_ratio_is_the_weighted_mean_over_the_plain_one(touch_map):
    """Three touches at two stations; none is compared with its own group."""
    nearness, allowed = touch_map.left_out()
    closeness = touch_map.closeness(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    tested = [0, 5, 120]
    ratios = touch_map.station_ratio(nearness[tested], allowed[tested], closeness)
    assert ratios.shape == (2, 2, 3)
    for station, code, k in np.ndindex(ratios.shape):
        rows = [
            j
            for j in touch_map.rows_of_object[code]
            if touch_map.group_[j] != touch_map.group_[tested[k]]
        ]
        near, close = nearness[tested[k], rows], closeness[station, rows]
        ratio = ((close * near).sum() / close.sum() + 1e-6) / (near.mean() + 1e-6)
        assert ratios[station, code, k] == pytest.approx(np.log(ratio))
    by_row = touch_map.station_ratio(
        nearness[tested[:2]], allowed[tested[:2]], closeness, row_by_row=True
    )
    assert_allclose(by_row, [ratios[0, :, 0], ratios[1, :, 1]])
    nothing = touch_map.station_ratio(nearness[tested], 0 * allowed[tested], closeness)
    assert_allclose(nothing, 0)


def test_the_nearest_touch_has_a_nearness_of_one(touch_map):
    squared = np.array([[4.0, 5.0, 4.0 + 2 * touch_map.bandwidth_**2]])
    expected = np.exp([0, -0.5 / touch_map.bandwidth_**2, -1])
    assert_allclose(touch_map._nearness(squared)[0], expected)


def test_the_width_and_the_bandwidth_have_the_least_loss(touches, monkeypatch):
    """All pairs are tried; the loss is made up here, the least in the middle."""
    losses = {}
    touch_map = TouchMap(n_turns=1)

    def loss(self, ratio, episodes, weights):
        pair = self.width_, self.bandwidth_
        value = abs(np.log(self.width_ / 0.3)) + abs(np.log(self.bandwidth_) + 1) / 10
        return losses.setdefault(pair, value)

    monkeypatch.setattr(TouchMap, "_loss", loss)
    touch_map.fit(ObjectRecogniser().fit(touches), touches)
    assert sorted({width for width, _ in losses}) == [*WIDTHS]
    assert len({bandwidth for _, bandwidth in losses}) == len(SHARES)
    assert (touch_map.width_, touch_map.bandwidth_) == min(losses, key=losses.get)
    assert touch_map.width_ == 0.3


def test_places_help_most_where_all_depends_on_them():
    """Where objects change places in narrow patches nothing but the place tells."""
    touches = in_patches(0.2, n_touches=160)
    learnt = TouchMap(n_turns=1).fit(ObjectRecogniser().fit(touches), touches)
    assert learnt.width_ == WIDTHS[0]
    # By touch alone two objects are a guess, log 2 = 0.69 nats.
    assert learnt.log_loss_["touch"] == pytest.approx(np.log(2), abs=0.1)
    assert learnt.log_loss_["placed"] < 0.5 * np.log(2)


def test_the_loss_is_that_of_the_true_object_summed_over_turns(touch_map):
    rng = np.random.default_rng(0)
    ratio = rng.normal(size=(len(touch_map.codes_), 2, 4))
    rows = np.array([[0, 3, 4], [100, 101, 110]])
    weights = (0.7, 0.4, 0.25)
    loss = touch_map._loss(ratio, [rows], weights)
    losses = []
    for episode in rows:
        evidence = sum(
            touch_map.weighed(touch_map.left_out_[row], ratio[row], weights[:2])
            for row in episode
        )
        # Three touches, correlated by a quarter: each counts 1 / (1 + 2 / 4).
        prior = touch_map.recogniser.log_prior()[:, None]
        share = np.exp(evidence / 1.5 + prior)
        share = share.sum(axis=1) / share.sum()
        losses.append(-np.log(share[touch_map.codes_[episode[0]]]))
    assert loss == pytest.approx(np.mean(losses))
    # Episodes of several lengths count alike, however many there are of each.
    both = touch_map._loss(ratio, [rows, rows[:1, :1]], weights)
    first = touch_map._loss(ratio, [rows[:1, :1]], weights)
    assert both == pytest.approx((loss + first) / 2)


def test_places_turn_back_about_the_vertical(touch_map):
    """On an object turned by a quarter what is met at x is its own -y."""
    touch, x = touch_map.features_[[7]], 0.95
    turned = touch_map.placed_ratio(touch, np.array([[x, 0.0, 0.1]]))[0]
    for turn, place in enumerate(
        [[x, 0, 0.1], [0, -x, 0.1], [-x, 0, 0.1], [0, x, 0.1]]
    ):
        upright = touch_map.placed_ratio(touch, np.array([place]))[0, :, 0]
        # Sums of exponentials of rounded distances.
        assert_allclose(turned[:, turn], upright, atol=1e-9)
    assert len(np.unique(turned.round(3), axis=1).T) == 4


@pytest.mark.parametrize("length", [0.992, 1.008])
def test_directions_of_a_few_digits_are_taken(touches, touch_map, length):
    """The place is the direction turned round, as long as it was given."""
    image = {"images": touches.images[:1], "geometry": "none"}
    taken = touch_map.start().update(Touches(**image, direction=[[-length, 0, 0]]))
    placed, whole = (
        touch_map.start().update(Touches(**image), [[x, 0, 0]]) for x in (length, 1)
    )
    assert_allclose(taken.log_joint, placed.log_joint, rtol=1e-12)
    assert np.abs(taken.log_joint - whole.log_joint).max() > 1e-6
