"""The membrane against closed forms and the conditions of contact."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.simulation import Membrane

FORCE_N = 0.735


@pytest.fixture(scope="module")
def membrane():
    return Membrane(thickness_mm=1.0, youngs_mpa=0.5)


def away_mm(membrane):
    return np.hypot(membrane.node_mm[:, None], membrane.node_mm)


def ball(membrane, radius_mm):
    below = np.maximum(radius_mm**2 - away_mm(membrane) ** 2, 0)
    return np.where(below > 0, radius_mm - np.sqrt(below), np.inf)


# How far each node of the surface lies behind the foremost, straight ahead.
SHAPES = {
    "plane": lambda membrane: 0.0,
    "slope": lambda membrane: 0.4 * membrane.node_mm,
    "ball": lambda membrane: ball(membrane, 25.0),
    "small ball": lambda membrane: ball(membrane, 5.0),
    "cone": lambda membrane: 2.0 * away_mm(membrane),
    "ridge": lambda membrane: np.abs(membrane.node_mm),
}


def gap_to(shape, membrane):
    gap = membrane.drop_mm + SHAPES[shape](membrane)
    return gap - gap.min()


shapes = pytest.mark.parametrize("shape", SHAPES)


@shapes
@pytest.mark.parametrize("n_nodes", [24, 48, 65])
def test_force_is_stiffness_times_displaced_volume(shape, n_nodes):
    """The mean of the equation: bending carries nothing, E t / R^2 carries all."""
    membrane = Membrane(n_nodes=n_nodes)
    contact = membrane.pressed(gap_to(shape, membrane), force_n=FORCE_N)
    w = membrane.displaced(contact.node_force_n, whole=True)
    volume_mm3 = w.sum(dtype=np.float64) * membrane.pitch_mm**2
    # Single precision.
    assert_allclose(0.11 * 1.5 / 20.0**2 * volume_mm3, FORCE_N, rtol=1e-5)
    assert_allclose(contact.force_n, FORCE_N, rtol=1e-5)


def test_point_load_sinks_as_reissner_says():
    """Far from any edge w(0) = F / (8 sqrt(D E t / R^2)), a shell on its own spring."""
    membrane = Membrane(
        radius_mm=20.0, thickness_mm=1.0, youngs_mpa=0.11, poisson=0.48, n_nodes=191
    )
    force = np.zeros((191, 191), np.float32)
    force[95, 95] = FORCE_N
    bending_n_mm, spring_n_mm3 = 0.11 / (12 * (1 - 0.48**2)), 0.11 / 20.0**2
    exact = FORCE_N / (8 * np.sqrt(bending_n_mm * spring_n_mm3))
    # A node of 0.2 mm is nearly a point beside the 2.6 mm over which a dent dies.
    assert_allclose(membrane.displaced(force)[95, 95], exact, rtol=0.01)


def test_dent_dies_away_over_its_reach():
    membrane = Membrane(thickness_mm=1.0, n_nodes=191)
    force = np.zeros((191, 191), np.float32)
    force[95, 95] = FORCE_N
    w = membrane.displaced(force)[95] / membrane.displaced(force)[95, 95]
    at = np.abs(membrane.node_mm) / membrane.reach_mm
    # Zero of the Kelvin function kei: at 3.915 reaches the dent turns into a bulge.
    assert (w[at < 3.8] > 0).all()
    assert (w[(at > 4.1) & (at < 6)] < 0).all()


@shapes
def test_dome_follows_the_object_and_never_passes_through(membrane, shape):
    """What no other forces do: it presses only where it meets, and nowhere pulls."""
    gap = gap_to(shape, membrane)
    contact = membrane.pressed(gap, force_n=FORCE_N, tolerance_mm=1e-4)
    pressed = contact.node_force_n > 0
    shell = membrane.displaced(contact.node_force_n)
    squeezed = contact.node_force_n * membrane.thickness_mm / membrane.youngs_mpa
    beyond = shell + squeezed / membrane.pitch_mm**2 + gap - contact.depth_mm
    assert_array_equal(contact.displacement_mm, shell)
    assert (contact.node_force_n >= 0).all()
    # Some steps of the tolerance: it bounds a mean, this is the worst node.
    assert_allclose(beyond[pressed], 0, atol=2e-3)
    assert beyond[~pressed & np.isfinite(gap)].min() > -2e-3


def test_default_tolerance_is_close_to_the_converged_answer(membrane):
    for shape in SHAPES:
        gap = gap_to(shape, membrane)
        rough = membrane.pressed(gap, force_n=FORCE_N)
        fine = membrane.pressed(gap, force_n=FORCE_N, tolerance_mm=2e-4, max_steps=3000)
        # 0.06 mm is promised; dents here are 3 to 12 mm deep.
        error = np.abs(rough.displacement_mm - fine.displacement_mm).max()
        assert error < 0.06
        assert_allclose(rough.depth_mm, fine.depth_mm, atol=0.03)


def test_flat_press_of_a_very_thin_dome_cuts_a_cap_off():
    """Without bending the dome is flat where pressed: F = (E t / R^2) pi a^4 / 4 R."""
    membrane = Membrane(thickness_mm=0.02, youngs_mpa=25.0, n_nodes=96)
    contact = membrane.pressed(gap_to("plane", membrane), force_n=FORCE_N)
    exact = (4 * membrane.radius_mm * FORCE_N / np.pi / membrane.stiffness_n_mm3) ** (
        1 / 4
    )
    # r^2 / 2R for the sphere is 8 % low at this radius (11 mm of 20).
    assert_allclose(np.sqrt(contact.area_mm2 / np.pi), exact, rtol=0.05)


@shapes
def test_more_force_more_depth_and_more_contact(membrane, shape):
    gap = gap_to(shape, membrane)
    presses = [
        membrane.pressed(gap, force_n=force, tolerance_mm=1e-3)
        for force in (0.1, 0.3, 0.9, 2.7)
    ]
    depth = [press.depth_mm for press in presses]
    area = [press.area_mm2 for press in presses]
    assert (np.diff(depth) > 0).all()
    assert (np.diff(area) >= 0).all()
    assert area[-1] > area[0]
    # Depth and force are one curve.
    by_force = membrane.pressed(gap, force_n=FORCE_N, tolerance_mm=1e-3)
    by_depth = membrane.pressed(gap, depth_mm=by_force.depth_mm, tolerance_mm=1e-3)
    assert_allclose(by_depth.force_n, FORCE_N, rtol=5e-3)


def test_whichever_comes_first_ends_the_press(membrane):
    gap = gap_to("plane", membrane)
    free = membrane.pressed(gap, force_n=FORCE_N)
    shallow = membrane.pressed(gap, force_n=FORCE_N, depth_mm=1.0)
    nearly = 0.95 * free.depth_mm
    later = membrane.pressed(gap, force_n=FORCE_N, depth_mm=nearly)
    never = membrane.pressed(gap, force_n=FORCE_N, depth_mm=50.0)
    assert (shallow.depth_mm, later.depth_mm) == (1.0, nearly)
    assert shallow.force_n < later.force_n < FORCE_N
    assert_allclose(never.depth_mm, free.depth_mm)


def test_one_node_in_contact_carries_the_whole_force(membrane):
    gap = np.full((48, 48), np.inf)
    gap[20, 30] = 0.0
    contact = membrane.pressed(gap, force_n=FORCE_N)
    assert np.count_nonzero(contact.node_force_n) == 1
    assert_allclose(contact.node_force_n[20, 30], FORCE_N, rtol=1e-6)
    assert np.isfinite(contact.displacement_mm).all()
    again = membrane.pressed(gap, depth_mm=contact.depth_mm)
    assert_allclose(again.force_n, FORCE_N, rtol=1e-3)


def test_nothing_in_reach_and_no_depth_press_nothing(membrane):
    nowhere = membrane.pressed(np.full((48, 48), np.inf), force_n=FORCE_N)
    at_once = membrane.pressed(gap_to("plane", membrane), depth_mm=0.0)
    for contact in (nowhere, at_once):
        assert (contact.force_n, contact.depth_mm, contact.area_mm2) == (0, 0, 0)
        assert_array_equal(contact.displacement_mm, 0)


def test_random_gaps_never_give_nan(membrane, rng):
    for _ in range(20):
        gap = rng.exponential(2.0, (48, 48))
        gap[rng.random((48, 48)) < rng.uniform(0, 1)] = np.inf
        gap -= gap.min() if np.isfinite(gap.min()) else 0
        contact = membrane.pressed(gap, force_n=FORCE_N)
        assert np.isfinite(contact.displacement_mm).all()
        assert np.isfinite(contact.depth_mm)


@pytest.mark.parametrize(
    ("gap", "ends", "message"),
    [
        (np.zeros((4, 4)), {"force_n": 1.0}, "gap_mm must be 48 x 48"),
        (np.full((48, 48), np.nan), {"force_n": 1.0}, "without NaN"),
        (np.full((48, 48), -1.0), {"force_n": 1.0}, "at least 0"),
        (np.zeros((48, 48)), {}, "force_n, depth_mm or both"),
        (np.zeros((48, 48)), {"force_n": 0.0}, "force_n must be positive"),
        (np.zeros((48, 48)), {"depth_mm": -1.0}, "depth_mm must be finite and between"),
    ],
)
def test_bad_presses_are_refused(membrane, gap, ends, message):
    with pytest.raises(ValueError, match=message):
        membrane.pressed(gap, **ends)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"radius_mm": 0.0}, "radius_mm must be positive"),
        ({"poisson": 0.5}, "poisson must be finite and between"),
        ({"thickness_mm": 8.0}, "at most a quarter of radius_mm"),
        ({"n_nodes": 4}, "n_nodes must be at least 8"),
    ],
)
def test_bad_membranes_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        Membrane(**fields)
