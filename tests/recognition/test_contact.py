"""Flags of touches: no contact, which is no evidence, saturated, double or turned."""

import numpy as np
import pytest

from palpate import Touches
from palpate.recognition import ObjectRecogniser, _contact

NAMES = ["block"] * 12 + ["bar"] * 12
PADS = [[0, 0, 9, 9], [0, 11, 9, 9]]


def pressed(shape=(9, 20), seed=0):
    """Two shapes on the left of a quiet picture of taxels."""
    images = np.random.default_rng(seed).integers(0, 4, (24, *shape)).astype(float)
    images[:12, 3:7, 3:6] += 120
    images[12:, 3:5, 1:8] += 60
    return images


def hand_of(images):
    """Two pads with a gap of two columns between them."""
    gapped = images.copy()
    gapped[:, :, 9:11] = np.nan
    return gapped


class AsTheyAre:
    """Leaves images as they are, for a check that looks at them after clean-up."""

    def clean(self, touches):
        return touches.images


@pytest.fixture
def check(monkeypatch):
    """Fit a contact check to touches whose geometry is what they say."""
    monkeypatch.setattr(_contact, "find_geometry", lambda touches: touches.geometry)

    def fit(images, **about):
        names = np.resize(NAMES, len(images))
        touches = Touches(images, object=names, **about)
        return _contact.ContactCheck().fit(touches, AsTheyAre())

    return fit


def flags(check, images, novelty=None, **about):
    touches = Touches(np.asarray(images), **about)
    return check.flags(touches, touches.images, novelty)


def test_taxels_outside_every_pad_do_not_count(check):
    images = hand_of(pressed())
    hand = check(images, geometry="array", pads=PADS)
    change = images[:, :, np.r_[:9, 11:20]].reshape(24, -1)
    assert hand.typical_ == pytest.approx(np.median(np.sqrt((change**2).mean(axis=1))))
    dirt = np.zeros((2, 9, 20))
    dirt[0, :, 9:11] = 500
    dirt[1, 3:7, 3:6] = 120
    assert flags(hand, dirt) == ["no contact", ""]


def test_small_pads_are_never_double(check):
    small = check(pressed(), geometry="array", pads=[[0, 0, 9, 7]])
    double = np.zeros((1, 9, 20))
    double[:, 0:3, 0:3] = double[:, 6:9, 4:7] = 120
    assert flags(small, double) == [""]


def test_channels_count_together(check):
    images = np.stack([pressed(), -0.5 * pressed(seed=1)], axis=-1)
    about = {"channels": ["x", "y"], "geometry": "array"}
    both = check(images, **about, no_contact=np.zeros((9, 20, 2)))
    assert both.idle_.shape == (9, 20, 2)
    size = np.sqrt((images**2).mean(axis=(1, 2, 3)))
    assert both.typical_ == pytest.approx(np.median(size))
    faint, single, double = np.zeros((3, 9, 20, 2))
    faint[2, 2] = 2
    single[3:7, 3:6, 1] = 120
    double[1:4, 1:4, 0] = double[5:8, 12:16, 1] = 100
    touch_flags = flags(both, np.stack([faint, single, double]), channels=["x", "y"])
    assert touch_flags == ["no contact", "", "double contact"]


def test_a_colour_camera_is_compared_with_its_frame_of_no_contact(check):
    rng = np.random.default_rng(2)
    frame = rng.uniform(50, 200, (9, 20, 3))
    dents = frame + rng.normal(scale=60, size=(24, 9, 20, 3))
    about = {"channels": ["r", "g", "b"]}
    camera = check(dents, geometry="plane", no_contact=frame, **about)
    idle_image = frame * 1.1 + rng.normal(size=frame.shape)
    touch_flags = flags(camera, np.stack([idle_image, dents[0]]), **about)
    assert touch_flags == ["no contact", ""]


def test_a_plane_of_pads_is_compared_on_them_alone(check):
    rng = np.random.default_rng(3)
    frame = rng.uniform(50, 60, (9, 20))
    frame[:, 9:11] = 5000  # the same in every picture, and so no sign of anything
    dents = frame + rng.normal(scale=30, size=(24, 9, 20)) * (frame < 5000)
    about = {"geometry": "plane", "no_contact": frame}
    for pads in ({}, {"pads": PADS}):
        learnt = check(dents, **about, **pads)
        assert flags(learnt, dents[:1]) == [""]
        assert flags(learnt, frame[np.newaxis]) == ["no contact"]


def test_models_of_hands_keep_their_pads(tmp_path):
    touches = Touches(hand_of(pressed()), object=NAMES, geometry="array", pads=PADS)
    learnt = ObjectRecogniser().fit(touches)
    again = ObjectRecogniser.load(learnt.save(tmp_path / "hand.palpate"))
    np.testing.assert_array_equal(again.contact_.pads_, PADS)
    before, after = (model.log_likelihood(touches) for model in (learnt, again))
    np.testing.assert_array_equal(before, after)
    pinch, double, empty = np.zeros((3, 9, 20))
    pinch[3:6, 3:6] = pinch[3:6, 14:17] = 120
    double[0:3, 0:3] = double[6:9, 6:9] = 120
    for model in (learnt, again):
        evidence = model.evidence(Touches(np.stack([pinch, double, empty])))
        assert evidence.flags == ["", "double contact", "no contact"]
        assert not evidence.log_likelihood[2].any()


def mixed(share, frame, other):
    """Return an image whose correlation with a frame is given."""
    centred_frame, centred_other = (image - image.mean() for image in (frame, other))
    centred_other -= (
        (centred_frame * centred_other).sum() / (centred_frame**2).sum() * centred_frame
    )
    centred_other *= np.linalg.norm(centred_frame) / np.linalg.norm(centred_other)
    return 50 + 7 * (share * centred_frame + np.sqrt(1 - share**2) * centred_other)


@pytest.mark.parametrize(
    ("geometry", "typical", "limit"),
    [
        # The limit of a dome is the same, however like the frame its touches are;
        # so is that of a plane whose touches are unlike it.
        ("dome", 0.5, 0.985),
        ("dome", 0.99, 0.985),
        ("plane", 0.5, 0.985),
        # Else it is a quarter of what a middling touch is unlike the frame.
        ("plane", 0.98, 0.995),
    ],
)
def test_a_camera_sees_no_contact_where_it_sees_the_frame(
    check, geometry, typical, limit
):
    rng = np.random.default_rng(1)
    frame, others = rng.random((9, 20)), rng.random((24, 9, 20))
    taught = [mixed(typical, frame, other) for other in others]
    camera = check(np.stack(taught), geometry=geometry, no_contact=frame)
    near = [mixed(limit + step, frame, others[0]) for step in (5e-4, -5e-4, 0.004)]
    assert flags(camera, np.stack(near)) == ["no contact", "", "no contact"]


@pytest.mark.parametrize("geometry", ["dome", "plane", "none"])
def test_without_a_frame_only_arrays_tell_no_contact(check, geometry):
    blind = check(pressed(), geometry=geometry)
    assert blind.kind_ == ""
    assert flags(blind, np.zeros((2, 9, 20))) == ["", ""]
    assert check(pressed(), geometry="array").kind_ == "array"


@pytest.mark.parametrize("rest_level", [0.0, 30.0])
def test_an_array_is_pressed_from_three_hundredths_of_a_middling_touch(
    check, rest_level
):
    frame = rest_level + np.random.default_rng(2).random((9, 20))
    images = frame + pressed()
    about = {"no_contact": frame} if rest_level else {}
    array = check(images if rest_level else pressed(), geometry="array", **about)
    size = np.median(np.sqrt((pressed() ** 2).mean(axis=(1, 2))))
    assert array.typical_ == pytest.approx(size)
    # Up or down: a change is a change.
    presses = [
        frame * bool(rest_level) + share * size for share in (0.029, 0.031, -0.031)
    ]
    touch_flags = flags(array, np.stack(presses), **about)
    assert touch_flags == ["no contact", "", ""]


@pytest.mark.parametrize("geometry", ["array", "none"])
@pytest.mark.parametrize("known", [True, False])
def test_touches_are_seen_from_their_own_frame_where_changes_were_learnt(
    check, geometry, known
):
    """Else what was learnt is large by the levels of rest, and changes look faint."""
    frame, other = np.full((2, 9, 20), 5000.0) + np.eye(9, 20) * [[[1]], [[900]]]
    about = {"geometry": geometry, "no_contact": frame if known else None}
    learnt = check(frame + pressed(), **about)
    asked = other + np.concatenate([pressed(seed=1), np.zeros((1, 9, 20))])
    expected = [""] * 24 + ["no contact" if known else ""]
    assert flags(learnt, asked, no_contact=other) == expected


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.float16])
def test_whole_numbers_are_compared_with_rest_as_floats_are(check, dtype):
    images = (pressed() + 3).astype(dtype)
    frame = np.full(images.shape[1:], 3, dtype=dtype)
    array = check(images, geometry="array", no_contact=frame)
    as_floats = images.astype(float), frame.astype(float)
    exact = check(as_floats[0], geometry="array", no_contact=as_floats[1])
    assert array.typical_ == exact.typical_
    assert array.tells_double_ == exact.tells_double_
    faint = frame.copy()
    faint[0] -= 1
    assert flags(array, faint[np.newaxis], no_contact=frame) == ["no contact"]


def test_touches_that_never_change_leave_a_unit_of_one(check):
    assert check(np.zeros((24, 9, 20)), geometry="array").typical_ == 1


@pytest.mark.parametrize(
    ("dtype", "geometry", "low", "high"),
    [
        # An array at rest is full of taxels at the lowest level.
        (np.uint8, "array", False, True),
        (np.uint8, "plane", True, True),
        (np.int16, "plane", True, True),
        (np.float64, "plane", False, False),
    ],
)
def test_saturated_is_more_at_the_limit_than_in_training(
    check, dtype, geometry, low, high
):
    limits = np.iinfo(dtype if dtype != np.float64 else np.uint8)
    images = np.random.default_rng(0).integers(100, 150, (24, 10, 10)).astype(dtype)
    ends = {"low": (limits.min, low), "high": (limits.max, high)}
    for level, is_limit in ends.values():
        for usual in (0, 3):
            taught = images.copy()
            taught.reshape(24, -1)[:, :usual] = level
            learnt = check(taught, geometry=geometry, no_contact=np.full((10, 10), 90))
            # Five in a hundred taxels more are still as in training.
            touches = images[:2].copy()
            for touch, count in zip(touches, (5, 6), strict=True):
                touch.reshape(-1)[: usual + count] = level
            expected = ["", "saturated" if is_limit else ""]
            assert flags(learnt, touches) == expected


def test_the_usual_share_at_the_limit_is_the_99_percent_quantile(check):
    images = np.full((24, 10, 10), 100, np.uint8) + np.eye(10, dtype=np.uint8)
    images[0, :5] = 255
    learnt = check(images, geometry="plane")
    # The 99 % quantile of 23 zeros and 0.5 lies 0.77 of the way to the last.
    assert learnt.at_limit_ == pytest.approx(0.5 * (0.99 * 23 - 22))


@pytest.mark.parametrize(
    ("regions", "flag"),
    [
        ([(0, 0, 2, 8), (5, 2, 2, 2)], "double contact"),  # 16 and 4 taxels
        ([(0, 0, 2, 8), (5, 2, 1, 4)], "double contact"),
        ([(0, 0, 2, 8), (5, 2, 4, 1)], "double contact"),
        ([(0, 0, 2, 8), (5, 2, 1, 3)], ""),  # 16 and 3
        ([(0, 0, 2, 8), (5, 2, 3, 1)], ""),
        ([(0, 0, 8, 2), (0, 5, 1, 3)], ""),
        ([(0, 0, 8, 2), (0, 5, 1, 4)], "double contact"),
        ([(0, 0, 2, 8), (5, 0, 1, 3), (5, 5, 1, 3), (7, 8, 1, 3)], ""),
        ([(0, 0, 2, 8), (2, 8, 2, 8)], ""),  # corner to corner is one
        ([(0, 0, 2, 8), (3, 8, 2, 8)], "double contact"),
        ([(3, 3, 4, 4)], ""),
        ([(3, 3, 3, 3), (3, 14, 3, 3)], "double contact"),  # two fingers, without pads
    ],
)
def test_double_is_a_second_region_of_a_quarter_of_the_first(check, regions, flag):
    image = np.zeros((1, 9, 20))
    for row, col, n_rows, n_cols in regions:
        image[0, row : row + n_rows, col : col + n_cols] = 100
    array = check(pressed(), geometry="array")
    for sign in (1, -1):  # a change is a change
        assert flags(array, sign * image) == [flag]


@pytest.mark.parametrize(("n_double", "tells"), [(4, True), (5, False)])
def test_two_regions_are_a_sign_where_few_training_touches_have_them(
    check, n_double, tells
):
    images = np.concatenate([pressed(), pressed()])[:25]
    images[:n_double, 7:9, 8:17] = 120
    learnt = check(images, geometry="array")
    assert learnt.tells_double_ == tells
    assert flags(learnt, images[:1]) == ["double contact" if tells else ""]


@pytest.mark.parametrize(("side", "tells"), [(8, True), (7, False)])
def test_fewer_than_eight_taxels_a_side_show_no_two_things(check, side, tells):
    images = np.zeros((24, 20, side))
    images[:, 2:5, 2:5] = 100 + np.arange(24)[:, None, None]
    for turned in (images, np.swapaxes(images, 1, 2)):
        assert check(turned, geometry="array").tells_double_ == tells
        for geometry in ("plane", "none"):
            rest = np.zeros(turned.shape[1:])
            other = check(turned, geometry=geometry, no_contact=rest)
            assert not other.tells_double_


class Sighted:
    """Four encodings, of which two are blind to how a thing lies."""

    def __init__(self):
        self.parts_ = dict.fromkeys(["a", "b", "c", "d"], 3)

    def blind_to(self, name):
        return {"a": set(), "b": {"turns"}, "c": {"light"}, "d": {"turns", "shifts"}}[
            name
        ]


def test_turned_is_new_to_encodings_that_see_it_and_known_to_the_others(check):
    rng = np.random.default_rng(3)
    array = check(pressed(), geometry="array")
    left_out = rng.random((500, 4))
    assert flags(array, pressed()[:1], novelty=np.full((1, 4), 9.0)) == [""]
    array.learn_poses(Sighted(), left_out)
    assert array.blind_.tolist() == [False, True, False, True]
    means = left_out[:, [0, 2]].mean(axis=1), left_out[:, [1, 3]].mean(axis=1)
    assert array.usual_ == pytest.approx([np.quantile(m, 0.99) for m in means])
    sees, blind = array.usual_
    step = 1e-9
    cases = [
        ([sees + step, blind, sees + step, blind], "turned or shifted"),
        ([sees, blind, sees, blind], ""),
        ([sees + step, blind + step, sees + step, blind + step], ""),
        # NaN is left out of a mean; where all are NaN, the touch has no flag.
        ([np.nan, blind - 1, sees + step, np.nan], "turned or shifted"),
        ([np.nan, 0, np.nan, 0], ""),
        ([9, np.nan, 9, np.nan], ""),
        ([9 - 2 * step, -9, sees - 9 + step, 9], ""),
    ]
    touches = np.repeat(pressed()[:1], len(cases), axis=0)
    touch_flags = flags(array, touches, novelty=np.array([row for row, _ in cases]))
    assert touch_flags == [expected for _, expected in cases]
    left_out[7, 0] = left_out[7, 2] = np.nan
    array.learn_poses(Sighted(), left_out)
    assert np.isnan(array.usual_).tolist() == [True, False]
    assert set(flags(array, touches, novelty=np.full((7, 4), 9.0))) == {""}


def test_of_several_flags_the_gravest_is_given(check):
    array = check(pressed().astype(np.uint8), geometry="array")
    array.learn_poses(Sighted(), np.zeros((9, 4)))
    novelty = np.array([[1.0, 0, 1, 0]] * 4)
    touches = np.zeros((4, 9, 20), np.uint8)
    touches[1:, 0:3, 0:6] = touches[1:, 6:9, 0:6] = 120
    touches[2, 0:3, 0:6] = 255
    touch_flags = flags(array, touches, novelty=novelty)
    assert touch_flags[:3] == ["no contact", "turned or shifted", "saturated"]
    assert flags(array, touches)[1] == "double contact"


def test_a_label_consists_of_nothing_where_most_of_its_touches_do():
    labels = np.repeat(["a", "b"], 4)
    half = np.array([1, 1, 0, 0, 0, 0, 0, 0], dtype=bool)
    more = np.array([0, 0, 0, 0, 1, 1, 1, 0], dtype=bool)
    assert not _contact.consists_of_nothing(labels, half)
    assert _contact.consists_of_nothing(labels, more)


def pictures(seed, n_touches, side=40, frequency=2):
    """Stripes through noise on a common shading: a plane sensor with no rim."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 2 * np.pi, side)
    shading = np.add.outer(np.cos(x / 2), np.cos(x / 2))
    stripes = np.cos(frequency * x)[np.newaxis, np.newaxis]
    strength = rng.uniform(0.4, 0.8, (n_touches, 1, 1))
    noise = 0.05 * rng.normal(size=(n_touches, side, side))
    return shading + strength * stripes + noise, shading


@pytest.fixture(scope="module")
def camera():
    coarse, shading = pictures(0, 12, frequency=2)
    fine, _ = pictures(1, 12, frequency=5)
    images = np.concatenate([coarse, fine])
    names = ["coarse"] * 12 + ["fine"] * 12
    touches = Touches(images, object=names, no_contact=shading, geometry="plane")
    return ObjectRecogniser().fit(touches), touches


def idle(touches, seed=3, noise=0.05):
    """Return the no-contact frame with fresh noise and another exposure."""
    frame = touches.no_contact
    rng = np.random.default_rng(seed)
    return 1.2 * frame + noise * rng.normal(size=frame.shape)


def test_no_contact_leaves_the_belief_and_counts_as_a_touch(camera):
    recogniser, touches = camera
    belief = recogniser.start().update(touches[:2])
    before = belief.posterior
    belief.update(idle(touches))
    assert belief.posterior == before
    assert belief.touches_used == 3
    assert belief.flags == ["", "", "no contact"]
    # Before any other touch they leave the belief as well.
    first = recogniser.start().update(idle(touches)).update(idle(touches, seed=4))
    assert list(first.posterior.values()) == pytest.approx([0.95 / 2] * 2)
    assert first.unknown == pytest.approx(0.05)
    assert first.decide() is None
    assert first.update(touches[:2]).posterior == before


def test_a_label_of_touches_without_contact_is_learnt(camera):
    _, touches = camera
    frames = np.stack([idle(touches, seed) for seed in range(12)])
    more = Touches(
        np.concatenate([touches.images, frames]),
        object=[*touches.object, *["nothing"] * 12],
        no_contact=touches.no_contact,
        geometry="plane",
    )
    recogniser = ObjectRecogniser().fit(more)
    assert recogniser.start().update(idle(touches, seed=99)).best == "nothing"
    # It counts, and so do the words about it.
    episode = recogniser.episode(error=0.05, strangers=0)
    frames = np.stack([idle(touches, seed) for seed in (99, 98)])
    assert recogniser.evidence(frames).flags == ["no contact"] * 2
    assert episode.add(frames) == "nothing, over 99.9 % after 2 touches"
    assert episode.belief.reason(0.05) == episode.sentence
    assert [touch.note for touch in episode.touches] == ["", ""]


def test_the_preset_of_the_paper_takes_the_idle_frame_as_evidence(camera):
    _, touches = camera
    recogniser = ObjectRecogniser("corradi2015").fit(touches)
    row = recogniser.log_likelihood(Touches(idle(touches)[np.newaxis]))
    assert np.ptp(row) > 0


@pytest.mark.realdata
@pytest.mark.slow
def test_the_recorded_frame_is_flagged_as_no_contact(data_folder):
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    names = np.unique(touches.object)[[0, 12, 24]]
    touches = touches[np.isin(touches.object, names)][::2]
    recogniser = ObjectRecogniser().fit(touches)
    frame = touches.no_contact
    # Other exposure, and the camera moved by two pixels.
    moved = np.roll((0.9 * frame.astype(float)).astype(np.uint8), 2, axis=1)
    for image in (frame, moved):
        assert recogniser.evidence(Touches(image[np.newaxis])).flags == ["no contact"]
    assert np.mean([flag == "" for flag in recogniser.evidence(touches).flags]) > 0.8
