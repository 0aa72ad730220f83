"""Adapting to another device: what is found again, what is kept, what is refused."""

from copy import deepcopy
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.encodings import ScaledPixels
from palpate.recognition import ObjectRecogniser, adapt, sessions_message
from palpate.simulation import DomeCamera, simulate_presses, simulate_touches

NAMES = ("ball", "mug", "pen")
CAMERA = DomeCamera(image_shape=(64, 64), n_nodes=24)
OTHER = DomeCamera(
    image_shape=(72, 72),
    n_nodes=24,
    disc_centre=(0.5, 0.5),
    disc_radius=0.45,
    gamma=1.8,
)


@pytest.fixture(scope="module")
def recogniser():
    touches = simulate_touches(NAMES, 16, CAMERA, drift=False, random_state=0)
    return ObjectRecogniser("corradi2015").fit(touches)


@pytest.fixture(scope="module")
def elsewhere():
    return simulate_touches(NAMES, 8, OTHER, drift=False, random_state=1)


def test_a_camera_that_sees_the_dome_elsewhere_is_found_again(recogniser, elsewhere):
    with pytest.raises(ValueError, match="64 x 64"):
        recogniser.log_likelihood(elsewhere)
    few = elsewhere[np.concatenate([[0, 1], [8, 9], [16, 17]])]
    adapted = adapt(recogniser, few)
    before, after = recogniser.encoder_.clean_up_, adapted.encoder_.clean_up_
    # The disc keeps its share of the rim, and is the rim the other camera shows: of
    # 0.45 heights of 72 pixels, to within the pixel that is the width of its edge.
    assert after.disc_radius_ / after.rim_radius_ == pytest.approx(
        before.disc_radius_ / before.rim_radius_
    )
    assert after.rim_radius_ == pytest.approx(0.45 * 72, abs=1.5)
    assert after.size_ == before.size_
    # Chance is 1/3; three standard errors of 24 touches above it are 0.62.
    assert adapted.score(elsewhere) > 0.62


def test_the_old_recogniser_stays_as_it_is(recogniser, elsewhere):
    features = recogniser.memory_.features.copy()
    shape = recogniser.encoder_.image_shape_
    adapt(recogniser, elsewhere)
    assert np.array_equal(recogniser.memory_.features, features)
    assert recogniser.encoder_.image_shape_ == shape


def test_a_model_that_was_adapted_is_saved(recogniser, elsewhere, tmp_path):
    adapted = adapt(recogniser, elsewhere)
    loaded = ObjectRecogniser.load(adapted.save(tmp_path / "m.palpate"))
    assert np.array_equal(
        loaded.log_likelihood(elsewhere), adapted.log_likelihood(elsewhere)
    )


def _session(offset, n, seed, name, objects="abcdef", labels=True):
    """Return touches of some of six objects, all moved by the offset of a session."""
    rng = np.random.default_rng(seed)
    centres = 5 * np.random.default_rng(99).normal(size=(6, 8))
    names = np.repeat(list(objects), n)
    images = centres[["abcdef".index(o) for o in names]]
    images = images + rng.normal(size=images.shape) + offset
    columns = {"object": names} if labels else {}
    session = [name] * len(names)
    return Touches(images[:, None], session=session, geometry="none", **columns)


OFFSET = np.array([6.0, -5, 4, 0, 7, -3, 5, 4])


@pytest.fixture(scope="module")
def _taught():
    return ObjectRecogniser().fit(_session(0, 12, 0, "one"))


@pytest.fixture
def taught(_taught):
    """Give a recogniser of six objects in one session, which may be changed."""
    return deepcopy(_taught)


def test_a_session_is_taken_off_without_labels(taught):
    there = _session(OFFSET, 12, 1, "two")
    before = taught.score(there)
    taught.remount(_session(OFFSET, 5, 2, "two", labels=False))
    record = taught.chosen_["remount"]
    assert before < 0.9
    assert taught.score(there) > 0.95
    assert not record["labelled"]
    assert record["n_touches"] == 30
    assert record["moved"] > 0.1


def test_a_session_of_few_objects_is_not_centred_onto_others(taught):
    same = _session(0, 12, 1, "two", "ab")
    taught.remount(_session(0, 10, 2, "two", "ab", labels=False))
    assert taught.chosen_["remount"]["objects"] < 4
    assert taught.score(same) > 0.95


def test_a_session_like_those_of_training_is_left_alone(taught):
    taught.remount(_session(0, 10, 2, "two", labels=False))
    assert taught.chosen_["remount"]["moved"] < 0.01


def test_confirmed_touches_of_two_objects_tell_the_others_too(taught):
    others = _session(3 * OFFSET, 12, 1, "two", "cdef")
    before = taught.score(others)
    taught.remount(_session(3 * OFFSET, 2, 2, "two", "ab"))
    assert taught.score(others) > max(before, 0.9)
    assert len(taught.memory_) == 76
    assert set(taught.memory_.sessions) == {"one", "two"}


def _postures(n_people, seed):
    """Twelve postures, each once of people who differ more than postures do."""
    rng = np.random.default_rng(seed)
    centres = 2 * np.random.default_rng(99).normal(size=(12, 4))
    what, who = np.tile(np.arange(12), n_people), np.repeat(np.arange(n_people), 12)
    bodies = 6 * rng.normal(size=(n_people, 2))[who]
    postures = centres[what] + rng.normal(size=(len(who), 4))
    subject = np.char.add(f"{seed} ", who.astype(str))
    return Touches(
        np.hstack([postures, bodies])[:, None],
        object=np.array(list("abcdefghijkl"))[what],
        subject=subject,
        geometry="none",
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_confirmed_touches_that_mislead_count_less(monkeypatch, tmp_path, seed):
    there = _postures(2, 100 + seed)
    # Each posture is confirmed of one person and tested on the other, where it is
    # nearer to confirmed postures of the same body than to itself.
    confirmed = np.tile([True, False], 12) == (np.arange(24) < 12)
    learnt = ObjectRecogniser(rehearse=False).fit(_postures(4, seed))
    now = adapt(learnt, there[confirmed])
    monkeypatch.setattr("palpate.recognition._remounting.N_WEIGHTS", 1)
    before = adapt(learnt, there[confirmed])
    assert now.score(there[~confirmed]) > before.score(there[~confirmed])
    weight = now.chosen_["remount"]["weight"]
    assert weight < 1 == before.chosen_["remount"]["weight"]
    assert_allclose(now.memory_.weights, np.repeat([1, weight], [48, 12]))
    # They count so after the file, and when more is learnt later.
    now.save(tmp_path / "m.palpate")
    again = ObjectRecogniser.load(tmp_path / "m.palpate")
    more = _postures(1, 7)
    again.extend_object("a", more[more.object == "a"])
    assert_allclose(again.memory_.weights, [*np.repeat([1, weight], [48, 12]), 1])


def test_confirmed_touches_that_recognise_each_other_count_in_full(taught):
    taught.remount(_session(OFFSET, 4, 1, "two"))
    assert taught.chosen_["remount"]["weight"] == 1
    assert (taught.memory_.weights == 1).all()


def test_what_training_sessions_add_is_taken_off_where_that_helps():
    far = -OFFSET[::-1]
    taught = [_session(0, 8, 0, "one"), _session(OFFSET, 8, 1, "two")]
    recogniser = ObjectRecogniser().fit(Touches.concatenate(taught))
    expected = recogniser.across_sessions()["expected"]
    recogniser.remount(_session(far, 8, 2, "three", labels=False))
    record = recogniser.chosen_["remount"]
    assert record["centred"]
    assert record["log_loss"]["centred"] < record["log_loss"]["plain"]
    assert recogniser.score(_session(far, 8, 3, "three")) > 0.95
    assert expected < 0.9


def test_objects_of_other_sessions_are_no_sessions_of_one_another():
    # Each session met objects of its own: what a session adds cannot be told.
    parts = [_session(0, 8, 0, "one", "abc"), _session(OFFSET, 8, 1, "two", "def")]
    recogniser = ObjectRecogniser().fit(Touches.concatenate(parts))
    assert "expected" not in recogniser.across_sessions()
    features = recogniser.memory_.features
    recogniser.remount(_session(0, 8, 2, "one", "abc", labels=False))
    assert np.array_equal(recogniser.memory_.features, features)


def test_nuisance_of_other_objects_is_weighed_down():
    # Sessions add any amount along one axis, which tells objects a little as well.
    axis = np.ones(8)

    def met(seed, objects, n_sessions, name):
        rng = np.random.default_rng(seed)
        return Touches.concatenate(
            [
                _session(axis * rng.normal(0, 12), 2, seed + k, f"{name} {k}", objects)
                for k in range(n_sessions)
            ]
        )

    recogniser = ObjectRecogniser().fit(_session(0, 12, 0, "one", "abc"))
    test = met(50, "abc", 12, "asked")
    before = recogniser.score(test)
    assert recogniser.learn_nuisance(met(20, "def", 8, "told")) == 24
    assert recogniser.score(test) > before + 0.1
    with pytest.raises(ValueError, match="columns 'object' and 'session'"):
        recogniser.learn_nuisance(_session(0, 4, 0, "one").without("session"))


def pressed_at_rest(n_each, seed):
    """Touches of an array, with a baseline that is far from 0."""
    parts = simulate_presses(["bar10", "disc13", "square13"], n_each, random_state=seed)
    rest = np.full((10, 10), 900, dtype=np.uint16)
    about = {"object": parts.object, "no_contact": rest, "geometry": "array"}
    return Touches(parts.images + rest, **about)


def touched(n_each, seed, side=48):
    """Touches by a dome's camera of so many pixels, with the frame of no contact."""
    camera = DomeCamera(image_shape=(side, side), n_nodes=24)
    names = ["ball", "box", "pen"]
    return simulate_touches(names, n_each, camera, drift=False, random_state=seed)


@pytest.mark.parametrize(
    ("preset", "recorded"),
    [
        pytest.param("default", pressed_at_rest, id="array"),
        pytest.param(
            "liu2014", pressed_at_rest, id="array, liu2014", marks=pytest.mark.slow
        ),
        pytest.param("default", touched, id="dome"),
    ],
)
@pytest.mark.parametrize("taught_with", [True, False])
def test_a_baseline_that_comes_or_goes_raises_no_alarm(
    tmp_path, preset, recorded, taught_with
):
    taught, new = recorded(12, 0), recorded(4, 1).without("object")
    taught = taught if taught_with else taught.without("no_contact")
    recogniser = ObjectRecogniser(preset).fit(taught)
    again = ObjectRecogniser.load(recogniser.save(tmp_path / "m.palpate"))
    for touches in (new, new.without("no_contact")):
        assert not recogniser.check_mounting(touches).changed
        assert not again.check_mounting(touches).changed


@pytest.mark.parametrize("remounted_with", [True, False])
def test_a_remounted_dome_is_asked_with_and_without_a_frame_of_no_contact(
    remounted_with,
):
    new = touched(8, 1, side=64).without("object", "category")
    bare = new.without("no_contact")
    recogniser = ObjectRecogniser().fit(touched(12, 0))
    recogniser.remount((new if remounted_with else bare)[:12])
    for touches in (new[12:], bare[12:]):
        assert not recogniser.check_mounting(touches).changed


def test_a_remounting_that_fails_leaves_the_recogniser_as_it_was(taught):
    state = taught.log_likelihood(_session(0, 2, 5, "x"))
    strange = _session(0, 2, 1, "two").with_columns(object=["spoon"] * 12)
    with pytest.raises(ValueError, match="known objects, got 'spoon', which was not"):
        taught.remount(strange)
    again = taught.log_likelihood(_session(0, 2, 5, "x"))
    assert np.array_equal(state, again)


def test_images_that_no_clean_up_finds_keep_their_size(pressed):
    larger = np.kron(_presses(4, 1).images, np.ones((1, 2, 2)))
    with pytest.raises(ValueError, match="12 x 12 taxels like the training touches"):
        pressed.remount(Touches(larger, geometry="array"))
    flat = _presses(4, 1).images.reshape(-1, 1, 144)
    with pytest.raises(ValueError, match=r"by 90 degrees; .* say `shape` as when"):
        pressed.predict(Touches(flat))


def test_touches_that_show_nothing_do_not_remount():
    learnt = simulate_touches(NAMES, 8, CAMERA, drift=False, random_state=0)
    recogniser = ObjectRecogniser().fit(learnt)
    idle = Touches(
        np.repeat(learnt.no_contact[None], 4, 0), no_contact=learnt.no_contact
    )
    with pytest.raises(ValueError, match="must show contact"):
        recogniser.remount(idle)


def test_a_remounted_model_adds_objects_in_the_new_session():
    recogniser = ObjectRecogniser().fit(_session(0, 12, 0, "one", "abcde"))
    recogniser.remount(_session(OFFSET, 8, 2, "two", "abcde", labels=False))
    recogniser.add_object("f", _session(OFFSET, 8, 3, "two", "f"))
    assert recogniser.score(_session(OFFSET, 10, 4, "two")) > 0.95


def test_of_an_object_that_is_extended_every_day_some_of_each_day_are_kept(taught):
    for day in range(4):
        more = _session(0, 6, 10 + day, f"day {day}", "a")
        taught.extend_object("a", more, most=10)
    sessions = taught.memory_.sessions[taught.memory_.labels == "a"]
    assert np.unique(sessions, return_counts=True)[1].tolist() == [2] * 5
    with pytest.raises(ValueError, match="most"):
        taught.extend_object("a", more, most=1)


def test_the_baseline_of_the_new_session_is_known_and_taken_off():
    rng = np.random.default_rng(0)
    presses = np.abs(rng.normal(0, 20, (20, 12, 12)))
    presses[10:, 6:] = 0
    zeros = rng.normal(0, 10, (2, 12, 12))
    names = ["whole"] * 10 + ["half"] * 10
    here, there = (
        Touches(presses + zero, object=names, no_contact=zero, geometry="array")
        for zero in zeros
    )
    encoder = ObjectRecogniser().fit(here).remount(there.without("object")).encoder_
    assert np.allclose(encoder.drift, zeros[0] - zeros[1])
    features = encoder.transform(there) - encoder.offset
    assert np.allclose(features, ObjectRecogniser().fit(here).encoder_.transform(here))


# The offset of one object alone cannot always be told from another object.
@pytest.mark.parametrize(("moved", "at_most"), [(0, 0), (1, 1)])
def test_a_session_of_one_object_is_not_centred_onto_another(taught, moved, at_most):
    lost = 0
    for name in "abcdef":
        again = deepcopy(taught)
        there = _session(0.3 * moved * OFFSET, 15, 3, "two", name)
        before = again.score(there)
        again.remount(there.without("object"))
        lost += again.score(there) < before - 0.1
    assert lost <= at_most


SIDE = 12
PARTS = ("bar", "disc", "ring")


def _presses(n, seed, gain=1.0):
    """Parts on an array of 12 x 12 whose noise moves every taxel."""
    rng = np.random.default_rng(seed)
    rows, cols = np.indices((SIDE, SIDE)) - 5.5
    away = np.hypot(rows, cols)
    shapes = np.abs(rows) < 2, away < 4, (away > 3) & (away < 5)
    names = np.repeat(PARTS, n)
    levels = np.repeat(np.stack(shapes), n, axis=0) * (
        10 * np.exp(rng.normal(0, 0.2, 3 * n))[:, np.newaxis, np.newaxis]
    )
    images = gain * (levels + rng.normal(0, 0.5, levels.shape))
    return Touches(images, object=names, geometry="array")


@pytest.fixture(scope="module")
def _pressed():
    return ObjectRecogniser().fit(_presses(20, 0))


@pytest.fixture
def pressed(_pressed):
    """Give a recogniser of presses of three parts, which may be changed."""
    return deepcopy(_pressed)


@pytest.mark.parametrize("labelled", [False, True])
@pytest.mark.parametrize(
    "gain",
    [
        pytest.param(0.4, marks=pytest.mark.slow),
        1.0,
        pytest.param(2.5, marks=pytest.mark.slow),
    ],
)
def test_the_gain_of_an_array_is_found_and_taken_off(pressed, gain, labelled):
    there = _presses(8, 1, gain)
    pressed.remount(there if labelled else there.without("object"))
    record = pressed.chosen_["remount"]
    assert record["gain"] == pytest.approx(1 / gain, rel=0.1)
    assert pressed.encoder_.gain == record["gain"]
    assert record["broken"] == 0
    assert pressed.score(_presses(20, 2, gain), np.repeat(PARTS, 20)) > 0.9


@pytest.mark.parametrize("level", [0.0, 40.0])
def test_taxels_that_are_stuck_are_filled_from_their_neighbours(pressed, level):
    there = _presses(8, 1)
    stuck = np.zeros((SIDE, SIDE), dtype=bool)
    stuck[[2, 5, 9], [7, 5, 1]] = True
    images = np.where(stuck, level, there.images)
    broken = Touches(images, object=there.object, geometry="array")
    few = deepcopy(pressed).remount(broken[::3].without("object"))
    assert few.encoder_.broken is None  # eight touches do not tell
    whole = pressed.log_likelihood(there)
    as_it_is = np.abs(pressed.log_likelihood(broken) - whole).mean()
    pressed.remount(broken.without("object"))
    assert np.array_equal(pressed.encoder_.broken, stuck)
    assert pressed.chosen_["remount"]["broken"] == 3
    assert np.abs(pressed.log_likelihood(broken) - whole).mean() < as_it_is / 2


def _beside(images):
    """The sum of both neighbours of each taxel: blurred, nothing is moved."""
    return np.roll(images, 1, axis=2) + np.roll(images, -1, axis=2)


def test_a_model_that_kept_no_looks_still_tells_by_distances(pressed):
    memory, same = pressed.memory_, _presses(4, 1)
    assert not pressed.check_mounting(same).changed
    pressed.memory_ = replace(memory, looks=np.full_like(memory.looks, np.nan))
    assert not pressed.check_mounting(same).changed
    assert pressed.check_mounting(Touches(same.images + 20, geometry="array")).changed
    pressed.remount(same.without("object"))
    assert pressed.chosen_["remount"]["gain"] == 1


def test_remounting_moves_touches_onto_training_and_reports_how_far(taught):
    before = taught.memory_
    variance = before.features.var(axis=0).sum()
    there = _session(OFFSET, 6, 2, "two")
    record = taught.remount(there).chosen_["remount"]
    assert (record["n_touches"], record["labelled"], record["broken"]) == (36, True, 0)
    shift = taught.encoder_.offset
    assert record["moved"] == pytest.approx((shift**2).sum() / variance)
    features = taught.encoder_.transform(there)
    means = [
        np.mean([f[labels == name].mean(axis=0) for name in "abcdef"], axis=0)
        for f, labels in (
            (features, there.object),
            (before.features, before.labels),
        )
    ]
    # The share of the shift that chance would make is held back.
    left = np.linalg.norm(means[0] - means[1])
    assert 0 < left < 0.05 * np.linalg.norm(shift)
    # Memory keeps the features that the recogniser gives touches from now on.
    kept, new = taught.memory_, slice(len(before), None)
    assert_allclose(kept.features[new], features, atol=1e-9)
    assert_allclose(kept.looks[new], taught.encoder_.look(there))
    # The touches are one group of their own, left out together.
    assert kept.labels[new].tolist() == there.object.tolist()
    assert kept.blocks[new].tolist() == [before.blocks.max() + 1] * 36


def test_remounting_again_begins_where_the_first_one_ended(taught):
    first = _session(OFFSET, 6, 2, "two", labels=False)
    second = _session(-OFFSET, 6, 3, "three", labels=False)
    taught.remount(first)
    there = taught.encoder_.offset
    twice = deepcopy(taught).remount(second)
    from_start = twice.encoder_.offset - there
    variance = taught.memory_.features.var(axis=0).sum()
    moved = twice.chosen_["remount"]["moved"]
    assert moved == pytest.approx((from_start**2).sum() / variance)
    # Back over the middle to the other side: twice as far as the first time.
    assert np.linalg.norm(from_start + 2 * there) < 0.6 * np.linalg.norm(there)
    assert twice.score(_session(-OFFSET, 10, 4, "three")) > 0.95


def test_touches_without_contact_are_no_part_of_a_session():
    rng = np.random.default_rng(5)
    names = np.repeat(["block", "bar"], 12)
    shapes = np.zeros((2, 10, 10))
    shapes[0, 3:7, 3:7], shapes[1, 4:6, 1:9] = 90, 60
    images = np.repeat(shapes, 12, axis=0) * rng.uniform(0.8, 1.2, (24, 1, 1))
    images = images + rng.normal(0, 0.3, images.shape)
    learnt = ObjectRecogniser().fit(Touches(images, object=names, geometry="array"))
    idle = rng.normal(0, 0.3, (9, 10, 10))
    presses = images[::3]
    plain, padded = (
        deepcopy(learnt).remount(Touches(levels, geometry="array"))
        for levels in (presses, np.concatenate([presses, idle]))
    )
    assert_allclose(padded.encoder_.offset, plain.encoder_.offset, atol=1e-9)
    assert padded.chosen_["remount"]["n_touches"] == 17
    # The check, too, is of those that show contact.
    checks = [
        learnt.check_mounting(levels)
        for levels in (presses, np.concatenate([presses, idle]))
    ]
    assert checks[0] == checks[1]
    nothing = learnt.check_mounting(idle)
    assert not nothing.changed
    assert (nothing.distance, nothing.usual) == (-np.inf, np.inf)
    assert nothing.reasons == ["Nothing was touched."]


def _of_persons(seed, twist, n_persons=3, n_days=2):
    """Return touches of six objects by persons on days; each visit twists an object."""
    rng = np.random.default_rng(seed)
    axis = np.array([1.0, 1, -1, 1, 1, -1, 1, -1])
    parts = []
    for person in range(n_persons):
        for day in range(n_days):
            for name in "abcdef":
                moved = twist * rng.normal() * axis
                name_of = f"{person} {day}"
                part = _session(moved, 2, int(rng.integers(1e9)), name_of, name)
                parts.append(part.with_columns(subject=[f"p{person}"] * len(part)))
    return Touches.concatenate(parts)


@pytest.mark.parametrize(("twist", "weighed"), [(12.0, True), (0.0, False)])
def test_session_differences_are_weighed_down_where_it_helps_other_persons(
    twist, weighed
):
    learnt = ObjectRecogniser().fit(_of_persons(0, twist))
    new = _of_persons(1, twist, n_persons=1)
    features = learnt.memory_.features
    record = learnt.remount(new.without("object", "subject")).chosen_["remount"]
    loss = record["log_loss"]
    # Without a twist all are told apart either way, and the losses are rounding.
    assert (loss["weighed"] < loss["centred"] - 1e-6) == weighed == record["weighed"]
    assert (learnt.encoder_.weighing is not None) == weighed
    if weighed:
        assert record["centred"]
        assert loss["weighed"] < 0.8 * loss["centred"]
        # A recogniser that is weighed is not weighed again.
        once = learnt.encoder_.weighing
        again = learnt.remount(new.without("object", "subject"))
        assert "weighed" not in again.chosen_["remount"]["log_loss"]
        assert np.array_equal(again.encoder_.weighing, once)
    elif not record["centred"]:
        assert np.array_equal(learnt.memory_.features, features)


def test_touches_are_weighed_by_how_sessions_of_the_other_half_of_persons_differ():
    """Halves are every other person by name; names within a half may be exchanged."""
    learnt = ObjectRecogniser().fit(_of_persons(0, 4.0, n_persons=4))
    new = _session(0, 3, 1, "new", labels=False)
    memory, losses = learnt.memory_, {}
    for order in ("0123", "2301", "1032", "0213"):
        other = deepcopy(learnt)
        renamed = np.array([f"p{order[int(name[1])]}" for name in memory.subjects])
        other.memory_ = replace(memory, subjects=renamed)
        record = other.remount(new).chosen_["remount"]
        losses[order] = record["log_loss"]["weighed"]
    assert losses["2301"] == pytest.approx(losses["0123"], rel=1e-6)
    assert losses["1032"] == pytest.approx(losses["0123"], rel=1e-6)
    assert losses["0213"] != pytest.approx(losses["0123"], rel=1e-6)


def test_touches_of_one_person_weigh_nothing_down():
    learnt = ObjectRecogniser().fit(_of_persons(0, 12.0, 1, 4))
    new = _of_persons(1, 12.0, 1, 1).without("object", "subject")
    record = learnt.remount(new).chosen_["remount"]
    assert set(record["log_loss"]) == {"plain", "centred"}
    assert not record["weighed"]


@pytest.mark.parametrize(("n_last", "enough"), [(4, True), (3, False)])
def test_twenty_differences_between_sessions_are_enough(taught, n_last, enough):
    parts = [
        _session(0, 1, 10 * day, f"{day}", name)
        for name in "abcdef"  # what was met on one day alone shows no difference
        for day in range({"e": n_last, "f": 1}.get(name, 4))
    ]
    touches = Touches.concatenate(parts)
    before = taught.memory_
    if enough:
        assert taught.learn_nuisance(touches) == 20
        expected = before.features @ taught.encoder_.weighing
        assert_allclose(taught.memory_.features, expected)
        return
    with pytest.raises(ValueError, match=r"at least 20 things .* got 19 differences"):
        taught.learn_nuisance(touches)
    assert taught.memory_ is before


def test_weighing_after_remounting_keeps_the_offset_of_the_session(taught):
    there = _session(OFFSET, 6, 2, "two", labels=False)
    taught.remount(there)
    features = taught.encoder_.transform(there)
    rng = np.random.default_rng(4)
    axes = [_session(3 * rng.normal(size=8), 2, k, f"{k}", "abcdef") for k in range(4)]
    taught.learn_nuisance(Touches.concatenate(axes))
    first = taught.encoder_.weighing
    assert_allclose(taught.encoder_.transform(there), features @ first, atol=1e-9)
    taught.learn_nuisance(Touches.concatenate(axes))
    second = np.linalg.solve(first, taught.encoder_.weighing)
    features = features @ first @ second
    assert_allclose(taught.encoder_.transform(there), features, atol=1e-9)


def test_accuracy_in_another_session_is_measured_on_sessions_left_out(taught):
    first, second, third = (
        _session(0, 3, k, name, objects)
        for k, (name, objects) in enumerate(
            [("one", "abcd"), ("two", "abc"), ("three", "ab")]
        )
    )
    learnt = ObjectRecogniser().fit(Touches.concatenate([first, second, third]))
    across = learnt.across_sessions()
    # a and b were met in three sessions, c in two, d in one: d cannot be tested.
    assert (across["least"], across["median"], across["asked"]) == (1, 2.5, 24)
    assert across["expected"] == 1.0
    assert taught.across_sessions() == {"least": 1, "median": 1.0, "asked": 0}
    taught.memory_ = replace(taught.memory_, sessions=np.full(72, ""))
    assert taught.across_sessions() == {"least": 1, "median": 1.0, "asked": 0}
    far = [_session(k * 40.0 * np.ones(8), 3, k, f"{k}", "abc") for k in range(2)]
    lost = ObjectRecogniser().fit(Touches.concatenate(far)).across_sessions()
    assert lost["expected"] < 0.7  # of three


def test_a_session_that_is_there_twice_tells_nothing_of_another_day():
    first, again = (_session(0, 3, 0, name, "abc") for name in ("one", "copied"))
    other = _session(OFFSET, 3, 1, "two", "abc")
    twice = ObjectRecogniser().fit(Touches.concatenate([first, again]))
    across = twice.across_sessions()
    assert (across["asked"], "expected" in across) == (0, False)
    three = ObjectRecogniser().fit(Touches.concatenate([first, again, other]))
    assert three.across_sessions()["asked"] == len(other)


def test_a_session_left_out_chose_nothing_but_the_encoding(monkeypatch):
    """Machines choose widths and ridges without it, by blocks of the other session."""
    days = [_session(0, 6, 0, "one"), _session(OFFSET / 3, 6, 1, "two")]
    learnt = ObjectRecogniser().fit(Touches.concatenate(days))
    fits, fit = [], type(learnt.classifier_).fit

    def watched(machine, X, y, groups=None):
        fits.append((np.asarray(X), np.asarray(y), np.asarray(groups)))
        return fit(machine, X, y, groups)

    monkeypatch.setattr(type(learnt.classifier_), "fit", watched)
    learnt.across_sessions()
    memory = learnt.memory_
    assert len(fits) == 2
    for (taught, labels, groups), session in zip(fits, ("one", "two"), strict=True):
        assert np.array_equal(taught, memory.features[memory.sessions != session])
        for name in np.unique(labels):
            assert len(np.unique(groups[labels == name])) > 1


def test_the_sentence_on_another_day_counts_sessions_and_touches():
    assert sessions_message({"least": 1, "median": 1.0, "asked": 0}) == (
        "Taught in 1 session an object, and none in two: on another day, or mounted "
        "anew, expect less than today. Only touches of another session can show how "
        "much less."
    )
    across = {"least": 3, "median": 3.0, "asked": 40, "expected": 0.756}
    assert sessions_message(across) == (
        "Taught in 3 sessions an object: expect about 76 % right after one touch in "
        "another one (40 touches of sessions left out whole)."
    )
    across = {"least": 1, "median": 1.0, "asked": 0, "rehearsed": [0.614, 0.83]}
    message = sessions_message(across)
    assert "expect about 61 to 83 % right after one touch on another day" in message
    assert "confirmed" not in message
    message = sessions_message(across | {"confirmed": [1.0, 0.999]})
    assert "sessions were (100 % with one confirmed touch of each); only" in message


def _discs(rng, n, moved=(0, 0), radius=27.0):
    """Discs before a dark surround, with a dent of two widths."""
    row, col = np.mgrid[:60, :60] - 29.5
    row, col = row - moved[0], col - moved[1]
    at = rng.uniform(-8, 8, (2, n, 2, 1, 1))
    squared = (row - at[:, :, 0]) ** 2 + (col - at[:, :, 1]) ** 2
    dents = np.exp(-squared / (2 * np.array([3, 8])[:, None, None, None] ** 2))
    inside = np.hypot(row, col) < radius
    images = 10 + inside * (120 + 100 * dents.reshape(-1, 60, 60))
    names = np.repeat(["ball", "pen"], n)
    images = images + rng.normal(0, 2, images.shape)
    return Touches(images, object=names, geometry="dome")


@pytest.fixture(scope="module")
def rimmed():
    """Give a recogniser of discs about one place."""
    return ObjectRecogniser("corradi2015").fit(_discs(np.random.default_rng(0), 8))


@pytest.mark.parametrize(
    ("moved", "radius", "message"),
    [
        ((0, 0), 27.0, None),
        # Three hundredths of the radius are 0.8 pixels.
        ((0.0, 0.4), 27.0, None),
        ((3, -4), 24.0, "5 pixels from where it was learnt, and is 11 % smaller"),
        ((-1.5, 0), 27.0, "pixels from where it was learnt, and is"),
        ((0, 0), 29.0, "0 pixels from where it was learnt, and is 7 % larger"),
    ],
)
def test_a_rim_that_lies_elsewhere_is_a_reason_for_the_alarm(
    rimmed, moved, radius, message
):
    test = _discs(np.random.default_rng(1), 4, moved, radius)
    reasons = rimmed.check_mounting(test).reasons
    rim = [reason for reason in reasons if reason.startswith("The rim lies")]
    assert len(rim) == (message is not None)
    if message:
        assert message in rim[0]
        assert reasons[-1] == rim[0]


def _parts_of(reason):
    """Return the number in a reason, and the words about it."""
    before, after = reason.split(" times ")
    words = before.rsplit(" ", 1)
    return float(words[1]), f"{words[0]} {after}"


@pytest.mark.parametrize("gain", [0.7, 0.8, 1.25, 1.5])
def test_another_gain_is_reported_with_its_factor(pressed, gain):
    there = _presses(4, 1, gain).without("object")
    check = pressed.check_mounting(there)
    assert check.changed
    times, words = _parts_of(check.reasons[0])
    # Twelve loads that vary by a fifth, told to a tenth.
    assert times == pytest.approx(max(gain, 1 / gain), abs=0.12)
    comparison = "stronger" if gain > 1 else "weaker"
    assert words == f"These 12 touches press {comparison} than training touches."
    # Once remounted, the recogniser raises no alarm.
    assert not pressed.remount(there).check_mounting(there).changed


@pytest.mark.parametrize(
    ("change", "detail"),
    [
        (lambda images: 0.6 * images + 0.2 * _beside(images), "fine detail weaker"),
        (lambda images: 0.8 * images + 0.1 * _beside(images), "fine detail weaker"),
        (
            lambda images: images + 3 * np.outer(np.hanning(SIDE), np.hanning(SIDE)),
            "coarse detail stronger",
        ),
    ],
    ids=["blurred", "a little blurred", "bulging"],
)
def test_another_detail_is_reported_with_its_factor(pressed, change, detail):
    other = Touches(change(_presses(4, 1).images), geometry="array")
    check = pressed.check_mounting(other)
    assert check.changed
    times, words = _parts_of(check.reasons[0])
    assert words == f"These 12 touches show {detail} than training touches."
    # Looks are logarithms of power in octaves, the coarsest first, and of the load.
    looks, memory = pressed.evidence(other).looks.mean(axis=0), pressed.memory_
    differences = np.abs(looks - memory.looks.mean(axis=0))[:-1] / 2
    octaves = slice(0, 4) if "coarse" in detail else slice(4, 6)
    assert np.abs(np.exp(differences[octaves]) - times).min() < 0.1
    assert not pressed.remount(other).check_mounting(other).changed


def test_touches_farther_than_usual_raise_the_alarm(taught):
    there = _session(3 * OFFSET, 2, 1, "two")
    check = taught.check_mounting(there)
    assert check.changed
    times, words = _parts_of(check.reasons[0])
    assert words == (
        "These 12 touches lie as far from training touches as those from each other."
    )
    log_distances = taught.evidence(there).log_distances.min(axis=1)
    memory = taught.memory_
    # The usual distance of training touches is that to other blocks.
    distances = np.linalg.norm(memory.features[:, None] - memory.features, axis=2)
    distances[memory.blocks[:, None] == memory.blocks] = np.inf
    usual = np.log(distances.min(axis=1)).mean()
    assert times == pytest.approx(np.exp(log_distances.mean() - usual), rel=0.15)


def test_the_evidence_of_touches_checks_the_mounting_as_they_do(taught):
    for moved in (0, 3):
        there = _session(moved * OFFSET, 2, 1, "two")
        assert taught.check_mounting(taught.evidence(there)) == (
            taught.check_mounting(there)
        )


@pytest.mark.parametrize(
    "n_objects",
    [
        pytest.param(1, marks=pytest.mark.slow),
        pytest.param(3, marks=pytest.mark.slow),
        6,
    ],
)
def test_of_sessions_as_before_one_in_twenty_raises_the_alarm(n_objects):
    """Sessions of few objects do so as well, though these lie to one side of all.

    A changed mounting raises it nearly always.
    """
    rng, alarms = np.random.default_rng(0), {0: 0, 1: 0}
    for seed in range(3):
        learnt = ObjectRecogniser().fit(_session(0, 20, seed, "one"))
        for draw, moved in product(range(30), alarms):
            names = rng.permutation([*"abcdef"])[:n_objects]
            there = _session(moved * OFFSET, 12, 100 + draw, "two", names, labels=False)
            check = learnt.check_mounting(there[rng.permutation(len(there))[:10]])
            assert (
                check.changed == (check.distance > check.usual) == bool(check.reasons)
            )
            alarms[moved] += check.changed
    # 4.5 of 90 are the aim, and three standard deviations above it are 10.7.
    assert alarms[0] <= 10
    assert alarms[1] >= 86


def test_touches_that_all_lie_to_one_side_raise_the_alarm(taught):
    """Each value is off by less than its noise, but always to the same side."""
    there = _session(0.9 * np.sign(OFFSET), 8, 1, "two", labels=False)
    check = taught.check_mounting(there)
    assert check.changed
    times, words = _parts_of(check.reasons[0])
    assert words == (
        "These 48 touches all lie to one side of what they are taken for, as far as "
        "training touches do."
    )
    assert times > 2


def test_of_very_many_touches_a_part_shows_what_to_expect_of_another_day(monkeypatch):
    parts = [_session(0, 8, 0, "one"), _session(OFFSET / 9, 8, 1, "two")]
    touches = Touches.concatenate(parts)
    monkeypatch.setattr("palpate.classifiers._touch_classifier.MOST_ANSWERS", 300)
    learnt = ObjectRecogniser(None, encodings={"levels": ScaledPixels()}).fit(touches)
    assert len(learnt.left_out_rows) < len(touches)
    across = learnt.across_sessions()
    # Of each object touches of both sessions are asked, of all 96 there are.
    assert (across["least"], across["median"], across["asked"]) == (2, 2.0, 96)
    assert 0.5 < across["expected"] <= 1
    assert not learnt.check_mounting(_session(0, 3, 2, "three", labels=False)).changed
    today = _session(OFFSET / 3, 3, 2, "three")
    learnt.remount(_session(OFFSET / 3, 3, 2, "three", labels=False))
    assert not learnt.chosen_["remount"]["labelled"]
    assert learnt.score(today) > 0.5
