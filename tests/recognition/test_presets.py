"""Every preset on touches it is made for: learns, and learns more."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import Touches
from palpate.encodings import CentroidMoments
from palpate.images import ChannelMean
from palpate.recognition import PRESETS, ObjectRecogniser
from palpate.simulation import DomeCamera, simulate_presses, simulate_touches

PARTS = ("bar10", "disc13", "square10-hole6")


@pytest.fixture(scope="module")
def presses():
    return simulate_presses(PARTS, 12, random_state=0)


@pytest.fixture(scope="module")
def dome_touches():
    camera = DomeCamera(image_shape=(96, 96), n_nodes=24)
    return simulate_touches(["ball", "pen"], 14, camera, drift=False, random_state=0)


@pytest.fixture(scope="module", params=sorted(PRESETS))
def model(request, presses, dome_touches):
    touches = presses if request.param == "liu2014" else dome_touches
    return ObjectRecogniser(request.param).fit(touches), touches


def test_presets_recognise_what_they_are_made_for(model):
    learnt, touches = model
    assert learnt.score(touches) > 0.9


def test_objects_come_and_go_in_every_preset(model):
    learnt, touches = deepcopy(model)
    new = touches[:6]
    learnt.add_object("new", new)
    assert learnt.log_likelihood(touches).shape == (len(touches), len(learnt.classes_))
    assert "new" in learnt.start().posterior
    learnt.forget_object("new")
    assert "new" not in learnt.start().posterior


def test_kernel_densities_of_others_do_not_change(dome_touches):
    learnt = ObjectRecogniser("corradi2015").fit(dome_touches)
    before = learnt.log_likelihood(dome_touches)
    learnt.add_object("also", dome_touches[:5])
    after = learnt.log_likelihood(dome_touches)
    assert_array_equal(after[:, 1:], before)


@pytest.mark.slow
def test_pose_of_presses_is_told_to_the_stated_accuracy(presses, tmp_path):
    learnt = ObjectRecogniser().fit(presses).fit_pose(presses)
    test = simulate_presses(PARTS, 10, random_state=1)
    again = ObjectRecogniser.load(learnt.save(tmp_path / "m.palpate"))
    poses = again.pose(test, test.object)
    errors_mm = np.hypot(
        *(np.stack([poses.x_mm, poses.y_mm]) - test.columns["position_mm"].T)
    )
    assert np.median(errors_mm) < 0.5
    period = 360 / np.maximum(poses.symmetry, 1)
    errors_deg = np.abs(poses.angle_deg - test.columns["angle_deg"]) % period
    errors_deg = np.minimum(errors_deg, period - errors_deg)[poses.symmetry > 0]
    assert np.median(errors_deg) < 5


def test_poses_need_a_pitch(presses):
    # Six presses of each of two parts.
    rows = np.r_[0:6, 12:18]
    bare = Touches(presses.images[rows], object=presses.object[rows])
    learnt = ObjectRecogniser(rehearse=False).fit(bare)
    with pytest.raises(ValueError, match="pitch_mm must be given"):
        learnt.fit_pose(bare)
    with pytest.raises(ValueError, match="learnt no poses"):
        learnt.pose(bare, bare.object)
    assert learnt.fit_pose(bare, pitch_mm=2).pose(bare[:1], ["bar10"]).symmetry[0] == 2
    numbers = np.unique(bare.object, return_inverse=True)[1]
    learnt.fit(bare.images, numbers)
    learnt.fit_pose(bare.with_columns(object=numbers), pitch_mm=2)
    assert learnt.pose(bare[:1], learnt.predict(bare[:1])).symmetry[0] == 2


def test_objects_that_differ_in_colour_alone_are_told_apart_on_a_dome():
    camera = DomeCamera(image_shape=(64, 64), n_nodes=24)
    grey = simulate_touches(["ball"], 48, camera, random_state=0).images / 2.0
    grey -= grey.mean(axis=(1, 2), keepdims=True)
    rng = np.random.default_rng(0)
    names = np.where(rng.random(len(grey)) < 0.5, "warm", "cold")
    lean = np.where(names == "warm", 0.5, -0.5)[:, None, None]
    channels = np.stack([(1 + lean) * grey, grey, (1 - lean) * grey], axis=3)
    images = np.clip(120 + channels, 0, 255).astype(np.uint8)
    coloured = Touches(images, object=names, channels=("r", "g", "b"), geometry="dome")
    train, test = coloured[:32], coloured[32:]
    recogniser = ObjectRecogniser().fit(train)
    assert "colours on rings" in recogniser.chosen_["encoding"]
    assert recogniser.score(test, test.object) > 0.9
    without_colours, test_without = (
        Touches(
            ChannelMean().fit_transform(part.images),
            object=part.object,
            geometry="dome",
        )
        for part in (train, test)
    )
    assert ObjectRecogniser().fit(without_colours).score(test_without) < 0.75


def forces(n_touches, seed):
    """Three shapes on a three-axis array; each taxel is pushed another way."""
    rng, images = np.random.default_rng(seed), []
    for shape in SHAPES.values():
        for _ in range(n_touches):
            load, (row, col) = np.zeros((6, 6)), rng.integers(0, 4, 2)
            load[row : row + 3, col : col + 3] = np.rot90(shape, rng.integers(4))
            force = rng.normal(size=(6, 6, 3))
            force /= np.linalg.norm(force, axis=2, keepdims=True)
            noise = rng.normal(0, 0.02, force.shape)
            images.append(load[..., np.newaxis] * force + noise)
    return Touches(
        np.stack(images), object=np.repeat([*SHAPES], n_touches), channels=tuple("xyz")
    )


SHAPES = {
    "bar": [[1, 1, 1], [0, 0, 0], [0, 0, 0]],
    "corner": [[1, 1, 0], [1, 0, 0], [0, 0, 0]],
    "two": [[1, 0, 1], [0, 0, 1], [0, 0, 0]],
}


def test_shapes_on_three_axes_are_told_by_how_large_forces_are():
    recogniser = ObjectRecogniser(rehearse=False).fit(forces(6, 0))
    assert recogniser.score(forces(10, 1)) > 0.95  # by the mean of axes 0.6


@pytest.fixture(scope="module")
def beside_rest():
    """Presses of all parts, taught and new, and a level at which each taxel rests."""
    taught, new = (simulate_presses(None, 8, random_state=seed) for seed in (0, 1))
    reach = np.ptp(taught.images.astype(float))
    rest = np.random.default_rng(0).normal(0, 0.3 * reach, taught.images.shape[1:])

    def resting(touches, rest, **about):
        about = {"object": touches.object, "geometry": "array", **about}
        return Touches(touches.images + rest, **about)

    return taught, new, rest, resting


def test_levels_that_taxels_rest_at_hide_nothing(beside_rest, tmp_path):
    taught, new, rest, resting = beside_rest
    with_rest = resting(taught, rest, no_contact=rest)
    learnt = ObjectRecogniser().fit(with_rest)
    assert learnt.chosen_["encoding"].startswith("change from rest: ")
    without = ObjectRecogniser().fit(resting(taught, 0))
    assert learnt.score(resting(new, rest)) >= without.score(resting(new, 0)) - 0.05
    # Those of a user, alone or beside the others, take what is read.
    own = {"own": [CentroidMoments(), StandardScaler()]}
    for preset in ("default", None):
        blinded = ObjectRecogniser(preset, encodings=own).fit(with_rest)
        assert not blinded.encoder_.as_changes
    assert learnt.score(resting(new, rest)) > blinded.score(resting(new, rest)) + 0.05
    # Levels that drifted since are found in the frame of no contact of the new session.
    drifted = rest + 0.3 * rest[::-1]
    there = resting(new, drifted, no_contact=drifted)
    again = ObjectRecogniser.load(learnt.save(tmp_path / "m.palpate"))
    evidence = learnt.evidence(there).log_likelihood
    assert_array_equal(again.evidence(there).log_likelihood, evidence)
    bare = there.without("no_contact")
    assert learnt.score(there) > learnt.score(bare) + 0.05
    again.remount(there[::4].without("object"))  # with it, later ones need none
    assert again.score(bare) > learnt.score(bare) + 0.05


def test_a_level_that_all_taxels_rest_at_changes_nothing(beside_rest):
    taught, new, rest, resting = beside_rest
    evidence = []
    for level in (0.0, 7.0):
        flat = np.full(rest.shape, level)
        at_level = resting(taught, flat, no_contact=flat)
        learnt = ObjectRecogniser(rehearse=False).fit(at_level)
        evidence.append(learnt.log_likelihood(resting(new, flat)))
    assert_allclose(*evidence, atol=1e-6)


@pytest.mark.parametrize("level", [0.2, 5.0])
def test_electrodes_that_rest_at_other_levels_are_told_by_their_changes(level):
    """A change tells as much as what is read on one day, and is taken: it holds."""
    kinds = np.random.default_rng(0).normal(size=(3, 9))

    def day(seed, n):
        rng = np.random.default_rng(seed)
        changes = np.repeat(kinds, n, axis=0) + rng.normal(0, 0.3, (3 * n, 9))
        changes[-1] = 0  # nothing
        rest = level * rng.normal(size=(1, 9))
        levels = (changes + rng.normal(0, 1e-3, changes.shape))[:, np.newaxis] + rest
        return Touches(levels, no_contact=rest, geometry="none")

    names = np.repeat(["a", "b", "c"], 21)[:-1]
    learnt = ObjectRecogniser().fit(day(1, 21)[:-1], names)
    assert learnt.chosen_["encoding"].startswith("change from rest: ")
    another = day(2, 21)
    assert learnt.score(another[:-1], names) > 0.95
    assert [*learnt.evidence(another).flags] == [*[""] * 62, "no contact"]


def test_a_gel_is_learnt_as_it_reads_and_asked_whatever_its_frame():
    """Less the frame of another day its pictures would show the edges of both."""

    def day(seed, n):
        rng = np.random.default_rng(seed)
        rest = rng.integers(100, 140, (24, 32, 3))
        rows, columns = np.mgrid[:24, :32]
        levels, names = [], []
        for name, (height, width) in {"bar": (3, 14), "disc": (7, 7)}.items():
            for _ in range(n):
                row, column = rng.integers(8, 16), rng.integers(10, 22)
                away = ((rows - row) / height) ** 2 + ((columns - column) / width) ** 2
                dent = 60 * np.exp(-4 * away)[..., np.newaxis]
                levels.append(rest + dent + rng.normal(0, 1, rest.shape))
                names.append(name)
        levels.append(rest + rng.normal(0, 1, rest.shape))  # nothing
        images = np.array(levels).round().astype(np.uint8)
        about = {"channels": [*"rgb"], "geometry": "plane"}
        return Touches(images, no_contact=rest.astype(np.uint8), **about), names

    taught, names = day(0, 12)
    learnt = ObjectRecogniser(rehearse=False).fit(taught[:-1], names)
    assert not learnt.encoder_.as_changes
    another, names = day(1, 20)
    stale = another.with_columns(no_contact=taught.no_contact)
    for asked in (another, stale, another.without("no_contact")):
        assert learnt.score(asked[:-1], names) > 0.9
    # What is no touch is told by the frame of its own day.
    assert [*learnt.evidence(another).flags] == [*[""] * 40, "no contact"]


@pytest.mark.parametrize("with_rest", [True, False])
@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(preset, marks=[pytest.mark.slow] * (preset == "liu2014"))
        for preset in PRESETS
    ],
)
def test_a_taxel_that_is_dead_is_filled(preset, with_rest, presses):
    images = presses.images.astype(np.float32)
    rest = np.zeros(images.shape[1:], np.float32)
    images[:, 9, 9] = rest[9, 9] = np.nan
    about = {"object": presses.object, "geometry": presses.geometry}
    about |= {"no_contact": rest} if with_rest else {}
    taught = Touches(images, **about)
    model = ObjectRecogniser(preset).fit(taught)
    assert model.classes_.tolist() == np.unique(presses.object).tolist()
    assert np.isfinite(model.log_likelihood(taught)).all()


def _electrodes(seed, n_each=12, sessions=1):
    """Return what six electrodes read of one load, and of what tells three things."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(["cup", "lid", "pot"], n_each)
    load = 40 * rng.normal(size=(len(labels), 1))
    tells = np.array([[1, -1, 0, 0, 0, 0], [0, 0, 1, -1, 0, 0], [0, 0, 0, 0, 1, -1]])
    levels = load + 2.5 * tells.repeat(n_each, axis=0)
    images = (levels + 0.5 * rng.normal(size=levels.shape))[:, np.newaxis]
    session = np.tile(np.arange(sessions), len(labels))[: len(labels)].astype(str)
    return Touches(images, object=labels, session=session, geometry="none")


@pytest.mark.parametrize(
    ("touches", "is_tried"),
    [
        (_electrodes(0, 16), True),
        (_electrodes(0, 15), False),  # fewer than eight for each electrode
        (_electrodes(0, 16, sessions=2), False),
    ],
    ids=["enough", "few", "of two sessions"],
)
def test_what_a_common_load_hides_is_told_by_directions(touches, is_tried):
    learnt = ObjectRecogniser().fit(touches)
    losses = {n: v["log_loss"] for n, v in learnt.chosen_["candidates"].items()}
    assert ("directions of taxels" in losses) == is_tried
    if is_tried:
        assert min(losses, key=losses.get) == "directions of taxels"
        assert learnt.score(_electrodes(1, 40)) > 0.95
        simple = make_pipeline(StandardScaler(), SVC(C=10))
        simple.fit(touches.images[:, 0], touches.object)
        new = _electrodes(1, 40)
        assert simple.score(new.images[:, 0], new.object) < 0.9
