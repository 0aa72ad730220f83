"""A belief with places: contacts and misses move it as geometry says."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from ball_world import BallArm
from known_surfaces import standing_ellipse, with_head
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import NotFittedError

from palpate import Touches
from palpate.exploration import (
    Guard,
    Hemisphere,
    InformativeTouch,
    RandomHemisphere,
    SurfaceMap,
    TouchMap,
    TouchRecord,
    advice,
    as_touches,
    explore,
    explore_to_learn,
    put_down,
)
from palpate.recognition import Belief, ObjectRecogniser
from palpate.simulation import DomeCamera, find_object

CAMERA = DomeCamera(image_shape=(48, 48), n_nodes=24)
NAMES = ("box", "mug", "pen")
FAR = Hemisphere(radius_mm=400)


@pytest.fixture(scope="module")
def surface_map(recogniser, taught):
    return SurfaceMap(n_turns=12).fit(recogniser, taught)


@pytest.fixture(scope="module")
def low_map():
    """A map of touches by an arm that aims low, whatever stands there."""
    things = [find_object(name) for name in NAMES]
    options = {"n_sessions": 6, "faces": "all", "guarded": False, "known_height": False}
    taught = explore_to_learn(things, 36, CAMERA, **options)
    return SurfaceMap(n_turns=12).fit(
        ObjectRecogniser(rehearse=False).fit(taught), taught
    )


@pytest.fixture(scope="module")
def elsewhere_map(recogniser, taught):
    """A map of touches whose places are counted from above the table."""
    places = np.array(taught.columns["position_mm"])
    places[:, 2] += 300
    moved = taught.with_columns(position_mm=places)
    return SurfaceMap(n_turns=12).fit(recogniser, moved)


def _touched(surface_map, name, n_touches, seed=3, **where):
    where = {"yaw_rad": 0.7, "random_state": seed, **where}
    stand = put_down(find_object(name), CAMERA, **where)
    belief = surface_map.start_before(stand.hemisphere)
    strategy, history = RandomHemisphere(stand.hemisphere, seed), []
    for _ in range(n_touches):
        record = stand.touch_at_once(strategy.next_pose(belief, history))
        belief.update_from_record(record)
        history.append(record)
    return belief, history, stand


def test_object_face_and_pose_are_found(surface_map):
    for name, face in (("box", 2), ("pen", 0), ("mug", 1)):
        belief, _, stand = _touched(surface_map, name, 10, face=face)
        assert belief.best == name
        pose = belief.pose()
        assert (pose.object, pose.face) == (name, face)
        if name == "pen":
            off = (pose.turn_rad - stand.bench.target.yaw_rad + np.pi / 2) % np.pi
            assert abs(off - np.pi / 2) < np.deg2rad(15)
            assert f"turned by {np.degrees(pose.turn_rad):.0f}" in str(pose)
        off_mm = stand.bench.target.centre_mm - np.asarray(stand.hemisphere.centre_mm)
        # Recordings it was learnt from were themselves 5 mm aside; six contacts a side.
        assert np.hypot(*(off_mm - pose.offset_mm)[:2]) < 12


def test_probabilities_sum_to_one_and_a_copy_goes_on_by_itself(surface_map):
    belief, history, _ = _touched(surface_map, "mug", 3)
    total = sum(belief.posterior.values()) + belief.unknown
    assert total == pytest.approx(1)
    assert np.exp(belief.log_joint).sum() == pytest.approx(1)
    other, before = copy.copy(belief), belief.posterior
    other.update_from_record(history[0])
    assert belief.posterior == before != other.posterior


def test_half_of_a_touch_does_not_count_for_how_low_an_episode_came(
    surface_map, monkeypatch
):
    """Each attempt is weighed once, when picture, contact and count are all in."""
    counts, weigh = [], type(surface_map.start())._weigh

    def counted_weigh(belief):
        counts.append((belief.n_contacts, belief.touches_used))
        weigh(belief)

    _, history, stand = _touched(surface_map, "mug", 4)
    monkeypatch.setattr(type(surface_map.start()), "_weigh", counted_weigh)
    belief = surface_map.start_before(stand.hemisphere)
    expected = [(0, 0)]
    for record in history:
        contacts, touches = belief.n_contacts, belief.touches_used
        belief.update_from_record(record)
        touched = int(record.touched)
        met = record.outcome != "nothing"
        expected.append((contacts + met, touches + touched))
    assert counts == expected


def test_before_any_touch_the_belief_is_the_prior(surface_map):
    prior = {"box": 0.2, "mug": 0.5, "pen": 0.3}
    assert surface_map.start(prior, 0).posterior == pytest.approx(prior)


def test_a_surface_where_no_known_object_has_one_is_of_a_stranger(surface_map):
    belief, history, _ = _touched(surface_map, "pen", 4)
    fits = belief.unknown_evidence
    stranger = surface_map.start_before(Hemisphere(belief.centre_mm))
    for record in history:
        tip = np.asarray(record.position_mm) - 200 * record.direction
        stranger.update_from_record(
            TouchRecord("no frame", record.start, tuple(tip), force_n=record.force_n)
        )
    assert stranger.unknown_evidence > 3 > fits
    assert stranger.unknown > surface_map.start().unknown


def test_misses_are_evidence_and_faults_are_none(surface_map):
    belief = surface_map.start()
    before = belief.posterior
    pose = Hemisphere().pose(0.3, 0.1)
    failed = TouchRecord("robot error", pose, (0.0, 0.0, 0.0))
    assert belief.update_from_record(failed).posterior == before
    end = tuple(pose.advanced(315).position_mm)
    missed = TouchRecord("nothing", pose, end, travel_mm=315.0)
    after = belief.update_from_record(missed).posterior
    # Through the middle there is always the box; the pen may lie beside.
    assert after["box"] < before["box"]
    assert after["pen"] > before["pen"]


def test_a_stronger_press_is_a_deeper_contact(surface_map):
    tip, direction = np.array([[60.0, 0, 0]]), np.array([[-1.0, 0, 0]])
    usual = surface_map.middles(tip, direction, np.array([surface_map.force_n_]))
    harder = surface_map.middles(tip, direction, np.array([surface_map.force_n_ + 0.3]))
    unknown = surface_map.middles(tip, direction, np.array([np.nan]))
    assert_allclose(usual, [[80, 0, 0]])
    # 0.3 N at 0.3 N/mm: the same surface is met 1 mm earlier with the usual force.
    assert_allclose(harder, [[81, 0, 0]])
    assert_allclose(unknown, usual)


def test_a_sensor_pose_that_is_wrong_is_borne(surface_map):
    belief, history, stand = _touched(surface_map, "box", 8)
    wrong = surface_map.start_before(stand.hemisphere)
    turn, shift = np.deg2rad(2), np.array([1.2, -1.2, 1.0])
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    for record in history:
        touch = as_touches([record])
        wrong.update(
            touch.with_columns(
                position_mm=touch.columns["position_mm"] + shift,
                direction=touch.columns["direction"] @ rotation.T,
            )
        )
    assert wrong.best == belief.best == "box"
    assert wrong.posterior["box"] > 0.9


def test_the_surface_is_where_the_tip_was_stopped(surface_map):
    belief, history, _ = _touched(surface_map, "box", 10)
    points, covariances = belief.surface()
    assert points.shape[1:] == (3,)
    assert (np.linalg.eigvalsh(covariances) > 0).all()
    nearest = [
        np.linalg.norm(points - record.position_mm, axis=1).min() for record in history
    ]
    # Points are 15 degrees apart, up to 25 mm on the far ends.
    assert np.median(nearest) < 20


def test_the_surface_can_be_drawn_from_above(surface_map):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    belief, history, stand = _touched(surface_map, "box", 4)
    pose = stand.hemisphere.pose(0.0, 0.5)
    missed = TouchRecord("nothing", pose, (9.0, 8.0, 7.0), travel_mm=300.0)
    axes = belief.plot_surface([*history, missed])
    offsets = {
        collection.get_label(): collection.get_offsets()
        for collection in axes.collections
    }
    assert_allclose(offsets["met"], [record.position_mm[:2] for record in history])
    assert_allclose(offsets["nothing"], [[9, 8]])
    assert len(axes.patches) == len(offsets["expected"]) == len(belief.surface()[0])
    again = belief.plot_surface(history, start=pose)
    assert " ".join(again.get_title().split("\n")[1:]) == advice(belief, pose)
    arrow = again.texts[0]
    # The arrow comes from outside along the approach, here from the right.
    assert arrow.xyann[0] > arrow.xy[0] > belief.surface()[0][:, 0].max()
    pyplot.close("all")


@pytest.mark.slow
def test_a_mesh_stands_in_for_touches(recogniser, taught):
    thing = find_object("box")
    learnt = SurfaceMap(n_turns=12, use_pictures=False)
    learnt.fit(recogniser, taught, meshes={"box": thing})
    # All faces of a mesh are known.
    assert [face for name, face in learnt.states_ if name == "box"] == [0, 1, 2]
    assert [face for name, face in learnt.states_ if name == "pen"] == [-3, -2, -1, 0]
    assert learnt.other_share_[0] == 0 < learnt.other_share_[1]
    belief, _, _ = _touched(learnt, "box", 8)
    assert belief.best == "box"


# --- where next


def test_choosing_is_the_same_after_the_same_history(surface_map):
    belief, history, stand = _touched(surface_map, "mug", 3)
    strategy = InformativeTouch(surface_map, stand.hemisphere)
    pose = strategy.next_pose(belief, history)
    again = InformativeTouch(surface_map, stand.hemisphere)
    # Without the belief it follows the history itself.
    followed = again.next_pose(None, history)
    assert_allclose(pose.position_mm, followed.position_mm)
    gains = strategy.expected_gain(belief, history)
    assert np.isfinite(gains).all()
    assert gains.shape == (6 * 16,)


def test_an_attempt_far_from_all_that_is_known_tells_the_strategy_nothing(surface_map):
    _, history, stand = _touched(surface_map, "mug", 3)
    strategy = InformativeTouch(surface_map, stand.hemisphere)
    far = replace(history[-1], position_mm=(0.0, 0.0, 5000.0))
    with_far = strategy.expected_gain(None, [*history[:2], far, history[2]])
    again = InformativeTouch(surface_map, stand.hemisphere)
    assert_array_equal(with_far, again.expected_gain(None, history))


def test_the_next_touch_is_where_what_may_stand_there_differs(recogniser, taught):
    learnt = SurfaceMap(n_turns=12, use_pictures=False, other_faces=0.0)
    learnt.fit(recogniser, taught)
    round_one = standing_ellipse(60, 60)
    # Two things that differ in height alone, one that differs from both everywhere.
    taller = with_head(round_one, 90, np.deg2rad(60))
    surfaces = [round_one, taller, standing_ellipse(150, 150)]
    learnt.table_ = type(learnt.table_)(surfaces)
    learnt.choice_table_ = learnt.table_
    learnt.states_ = [("box", 0), ("mug", 0), ("pen", 0)]
    learnt.object_of_state_ = np.arange(3)
    learnt.picture_of_state_ = np.full(3, -1)
    belief = learnt.start({"box": 0.5, "mug": 0.5 - 1e-6, "pen": 1e-6}, 0)
    strategy = InformativeTouch(learnt)
    gains = strategy.expected_gain(belief, []).reshape(6, 16)
    # A fair question of two is worth log 2; the sides are the same on both.
    assert_allclose(gains[-1], np.log(2), atol=0.1)
    assert_allclose(gains[0], 0, atol=0.05)
    pose = strategy.next_pose(belief, [])
    assert pose.direction[2] < -0.8
    assert "above" in advice(belief, pose)


def test_seconds_are_a_cost(surface_map):
    belief, history, stand = _touched(surface_map, "mug", 1)
    dear = InformativeTouch(surface_map, stand.hemisphere, nats_per_second=100)
    cheap = InformativeTouch(surface_map, stand.hemisphere, nats_per_second=0)
    last = history[-1].direction
    far, near = (
        np.arccos(np.clip(strategy.next_pose(belief, history).direction @ last, -1, 1))
        for strategy in (cheap, dear)
    )
    # The nearest candidate: rings are 10 to 18 degrees apart, places on them 22.5.
    assert near < np.deg2rad(15) < far


def test_a_slow_arm_is_not_sent_to_the_same_place_again(surface_map):
    """No gain is worth its way there; what is nearest was touched just now."""
    belief, history, stand = _touched(surface_map, "mug", 1)
    slow = InformativeTouch(surface_map, stand.hemisphere, speed_mm_s=0.1)
    places = []
    for _ in range(4):
        places.append(slow.next_pose(belief, history))
        history.append(replace(history[0], start=places[-1]))
    assert len({pose.direction.tobytes() for pose in places}) == 4


def test_advice_is_a_sentence(surface_map):
    belief, _, stand = _touched(surface_map, "box", 4)
    sentence = advice(belief, stand.hemisphere.pose(0.0, 0.1))
    assert "from 3 o'clock, to tell the box from the " in sentence
    above = advice(belief, stand.hemisphere.pose(0.0, np.pi / 2))
    assert above.startswith("Touch the top, from straight above")
    alone = surface_map.recogniser.start()
    with pytest.raises(TypeError, match="must be a PlaceBelief, got Belief"):
        advice(alone, stand.hemisphere.pose(0.0, 0.1))


def test_an_episode_with_the_arm_ends_with_a_pose(surface_map):
    stand = put_down(find_object("pen"), CAMERA, yaw_rad=1.0, random_state=2)
    strategy = InformativeTouch(surface_map, stand.hemisphere)
    options = {"guard": stand.quick_guard, "clock": stand.robot.clock, "error": 0.05}
    end = explore(
        stand.robot, stand.sensor, surface_map, strategy, max_attempts=10, **options
    )
    assert end.decision == end.belief.pose().object == "pen"


class BlankSensor:
    """Shows the frame of no contact, whatever is touched."""

    image_shape = (48, 48)
    geometry = "dome"

    def read(self):
        return CAMERA.no_contact()

    def no_contact(self):
        return CAMERA.no_contact()


@pytest.mark.parametrize(
    ("by_places", "outcome"), [(True, "no frame"), (False, "touched")]
)
def test_a_contact_far_from_all_that_is_known_ends_no_episode(
    surface_map, tmp_path, by_places, outcome
):
    # Something stands near the hemisphere; what is known is some 100 mm at most.
    arm = BallArm(radius_mm=390.0, stiffness_n_mm=1.0)
    arm.pose = FAR.pose(0.0, 1.5)
    knower = surface_map if by_places else surface_map.recogniser
    strategy = InformativeTouch(surface_map, FAR)
    arms = arm, BlankSensor(), knower, strategy, tmp_path / "far"
    options = {"guard": Guard(lag_readings=0), "max_attempts": 2}
    end, again = (explore(*arms, **options) for _ in range(2))
    assert [record.outcome for record in end.history] == [outcome] * 2
    # Read again it says the same.
    told = end.to_dict(knower, strategy.hemisphere)
    assert told == again.to_dict(knower, strategy.hemisphere)
    messages = [attempt["message"] for attempt in told["attempts"]]
    told_once = [message.count("Is it another unit") for message in messages]
    assert told_once == [int(by_places)] * 2


def test_a_contact_whose_frame_cannot_be_taken_counts_at_once_and_when_read_again(
    surface_map, tmp_path
):
    other = DomeCamera(image_shape=(32, 32), n_nodes=24)
    stand = put_down(find_object("mug"), other, random_state=2)
    arm = stand.robot, stand.sensor, surface_map, RandomHemisphere(stand.hemisphere)
    options = {"guard": stand.quick_guard, "clock": stand.robot.clock}
    end, again = (
        explore(*arm, tmp_path / "mug", max_attempts=2, **options) for _ in range(2)
    )
    n_refused = sum(record.outcome == "no frame" for record in end.history)
    assert end.belief.n_contacts == n_refused > 0 == end.belief.touches_used
    assert again.belief.posterior == end.belief.posterior


# --- bad input


def test_the_pose_of_what_was_never_learnt_is_refused(surface_map):
    with pytest.raises(ValueError, match=r"name must be one of .*'pen', got 'fork'"):
        surface_map.start().pose("fork")


def test_touches_taken_in_together_are_believed_as_one_after_another(surface_map):
    belief, history, stand = _touched(surface_map, "box", 3)
    touches = as_touches(history)
    together = surface_map.start_before(stand.hemisphere).update(touches)
    assert together.flags == belief.flags
    assert_allclose(together.log_joint, belief.log_joint, atol=1e-6)
    # Encoded together and alone, features agree in single precision.
    assert together.unknown == pytest.approx(belief.unknown, abs=1e-5)
    assert together.posterior == pytest.approx(belief.posterior, abs=1e-5)


@pytest.mark.parametrize("name", ["position_mm", "direction"])
def test_a_touch_without_a_place_counts_by_its_picture(surface_map, name):
    belief, history, _ = _touched(surface_map, "mug", 1)
    lost = as_touches(history).with_columns(**{name: [[np.nan] * 3]})
    before = belief.filter.log_evidence
    belief.update(lost)
    assert_allclose(belief.filter.log_evidence, before)
    assert (belief.touches_used, belief.n_contacts) == (2, 1)


def test_places_missing_from_training_are_refused_with_their_touch(
    surface_map, recogniser, taught
):
    places = np.array(taught.columns["position_mm"])
    places[7] = np.nan
    with pytest.raises(ValueError, match=r"in touch 7, and no place in 1 of 108 "):
        SurfaceMap().fit(recogniser, taught.with_columns(position_mm=places))


def test_another_unit_or_frame_is_told_by_its_extent(surface_map, recogniser, taught):
    metres = np.array(taught.columns["position_mm"]) / 1000
    with pytest.raises(ValueError, match=r"must be millimetres.*Is it metres"):
        SurfaceMap().fit(recogniser, taught.with_columns(position_mm=metres))
    belief, history, _ = _touched(surface_map, "mug", 1)
    touch = as_touches(history)
    elsewhere = touch.with_columns(
        position_mm=np.asarray(touch.columns["position_mm"]) + 2000
    )
    with pytest.raises(ValueError, match=r"position_mm must be within \d+ mm .*frame"):
        belief.update(elsewhere)
    assert belief.touches_used == 1


def test_contacts_in_metres_are_told_from_the_third_on(surface_map):
    _, history, _ = _touched(surface_map, "mug", 8)
    touches = as_touches(history)
    tips = np.asarray(touches.columns["position_mm"]) / 1000
    metres = touches.with_columns(position_mm=tips)
    fresh = surface_map.start()
    with pytest.raises(ValueError, match=r"must be millimetres.*Is it metres\?"):
        fresh.update(metres)
    assert fresh.touches_used == fresh.n_contacts == 0
    assert fresh.posterior == surface_map.start().posterior


def test_a_miss_or_contact_far_from_the_object_is_refused(surface_map):
    belief = surface_map.start()
    before = belief.posterior
    pose = Hemisphere().pose(0.3, 0.1)
    end = tuple(np.array(pose.position_mm) + 5000)
    for outcome in ("nothing", "no frame"):
        with pytest.raises(ValueError, match="Is it another unit or frame"):
            belief.update(TouchRecord(outcome, pose, end, travel_mm=315.0))
        assert belief.posterior == before


def test_an_object_without_a_map_is_named(taught):
    few = np.flatnonzero(taught.object == "mug")[:4]
    rows = np.sort(np.concatenate([few, np.flatnonzero(taught.object != "mug")]))
    part = taught[rows]
    with pytest.raises(ValueError, match=r"got none for 'mug'.*fewer than 6 touches"):
        SurfaceMap().fit(ObjectRecogniser().fit(part), part)


def test_forces_that_are_all_missing_are_as_none(recogniser, taught):
    missing = taught.with_columns(force_n=np.full(len(taught), np.nan))
    surface_map = SurfaceMap(n_turns=4).fit(recogniser, missing)
    assert np.isnan(surface_map.force_n_)
    belief = surface_map.start().update(taught[[0]])
    assert sum(belief.posterior.values()) + belief.unknown == pytest.approx(1)


@pytest.mark.parametrize("kind", [SurfaceMap, TouchMap])
def test_a_map_that_learnt_nothing_is_refused(kind):
    for use in (InformativeTouch, kind.start):
        with pytest.raises(NotFittedError, match=f"{kind.__name__} has learnt"):
            use(kind())
    with pytest.raises(TypeError, match="a TouchMap or a SurfaceMap, got ObjectRec"):
        InformativeTouch(ObjectRecogniser())
    with pytest.raises(NotFittedError, match="It has learnt nothing yet"):
        kind().fit(ObjectRecogniser(), Touches(np.ones((1, 3, 3)), object=["mug"]))


@pytest.mark.parametrize("kind", ["surface_map", "touch_map"])
def test_a_map_of_other_objects_than_its_recogniser_knows_is_refused(
    kind, taught, surface_map, recogniser
):
    """Also where a new object took the place of another: its names are not theirs."""
    if kind == "touch_map":
        here = TouchMap(n_turns=4).fit(copy.deepcopy(recogniser), taught)
    else:
        here = copy.deepcopy(surface_map)
    here.start()
    pens = taught[taught.object == "pen"]
    here.recogniser.forget_object("pen").add_object("ball", pens)
    with pytest.raises(ValueError, match=r"got box, mug, pen\. Fit the map again"):
        here.start()
    with pytest.raises(ValueError, match=r"must have a column|must be those"):
        here.fit(here.recogniser, taught.without("direction", "object"))
    with pytest.raises(NotFittedError):
        here.start()


def test_touches_without_places_and_meshes_of_other_objects_are_refused(
    recogniser, taught
):
    kept = {"object": taught.object, "direction": taught.columns["direction"]}
    bare = Touches(taught.images, geometry="dome", **kept)
    learnt = ObjectRecogniser("corradi2015").fit(bare)
    with pytest.raises(ValueError, match="must have a column 'position_mm'"):
        SurfaceMap().fit(learnt, bare)
    with pytest.raises(ValueError, match="must be of learnt objects, got 'ball'"):
        SurfaceMap().fit(recogniser, taught, meshes={"ball": find_object("ball")})


# --- what was never learnt


def test_bodies_are_turned_where_the_ground_is_known(
    low_map, surface_map, elsewhere_map
):
    """Each body is turned three ways, aimed at one height or at its face's middle."""
    for learnt in (low_map, surface_map):
        assert learnt.turns_bodies_
        pens = [face for name, face in learnt.states_ if name == "pen"]
        assert pens == [-3, -2, -1, 0]
        # A next touch is chosen as if nothing were known of a face never learnt.
        pen = learnt.states_.index(("pen", -1))
        assert np.ptp(learnt.table_.mean_mm[pen]) > 10
        assert np.ptp(learnt.choice_table_.mean_mm[pen]) == 0
    # Counted from elsewhere, heights do not say where the ground is.
    assert not elsewhere_map.turns_bodies_
    assert {face for _, face in elsewhere_map.states_} == {-1, 0, 1, 2}


@pytest.mark.parametrize(("face", "expected"), [(0, 9.0), (-1, np.log(2))])
def test_pictures_like_nothing_are_those_of_a_stranger_or_of_a_body_turned(
    low_map, monkeypatch, face, expected
):
    surface_map = low_map
    monkeypatch.setattr(Belief, "unknown_evidence", property(lambda belief: 9.0))
    belief = surface_map.start()
    belief.log_joint = np.full(belief.log_joint.shape, -np.inf)
    row = surface_map.states_.index(("mug", face)) * surface_map.n_turns
    belief.log_joint[row] = 0.0
    belief._turned[surface_map.is_other_] = 1.0
    # No contact yet, which says nothing; e^9 against half of it is 2 but for 2e-4.
    assert_allclose(belief.unknown_evidence, expected, atol=1e-3)


def test_a_learnt_shape_does_not_rule_out_a_face_that_was_never_learnt(
    surface_map, elsewhere_map
):
    for learnt_map, share in ((surface_map, 3), (elsewhere_map, 2)):
        is_other = learnt_map.is_other_
        belief, _, _ = _touched(learnt_map, "mug", 6)
        shape = belief.filter.log_evidence.reshape(len(learnt_map.states_), -1)
        learnt = np.log(np.exp(shape[~is_other]).mean(axis=1))
        never = belief.log_place.reshape(shape.shape)[is_other, 0]
        # A third of such faces, or half where bodies are not turned, have the shape of
        # a learnt one of their size.
        shares = np.exp(learnt_map.log_alike_)
        assert_allclose(shares.sum(axis=1), 1)
        least = shares @ np.exp(learnt) / share
        assert (np.exp(never) >= least * (1 - 1e-9)).all()


def test_how_often_a_face_is_met_that_was_never_learnt(recogniser, taught, surface_map):
    # Each face of the box was met in two recordings of six: by Good and Turing no face
    # of one recording, and one recording more.
    assert_allclose(surface_map.other_share_[0], 1 / 7)
    usual = taught.with_columns(face=np.zeros(len(taught), int))
    one_face = SurfaceMap(n_turns=12).fit(recogniser, usual)
    assert_allclose(one_face.other_share_, 1 / 2)
    fixed = SurfaceMap(n_turns=12, other_faces=0.2).fit(recogniser, taught)
    assert_allclose(np.exp(fixed.log_share_of_state).sum() * 12, 3)
    assert_allclose(fixed.other_share_, 0.2)


def test_pictures_of_an_unlearnt_face_are_half_of_anything(surface_map):
    sure = np.log(np.array([[0.998, 0.001, 0.001]]))
    by_state = np.exp(surface_map.by_state(sure)[0])
    of_object = np.exp(sure[0])[surface_map.object_of_state_]
    expected = np.where(surface_map.is_other_, of_object / 2 + 1 / 6, of_object)
    assert_allclose(by_state, expected)
