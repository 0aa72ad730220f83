"""Sets of simulated touches and presses: what they say, what fixes and refuses them."""

import itertools

import numpy as np
import pytest
from joblib import parallel_config
from numpy.testing import assert_allclose, assert_array_equal
from threadpoolctl import threadpool_info, threadpool_limits

from palpate import Touches
from palpate.exploration import explore_to_learn
from palpate.simulation import (
    DomeCamera,
    Membrane,
    PressureArray,
    Scene,
    TacTipPins,
    find_object,
    find_objects,
    find_parts,
    load_mesh,
    simulate_presses,
    simulate_touches,
)

FORCE_N = 4 * 9.80665


@pytest.mark.parametrize(
    "thing",
    find_objects(["household", "unseen", "unlike others", "shapes"]),
    ids=lambda thing: thing.name,
)
def test_every_object_from_everywhere_gives_finite_touches(thing):
    touches = simulate_touches(
        thing, 6, max_tilt_deg=90, aim_sd_mm=15, keep_misses=True, random_state=3
    )
    assert touches.images.shape == (6, 120, 120)
    for name in ("position_mm", "direction", "force_n", "depth_mm", "area_mm2"):
        assert np.isfinite(touches.columns[name]).all()
    assert touches.columns["contact"].any() == (thing.name != "nothing")


def test_touches_have_their_columns():
    touches = simulate_touches(
        ["mug", "pen"], 6, n_sessions=2, drift=False, random_state=0
    )
    assert isinstance(touches, Touches)
    columns = touches.columns
    assert columns["object"].tolist() == ["mug"] * 6 + ["pen"] * 6
    assert columns["session"].tolist() == [0, 0, 0, 1, 1, 1] * 2
    assert columns["order"].tolist() == [*range(6)] * 2
    assert str(touches.whole["geometry"]) == "dome"
    default = DomeCamera(image_shape=(120, 120))
    assert_array_equal(touches.whole["no_contact"], default.no_contact())
    assert_allclose(np.linalg.norm(columns["direction"], axis=1), 1)
    assert (columns["direction"][:, 2] <= -np.cos(np.deg2rad(80))).all()
    # 75 gf, spread by 5 %.
    assert 0.6 < np.median(columns["force_n"]) < 0.9


def test_tips_end_at_the_surface():
    """A ball of 72 mm faced exactly: the tip ends its depth inside the sphere."""
    touches = simulate_touches("ball", 8, aim_sd_mm=0.0, random_state=0)
    away = np.linalg.norm(touches.columns["position_mm"] - (0, 0, 36), axis=1)
    # The seam is 0.4 mm deep.
    assert_allclose(away, 36 - touches.columns["depth_mm"], atol=0.5)


def test_the_strategy_above_touches_the_feature():
    touches = simulate_touches(
        ["flat", "nothing"], 4, strategy="above", aim_sd_mm=1.0, random_state=0
    )
    contact = touches.columns["contact"]
    assert contact.tolist() == [True] * 4 + [False] * 4
    tilt = np.rad2deg(np.arccos(-touches.columns["direction"][:, 2]))
    assert (tilt <= 10).all()


def test_seed_settles_everything_whatever_the_jobs():
    def touch(seed, **jobs):
        return simulate_touches(
            ["stapler", "box"], 6, n_sessions=3, random_state=seed, **jobs
        )

    first = touch(5)
    with parallel_config("threading"):
        assert_array_equal(first.images, touch(5, n_jobs=2).images)
    assert (first.images != touch(6).images).any()


@pytest.mark.parametrize("made_by", [simulate_touches, explore_to_learn])
def test_contact_is_solved_on_one_thread(made_by, monkeypatch):
    """Sums of several threads round otherwise: seen from 64 nodes on, as a gel has."""
    thread_counts, pressed = set(), Membrane.pressed

    def noted(*gaps, **limits):
        pools = threadpool_info()
        thread_counts.update(
            pool["num_threads"] for pool in pools if pool["user_api"] == "blas"
        )
        return pressed(*gaps, **limits)

    monkeypatch.setattr(Membrane, "pressed", noted)
    with threadpool_limits(limits=2, user_api="blas"):
        made_by([find_object("box")], 1, DomeCamera(image_shape=(24, 24)))
    assert thread_counts == {1}


@pytest.mark.slow
def test_processes_give_the_same_touches(tmp_path):
    path = tmp_path / "tub.ply"
    find_object("porridge pot").mesh.export(path)
    objects = [load_mesh(path), "plastic card"]
    camera = TacTipPins()
    alone = simulate_touches(objects, 30, camera, random_state=1)
    together = simulate_touches(objects, 30, camera, random_state=1, n_jobs=2)
    assert_array_equal(alone.images, together.images)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"objects": []}, ValueError, "at least one object"),
        ({"objects": ["spoon"]}, ValueError, "name must be one of stapler"),
        ({"objects": ["pen", "box", "pen"]}, ValueError, "got 'pen' twice"),
        ({"objects": [3]}, TypeError, "SimObject or names, got int"),
        ({"objects": 3}, TypeError, "SimObject or names, got int"),
        ({"camera": "dome"}, TypeError, "camera must be a DomeCamera, .* got str"),
        ({"camera": PressureArray()}, TypeError, "GelCamera, got PressureArray"),
        ({"n_touches": 0}, ValueError, "n_touches must be at least 1"),
        ({"strategy": "below"}, ValueError, "strategy must be one of 'hemisphere'"),
        ({"pose": "lying"}, ValueError, "pose must be one of 'usual', 'any'"),
        ({"max_tilt_deg": 120}, ValueError, "max_tilt_deg must be finite and betw"),
        ({"aim_mm": 2}, TypeError, "no parameter 'aim_mm'. Fields of Scene: pose, hem"),
        ({"random_state": -1}, ValueError, "random_state must be at least 0"),
        (
            {"objects": ["pen"], "aim_sd_mm": 1e5, "random_state": 0},
            ValueError,
            "'pen' was missed 50 times",
        ),
    ],
)
def test_bad_sets_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        simulate_touches(**{"objects": ["box"], "n_touches": 1, **arguments})


def test_fields_of_a_scene_may_be_given_by_name():
    camera = DomeCamera(image_shape=(48, 48), n_nodes=24)
    scene = Scene(aim_sd_mm=1, max_tilt_deg=20, max_roll_deg=0)
    together = simulate_touches("mug", 3, camera, scene=scene, random_state=0)
    alone = simulate_touches(
        "mug",
        3,
        camera,
        scene=Scene(aim_sd_mm=1, max_tilt_deg=20, max_roll_deg=90),
        max_roll_deg=0,
        random_state=0,
    )
    assert_array_equal(together.images, alone.images)
    assert_array_equal(together.columns["roll_rad"], np.zeros(3))


def test_mountings_are_the_same_for_all_objects_and_differ_from_each_other():
    camera = DomeCamera(image_shape=(48, 48), noise_sd=0, n_nodes=24)
    options = {"n_sessions": 2, "random_state": 0, "keep_misses": True}
    touches = simulate_touches(["nothing"], 2, camera, mountings=True, **options)
    first, second = touches.images.astype(float)
    assert np.abs(first - second).mean() > 1
    other = simulate_touches(["nothing"], 4, camera, mountings=True, **options)
    assert np.array_equal(other.images[0], other.images[1])
    rng = np.random.default_rng(0)
    assert camera.remounted(rng) != camera.remounted(rng)


# Presses of parts on a pressure array.


def test_columns_of_a_set_of_presses_tell_what_was_pressed_and_how():
    touches = simulate_presses(n_presses=3, random_state=0)
    columns = touches.columns
    assert touches.images.shape == (36, 10, 10)
    assert touches.images.dtype == np.uint8
    assert touches.geometry == "array"
    names = [part.name for part in find_parts()]
    assert list(touches.object) == [name for name in names for _ in range(3)]
    assert list(columns["part"]) == [n for n in range(1, 13) for _ in range(3)]
    assert list(columns["press"][:6]) == [0, 1, 2, 0, 1, 2]
    assert columns["position_mm"].shape == columns["tilt_deg"].shape == (36, 2)
    assert np.abs(columns["position_mm"]).max() <= 1
    assert ((columns["angle_deg"] >= 0) & (columns["angle_deg"] < 360)).all()
    assert_allclose(columns["force_n"], FORCE_N)
    assert touches.images.reshape(36, -1).any(axis=1).all()


def test_a_column_row_is_enough_to_press_again():
    device = PressureArray(noise_kpa=0)
    touches = simulate_presses(3, 4, array=device, roughness_um=0, random_state=5)
    for touch in touches:
        (x, y), tilt = touch.columns["position_mm"][0], touch.columns["tilt_deg"][0]
        angle, force = touch.columns["angle_deg"][0], touch.columns["force_n"][0]
        image = device.press(3, x, y, angle, force / 9.80665, tilt_deg=tuple(tilt))
        # The load went to newtons and back: a rounding may tip over.
        assert np.abs(image - touch.images[0].astype(int)).max() <= 1


def test_same_seed_same_touches_and_seeds_differ():
    first, again = (simulate_presses([1, 7], 5, random_state=4) for _ in range(2))
    other = simulate_presses([1, 7], 5, random_state=5)
    assert_array_equal(first.images, again.images)
    assert (first.images != other.images).any()


def test_loads_can_be_drawn_from_a_range():
    loads = simulate_presses(1, 50, load_kgf=(1, 5), random_state=0).columns["force_n"]
    assert 1 <= loads.min() / 9.80665 < 2
    assert 4 < loads.max() / 9.80665 <= 5


def test_progress_goes_to_standard_error_only(capsys, monkeypatch):
    clock = itertools.count(0, 10)  # ten seconds between any two looks at it
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    simulate_presses(1, 120, random_state=0, progress=True)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Pressing" in captured.err


@pytest.mark.parametrize(
    ("kwargs", "error", "message"),
    [
        # Before any of them is pressed.
        ({"parts": ["bar10", "nut"]}, ValueError, "got 'nut'"),
        ({"n_presses": 0}, ValueError, "n_presses must be at least 1"),
        ({"load_kgf": (5, 1)}, ValueError, "from low to high"),
        ({"load_kgf": (1, 2, 3)}, ValueError, r"one load or \(low, high\)"),
        ({"max_turn_deg": 200}, ValueError, "max_turn_deg must be finite and between"),
        ({"random_state": -1}, ValueError, "random_state must be at least 0"),
        ({"array": "10x10"}, TypeError, "array must be a PressureArray, got str"),
    ],
)
def test_impossible_sets_are_refused(kwargs, error, message):
    with pytest.raises(error, match=message):
        simulate_presses(**{"parts": 1, **kwargs})


def test_sessions_of_an_array_differ_more_between_than_within():
    touches = simulate_presses(
        ["disc13"], 12, n_sessions=3, max_shift_mm=0, tilt_sd_deg=0, random_state=0
    )
    assert np.unique(touches.session).tolist() == [0, 1, 2]
    means = [touches.images[touches.session == s].mean(axis=0) for s in range(3)]
    within = [touches.images[touches.session == s][:2].mean(axis=0) for s in range(3)]
    between = np.abs(means[0] - means[1]).mean()
    assert between > 2 * np.abs(means[0] - within[0]).mean()
    alone = simulate_presses(["disc13"], 12, n_sessions=1, random_state=0)
    assert set(alone.session) == {0}
