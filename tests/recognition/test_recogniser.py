"""The recogniser and its belief on drawn touches whose answers are known."""

import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest
from joblib import parallel_config
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.recognition import Evidence, ModelFileError, ObjectRecogniser
from palpate.simulation import DomeCamera, simulate_touches

NAMES = ("ball", "mug", "pen")
LABELS = ["pen"] * 6 + ["mug"] * 6
NOISE = np.random.default_rng(0).random((12, 12, 12))
PRESETS = ("default", "corradi2015", "liu2014")
GEOMETRIES = ("dome", "array", "none")


def drawn(rng, n_each=24, noise=0.6):
    """Touches of objects that differ by one pattern each, in noise."""
    patterns = np.random.default_rng(7).normal(size=(3, 3, 24))
    images = np.repeat(patterns, n_each, axis=0)
    images = images + noise * rng.normal(size=images.shape)
    labels = np.repeat(NAMES, n_each)
    category = np.where(labels == "pen", "tool", "vessel")
    return Touches(images, object=labels, category=category, geometry="none")


@pytest.fixture(scope="module")
def recogniser():
    return ObjectRecogniser().fit(drawn(np.random.default_rng(0)))


@pytest.fixture
def test_touches(rng):
    return drawn(rng, n_each=6)


def test_a_recogniser_names_the_objects_that_it_learnt(recogniser, test_touches):
    for name, _, rows in test_touches.episodes():
        belief = recogniser.start()
        assert belief.posterior == pytest.approx(dict.fromkeys(NAMES, 0.95 / 3))
        assert belief.unknown == pytest.approx(0.05)
        assert belief.update(test_touches[rows]).best == name
        assert belief.decide(0.05) == name
        assert belief.touches_used == 6


@pytest.mark.parametrize("preset", ["default", "corradi2015"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_one_update_does_not_check_touches_again(preset, dtype):
    """`Touches` are checked when they are made; arrays that are none are refused."""
    camera = DomeCamera(image_shape=(60, 60), n_nodes=24)
    learnt = simulate_touches(NAMES, 6, camera, random_state=0)
    levels = Touches(learnt.images.astype(dtype), **learnt.columns, geometry="dome")
    belief, checks = ObjectRecogniser(preset).fit(levels).start(), []

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_name == "check_image_shape":
            checks.append(frame.f_back.f_code.co_name)

    sys.setprofile(note)
    try:
        belief.update(levels[3])
    finally:
        sys.setprofile(None)
    assert not checks
    for wrong, message in (
        (np.nan, "living taxel|NaN"),
        (np.inf, "infinit|finite"),
        (1e38, r"at most 1e\+37 in size, got .*Divide all"),
    ):
        with pytest.raises(ValueError, match=message):
            belief.update(np.full((60, 60), wrong))
    with pytest.raises(ValueError, match="must have 60 x 60"):
        belief.update(np.ones((60, 61)))
    assert belief.touches_used == 1


def test_touches_that_point_everywhere_are_never_named(recogniser):
    belief = recogniser.start()
    for column in (0, 1, 2) * 4:
        row = np.full(3, -5.0)
        row[column] = 0
        belief.update_from_log_likelihood(row)
    assert belief.unknown > 0.5
    assert belief.decide(0.5, refusal=1e-6) is None
    assert belief.decide(0.05, refusal=0.5) == "unknown"
    assert belief.reason(0.05, refusal=0.5).startswith("nothing I know (")
    # In a closed world all three are as probable as before.
    closed = recogniser.start(strangers=0)
    closed.update_from_log_likelihood(np.array([[0, -5, -5], [-5, 0, -5], [-5, -5, 0]]))
    assert closed.posterior == pytest.approx(dict.fromkeys(NAMES, 1 / 3))


def test_an_object_is_added_and_one_forgotten(rng):
    everything = drawn(rng)
    pens = everything.object == "pen"
    learnt = ObjectRecogniser().fit(everything[~pens])
    learnt.add_object("pen", everything[pens])
    assert learnt.classes_.tolist() == ["ball", "mug", "pen"]
    assert learnt.start().update(everything[pens][:3]).best == "pen"
    learnt.forget_object("mug")
    assert learnt.classes_.tolist() == ["ball", "pen"]
    assert learnt.start().update(everything[pens][:3]).best == "pen"
    with pytest.raises(ValueError, match="'ball', 'pen', got 'mug'"):
        learnt.forget_object("mug")
    with pytest.raises(ValueError, match="At least two objects must remain"):
        learnt.forget_object("pen")


def test_a_prior_by_counts_is_the_share_of_training_touches(rng):
    touches = drawn(rng)
    fewer = touches[np.r_[0:24, 24:36, 48:60]]
    start = ObjectRecogniser(prior="counts").fit(fewer).start(strangers=0)
    assert start.posterior == pytest.approx({"ball": 0.5, "mug": 0.25, "pen": 0.25})


def test_a_saved_recogniser_is_the_same_to_the_bit(tmp_path, rng, test_touches):
    learnt = ObjectRecogniser().fit(drawn(rng))
    again = ObjectRecogniser.load(learnt.save(tmp_path / "three.palpate"))
    assert_array_equal(
        again.log_likelihood(test_touches), learnt.log_likelihood(test_touches)
    )
    assert again.sequence_calibration_ == learnt.sequence_calibration_
    assert again.chosen_ == learnt.chosen_
    assert again.get_params() == learnt.get_params()
    assert again.start().update(test_touches[:3]).decide() == (
        learnt.start().update(test_touches[:3]).decide()
    )
    again.forget_object("mug")


@pytest.mark.parametrize("where", [0.02, 0.3, 0.6, 0.9, 0.999, 0, 1, 7, 100, 5000])
def test_a_damaged_or_truncated_model_is_refused(recogniser, tmp_path, where):
    path = recogniser.save(tmp_path / "m.palpate")
    content = bytearray(path.read_bytes())
    if isinstance(where, float):
        content[int(where * len(content))] ^= 0x15
    else:
        del content[where:]
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=r"m\.palpate"):
        ObjectRecogniser.load(path)


def test_the_stranger_model_follows_added_objects(rng):
    everything = drawn(rng, noise=3)
    pens = everything.object == "pen"
    grown = ObjectRecogniser().fit(everything[~pens])
    before = grown.strangers_.exceeded
    grown.add_object("pen", everything[pens])
    assert not np.array_equal(grown.strangers_.exceeded, before)
    whole = ObjectRecogniser().fit(everything)
    # Width and ridge were chosen without the third object, so not to the digit.
    # Nats of evidence for a stranger.
    assert grown.strangers_.threshold(1) == pytest.approx(
        whole.strangers_.threshold(1), abs=1.0
    )


def test_touches_that_rule_out_every_object_in_turn_leave_a_belief(test_touches):
    strict = ObjectRecogniser(floor=0).fit(test_touches)
    belief = strict.start(strangers=0)
    for out in range(3):
        row = np.zeros(3)
        row[out] = -np.inf
        belief.update_from_log_likelihood(row)
    assert belief.posterior == pytest.approx(dict.fromkeys(NAMES, 1 / 3))
    assert belief.unknown == 0


def test_likelihoods_as_far_apart_as_numbers_go_leave_a_belief(recogniser):
    belief = recogniser.start()
    belief.update_from_log_likelihood([1e308, 0.0, -1e308])
    alike = recogniser.start().update_from_log_likelihood([0.0, -1e6, -np.inf])
    assert belief.posterior == alike.posterior


@pytest.mark.parametrize(("floor", "least"), [(None, 1e-305), (0, 0)])
def test_probabilities_are_never_zero_unless_the_floor_is(rng, floor, least):
    recogniser = ObjectRecogniser(floor=floor).fit(drawn(rng, noise=0.05))
    belief = recogniser.start()
    belief.update_from_log_likelihood(np.repeat([[0.0, -999.0, -999.0]], 2000, axis=0))
    assert belief.log_posterior.min() < -1000
    assert (min(belief.posterior.values()) > least) == (floor is None)
    assert min(belief.categories.values()) >= least
    assert sum(belief.posterior.values()) + belief.unknown == pytest.approx(1)


def test_what_would_take_too_much_memory_is_refused_before_it_is_begun(
    rng, monkeypatch
):
    """Each of 12 touches takes 200 bytes an object, each of their 144 pairs 26."""
    few = drawn(rng, n_each=4)
    monkeypatch.setattr(ObjectRecogniser, "max_memory_gb", 10943e-9)
    refused = ObjectRecogniser()
    with pytest.raises(ValueError, match=r"got 3 labels and 12 touches.*raise Object"):
        refused.fit(few)
    assert not hasattr(refused, "encoder_")
    monkeypatch.setattr(ObjectRecogniser, "max_memory_gb", 10944e-9)
    learnt = ObjectRecogniser().fit(few)
    with pytest.raises(ValueError, match="got 4 labels and 16 touches"):
        learnt.add_object("box", few[:4])
    assert learnt.classes_.tolist() == sorted(NAMES)


def test_many_touches_are_encoded_in_shards_as_all_at_once(recogniser):
    many = drawn(np.random.default_rng(3), n_each=400)
    with parallel_config("threading", n_jobs=2):
        shards = recogniser.evidence(many)
    starts = 0, 400, 800
    parts = Evidence.together([recogniser.evidence(many[k : k + 400]) for k in starts])
    assert shards.flags == parts.flags
    # Products of other numbers of rows round differently in the last digit.
    for name in ("features", "log_likelihood", "by_encoding"):
        values = getattr(shards, name), getattr(parts, name)
        assert_allclose(*values, rtol=1e-9, atol=1e-12)


def test_a_belief_of_many_objects_shows_the_first_ten():
    rng = np.random.default_rng(0)
    names = [f"thing {number:02d}" for number in range(12)]
    learnt = ObjectRecogniser("corradi2015").fit(
        Touches(rng.random((48, 64, 64)), object=np.repeat(names, 4))
    )
    page = learnt.start()._repr_html_()
    assert page.count("<tr>") == 12
    assert "and 2 more" in page


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("preset", PRESETS)
def test_levels_too_large_to_add_up_are_refused(preset, geometry):
    recogniser, sizes = ObjectRecogniser(preset), (1e300, 1e160, 1e38)
    for size in sizes:
        with pytest.raises(ValueError, match=r"at most 1e\+37"):
            recogniser.fit(Touches(size * NOISE, object=LABELS, geometry=geometry))
    levels = np.where(np.arange(12)[:, None, None] < 6, NOISE, NOISE**2)
    recogniser.fit(Touches(levels, object=LABELS, geometry=geometry))
    for size in sizes:
        with pytest.raises(ValueError, match=r"at most 1e\+37"):
            recogniser.predict(Touches(size * NOISE, geometry=geometry))


def test_half_precision_is_learnt_as_single_is_without_a_warning():
    half = Touches(NOISE.astype(np.float16), object=LABELS, geometry="array")
    single = Touches(half.images.astype(np.float32), object=LABELS, geometry="array")
    posteriors = [ObjectRecogniser().fit(t).predict_proba(t) for t in (half, single)]
    assert_allclose(*posteriors, atol=1e-3)


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("preset", ["default", "corradi2015"])
@pytest.mark.parametrize("level", [0.0, 7.0, 1e-300])
@pytest.mark.parametrize("names", [("mug", "pen"), ("a", "b", "c", "d", "e", "f")])
def test_touches_that_are_all_alike_are_learnt_without_a_warning(
    preset, geometry, level, names
):
    images, objects = np.full((12, 20, 20), level), np.repeat(names, 12 // len(names))
    touches = Touches(images, object=objects, geometry=geometry)
    belief = ObjectRecogniser(preset).fit(touches).start().update(touches[:2])
    shares = dict.fromkeys(names, (1 - belief.unknown) / len(names))
    assert belief.posterior == pytest.approx(shares)


ONE_RUN = """
import sys
from pathlib import Path
import numpy as np
from palpate import ObjectRecogniser, Touches
images = np.random.default_rng(0).random((12, 12, 12))
images[:6] += np.eye(12)
touches = Touches(images, object=["pen"] * 6 + ["mug"] * 6)
ObjectRecogniser("liu2014").fit(touches).save(sys.argv[1])
"""


@pytest.mark.slow
def test_identical_runs_write_identical_model_files(tmp_path, monkeypatch):
    """One run has a process of its own, the other that of the tests."""
    paths = [tmp_path / f"{run}.palpate" for run in range(2)]
    command = [sys.executable, "-c", ONE_RUN, str(paths[0])]
    subprocess.run(command, check=True, timeout=120)
    monkeypatch.setattr(sys, "argv", ["", str(paths[1])])
    exec(ONE_RUN, {})
    digests = {sha256(path.read_bytes()).hexdigest() for path in paths}
    assert len(digests) == 1
