"""The pressure array against closed forms, symmetries and a slow reference."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import integrate
from shapely import contains_xy
from shapely.geometry import Polygon

from palpate.simulation import Part, Press, PressureArray, find_parts

IDEAL = PressureArray(gain_spread=0, dead_zone_kpa=0, noise_kpa=0)
NUT, HEXAGON, SQUARE, DISC = "hexagon13-hole8", "hexagon13", "square13", "disc13"
FORCE_N = 4 * 9.80665


def boussinesq(x, y, z):
    """Vertical stress per unit force at (x, y, z) below a point: 3 z³ / (2 pi R⁵)."""
    return 3 * z**3 / (2 * np.pi * (x**2 + y**2 + z**2) ** 2.5)


def stress_beside_a_cell(x, y, sensing_mm, depth_mm):
    """Stress per unit force (1/mm²) at a taxel, of a pin on one cell at (x, y) mm."""
    array = PressureArray(
        grid_mm=0.4, cover_mm=depth_mm, cover_modulus_mpa=500, sensing_mm=sensing_mm
    )
    pin = Part("pin", np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.21)
    press = Press(x_mm=x - 1, y_mm=y - 1, load_kgf=0.1)
    assert np.count_nonzero(array.contact_kpa(pin, press)) == 1
    return array.stress_kpa(pin, press)[4, 4] / (1e3 * press.force_n)


@pytest.mark.parametrize("depth_mm", [0.2, 0.9, 2.0])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.4, 0.8), (1.6, 0.0), (2.8, 4.0)])
def test_a_window_has_the_mean_of_point_loads(place, depth_mm):
    x, y = place
    total, _ = integrate.dblquad(
        lambda v, u: boussinesq(u - x, v - y, depth_mm), -0.65, 0.65, -0.65, 0.65
    )
    stress = stress_beside_a_cell(x, y, 1.3, depth_mm)
    # The quadrature's own tolerance.
    assert stress == pytest.approx(total / 1.3**2, rel=1e-6, abs=1e-9)


def test_a_tiny_window_far_down_has_a_point_load():
    stress = stress_beside_a_cell(1.2, 2.0, 1e-3, 3.0)
    # The window is 3000 times smaller than its depth; cancelling costs digits.
    assert stress == pytest.approx(boussinesq(1.2, 2, 3), rel=1e-4)


def test_stress_agrees_with_the_fourier_transform_of_boussinesq():
    array = PressureArray(rows=8, cols=10)
    press = Press(0.3, -0.7, 20, tilt_deg=(0.1, 0.05), roughness_um=10)
    pressure = array.contact_kpa(NUT, press, random_state=1)
    stress = array.stress_kpa(NUT, press, random_state=1)

    padded = np.zeros((1024, 1024))
    padded[: pressure.shape[0], : pressure.shape[1]] = pressure
    angular = 2 * np.pi * np.fft.fftfreq(1024, d=0.1)
    k = np.hypot(angular[:, np.newaxis], angular)
    # Hankel transform of 3 z³ / (2 pi R⁵), and the window's as a product of sincs.
    window = np.sinc(1.3 * angular / (2 * np.pi))
    below = (1 + k * 0.9) * np.exp(-k * 0.9) * np.outer(window, window)
    # Taxel centres lie half a cell before cell 10, 30, ...
    shift = np.exp(1j * angular * (9.5 * 0.1))
    spectrum = np.fft.fft2(padded) * below * np.outer(shift, shift)
    expected = np.fft.ifft2(spectrum).real[:160:20, :200:20]
    # The periodic images of the transform add a few Pa to stresses of 100s of kPa.
    assert_allclose(stress, expected, atol=0.05)


def test_a_hole_shows_under_a_thin_cover_and_fades_under_a_thick_one():
    press = Press(x_mm=1, y_mm=1)  # the hole's middle over a taxel's

    def depth(cover_mm):
        stress = PressureArray(cover_mm=cover_mm).stress_kpa(NUT, press)
        return 1 - stress[5, 5] / stress.max()

    depths = [depth(cover_mm) for cover_mm in (0.3, 0.9, 2, 4)]
    assert depths[0] > 0.99
    assert (np.diff(depths) < 0).all()
    assert depths[-1] < 0.8


@pytest.mark.parametrize("part", find_parts(), ids=lambda part: part.name)
def test_surface_pressure_carries_the_load(part):
    press = Press(0.3, 0.1, 25, tilt_deg=(0.1, -0.1), roughness_um=10)
    pressure = PressureArray().contact_kpa(part, press, random_state=0)
    assert pressure.min() == 0
    assert pressure.sum() * 0.1**2 / 1e3 == pytest.approx(FORCE_N, rel=1e-12)


def test_a_flat_level_face_presses_evenly():
    pressure = IDEAL.contact_kpa("square10")
    touched = pressure[pressure > 0]
    assert len(touched) == 100**2
    assert_allclose(touched, FORCE_N * 1e3 / 100)


def test_a_tilted_face_presses_as_a_wedge():
    # A 10 mm square face sunk by s x along x: p = k s (x - x0), the load k s b w² / 2
    # with the width w in contact while w < 10.
    array = PressureArray(cover_modulus_mpa=4.5, cover_mm=0.9)
    slope, stiffness = np.tan(np.deg2rad(1.0)), 5.0  # N/mm³
    width = np.sqrt(2 * 9.80665 / (stiffness * slope * 10))
    pressure = array.contact_kpa("square10", Press(load_kgf=1, tilt_deg=(1.0, 0)))
    touched = pressure.any(axis=0)
    assert 0 < width < 10
    # Grid cells are 0.1 mm wide.
    assert touched.sum() * 0.1 == pytest.approx(width, abs=0.1)
    assert touched[50:70].all()  # the lifted side is at larger x
    assert pressure.max() == pytest.approx(1e3 * stiffness * slope * width, rel=0.05)


def test_more_load_makes_more_contact():
    area = [
        np.count_nonzero(
            PressureArray().contact_kpa(
                SQUARE, Press(load_kgf=load, tilt_deg=(0.2, 0.1), roughness_um=20), 3
            )
        )
        for load in (0.5, 1, 2, 3, 4, 5)
    ]
    assert (np.diff(area) > 0).all()
    assert area[0] < 0.5 * 130**2 < area[-1]


def test_a_soft_cover_evens_out_what_a_thin_one_breaks_up():
    press = Press(roughness_um=20, load_kgf=2)
    areas = [
        np.count_nonzero(PressureArray(cover_mm=c).contact_kpa(SQUARE, press, 0))
        for c in (0.2, 0.5, 0.9, 2)
    ]
    assert (np.diff(areas) > 0).all()


def test_unevenness_has_unit_variance_and_its_length(rng):
    array = PressureArray(grid_mm=1.0)
    plate = Part("plate", np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 9.5)
    press = Press(load_kgf=10, roughness_um=1)
    # All is in contact, so that 1 um more is so much less pressure.
    kpa_per_um = array.cover_modulus_mpa / array.cover_mm
    fields = np.stack(
        [array.contact_kpa(plate, press, rng)[1:-1, 1:-1] for _ in range(6000)]
    )
    assert fields.min() > 0
    fields /= kpa_per_um
    # Half the mean square of differences at a distance d is 1 - exp(-d² / (2 length²)),
    # about which those of 6000 fields scatter by 0.009 (sd over seeds) at 9 mm.
    for cells, lengths in ((3, 1), (9, 3)):  # of 1 mm; of 3 mm
        for differences in (
            fields[:, cells:] - fields[:, :-cells],
            fields[:, :, cells:] - fields[:, :, :-cells],
        ):
            expected = 1 - np.exp(-(lengths**2) / 2)
            assert np.mean(differences**2) / 2 == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_what_touches_is_the_face_at_every_point(seed):
    """A part that reaches beyond the array of 40 x 30 cells, with a hole."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-5, 45, size=(7, 2))
    around = np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T))
    outline = corners[around]
    hole = outline.mean(axis=0) + 0.2 * (outline - outline.mean(axis=0))
    array = PressureArray(4, 3, grid_mm=0.2)
    loops = [(loop - (15, 20)) * 0.2 for loop in (outline, hole)]
    pressure = array.contact_kpa(
        Part("part", loops[0], (loops[1],)), Press(load_kgf=0.1)
    )
    y, x = np.mgrid[:40, :30] + 0.5
    assert_array_equal(pressure > 0, contains_xy(Polygon(outline, [hole]), x, y))


def test_moving_by_a_pitch_moves_the_image():
    press = {"angle_deg": 15, "tilt_deg": (0.1, 0.2), "roughness_um": 10}
    here = IDEAL.stress_kpa("hexagon10", Press(-1.5, 0.5, **press), 7)
    there = IDEAL.stress_kpa("hexagon10", Press(0.5, -1.5, **press), 7)
    # Only rounding and the profiles left out (1e-8 of the largest) differ.
    assert_allclose(there[:-1, 1:], here[1:, :-1], atol=1e-4)


@pytest.mark.parametrize("part", ["bar10", NUT, "square10-hole6"])
def test_a_quarter_turn_turns_the_image_clockwise(part):
    upright = IDEAL.stress_kpa(part, Press(0.3, -1.2, 20))
    turned = IDEAL.stress_kpa(part, Press(1.2, 0.3, 110))
    # Cells that an edge just misses may fall on the other side: 0.01 mm² each.
    assert_allclose(turned, np.rot90(upright, -1), atol=2)


def test_stress_is_finite_and_never_pulls(rng):
    for number in range(100):
        tilt = tuple(rng.uniform(-0.3, 0.3, 2))
        x, y = rng.uniform(-9, 9, 2)
        press = Press(x, y, rng.uniform(0, 360), rng.uniform(0.1, 2), tilt, 30)
        stress = PressureArray().stress_kpa(SQUARE, press, number)
        assert np.isfinite(stress).all()
        # The profiles left out are worth 1e-8 of pressures up to 5000 kPa.
        assert stress.min() > -1e-3


def test_images_have_the_shape_of_an_array_of_any_size_and_pitch():
    for rows, cols, pitch in ((2, 3, 5.0), (16, 16, 1.25), (9, 33, 0.73)):
        array = PressureArray(rows, cols, pitch_mm=pitch, sensing_mm=0.5 * pitch)
        image = array.press("bar10", random_state=0)
        assert image.shape == (rows, cols)
        assert image.any()


def test_an_image_is_the_rounded_share_of_full_scale_of_what_the_taxels_sense():
    array = PressureArray(dead_zone_kpa=0, noise_kpa=0)
    sensed = array.stress_kpa(DISC) * array.gains
    assert_array_equal(array.press(DISC), np.rint(sensed * 255 / 4000))


def test_readings_saturate_at_full_scale():
    array = PressureArray(full_scale_kpa=200, gain_spread=0, noise_kpa=0)
    image = array.press(DISC)
    assert image.max() == 255
    assert_array_equal(image == 255, array.stress_kpa(DISC) >= 200 * 254.5 / 255)


def test_below_the_dead_zone_a_taxel_reads_nothing():
    array = PressureArray(noise_kpa=0, gain_spread=0)
    stress = array.stress_kpa(DISC)
    image = array.press(DISC)
    assert ((stress > 0) & (stress < 69)).any()
    assert_array_equal(image == 0, stress < 69)


def test_gains_belong_to_the_device():
    first, again, other = (PressureArray(100, 100, random_state=s) for s in (1, 1, 2))
    assert_array_equal(first.gains, again.gains)
    assert (first.gains != other.gains).any()
    # 10,000 taxels: the mean is known to 0.1 %, the spread to 0.07 %.
    assert first.gains.mean() == pytest.approx(1, abs=5e-3)
    assert np.log(first.gains).std() == pytest.approx(0.1, abs=3e-3)


def test_noise_has_the_size_it_is_given():
    array = PressureArray(100, 100, full_scale_kpa=1000, noise_kpa=40, gain_spread=0)
    image = array.read(np.full((100, 100), 500.0), random_state=0)
    # 10,000 readings; rounding to 3.9 kPa adds 1.1 kPa in quadrature.
    assert image.std() * 1000 / 255 == pytest.approx(40, abs=1)
    assert image.mean() * 1000 / 255 == pytest.approx(500, abs=2)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"rows": 1}, "rows must be at least 2, got 1"),
        ({"pitch_mm": 0}, "pitch_mm must be positive and finite, got 0"),
        ({"pitch_mm": -2.0}, "pitch_mm must be positive"),
        ({"pitch_mm": 100.0}, r"at most 2000 steps.*got 100 for 10 .*`pitch_mm`"),
        ({"pitch_mm": 1e308, "sensing_mm": 1}, "at most 2000 steps"),
        ({"grid_mm": 1e-6}, "at most 2000 steps.*or raise `grid_mm`"),
        ({"cols": 100000}, r"for 100000 taxels.*`rows`, `cols`"),
        ({"cover_mm": 0}, "cover_mm must be positive"),
        ({"sensing_mm": 2.5}, r"at most pitch_mm \(2.0\), got 2.5"),
        ({"noise_kpa": -1}, "noise_kpa must be finite and between 0"),
        ({"gain_spread": np.nan}, "gain_spread must be finite"),
    ],
)
def test_impossible_arrays_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        PressureArray(**kwargs)


def test_a_coarse_array_takes_a_coarse_grid():
    coarse = PressureArray(4, 4, pitch_mm=50.0, grid_mm=0.5)
    assert coarse.cells_per_pitch == 100
    assert coarse.press(DISC, 25.0, 25.0, random_state=0).max() > 0


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"part": "bolt"}, "got 'bolt'"),
        ({"load_kgf": 0}, "load_kgf must be finite and between 0.1 and 10.0, got 0"),
        ({"load_kgf": 50}, "between 0.1 and 10.0, got 50"),
        ({"x_mm": np.inf}, "x_mm must be finite"),
        ({"x_mm": 18.0}, r"must lie on the array, 20 x 20 mm.*\(18, 0\)"),
        ({"tilt_deg": 0.1}, "tilt_deg must be two angles"),
        ({"tilt_deg": (0, 30)}, "tilt_deg must be finite and between -10"),
        ({"roughness_um": -1}, "roughness_um must be finite and between 0"),
        (
            {"part": "bar10", "tilt_deg": (9, 0), "load_kgf": 10},
            "cover must be thicker than the press is deep",
        ),
    ],
)
def test_impossible_presses_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        PressureArray().press(**{"part": DISC, **kwargs})


def test_stresses_of_another_array_are_refused():
    with pytest.raises(ValueError, match=r"shape \(10, 10\), got \(4, 4\)"):
        PressureArray().read(np.ones((4, 4)))
