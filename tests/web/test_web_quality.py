"""Whether enough was taught: touches compared, left-out touches tested, advice."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from first_hour import N_ASKED, N_TAUGHT, Desk, advised, table
from palpate import Touches
from palpate.recognition import ObjectRecogniser
from palpate.web import LiveSession

from .conftest import Still, waited

BASELINE = np.full((40, 60), 7.0)


def pressed(row, col, force=100.0):
    """A round press of an array that rests at 7."""
    rows, cols = np.mgrid[:40, :60]
    return BASELINE + force * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 20)


def lesson_of(sensor, folder="not-there"):
    """Return a teacher who has begun to teach a cup with a sensor."""
    teacher = LiveSession(sensor, library=folder).teacher
    teacher.begin("cup", 1000)
    return teacher


def variety_of(images, baseline=BASELINE, noise=0.0):
    """Return the variety of a lesson: which of its touches are alike."""
    variety = lesson_of(Still((4, 4, 3), "plane", "grey level")).lesson.variety
    for image in images:
        variety.add(image, baseline, noise)
    return variety


def test_touches_of_one_place_are_alike_however_hard_they_press():
    images = [pressed(10, 10), pressed(10, 10, 250), pressed(30, 45), pressed(30.2, 45)]
    variety = variety_of(images)
    assert variety.like == [None, 1, None, 3]
    assert variety.n_new == 2
    dead = np.where(np.arange(60) == 3, np.nan, images[0])
    assert variety_of([dead, *images]).like == [None, 1, 1, None, 4]
    line = [image[10:11] for image in images]
    assert variety_of(line, BASELINE[10:11]).like[:2] == [None, 1]
    colour = [np.stack([image] * 3, axis=-1) for image in images]
    assert variety_of(colour, np.stack([BASELINE] * 3, axis=-1)).like == variety.like


def test_touches_without_contact_are_like_no_others():
    lesson = lesson_of(Still((40, 60), "plane", "grey level")).lesson
    for number in range(3):
        lesson.add(f"touch {number}", pressed(10, 10 + 15 * number), BASELINE, 1.0)
    for number in range(4):
        lesson.no_contact_ids.add(f"nothing {number}")
        lesson.add(f"nothing {number}", BASELINE, BASELINE, 1.0)
    assert lesson.done == 3
    assert (lesson.prompt, lesson.verdict) == ("", "")


def test_differences_below_the_noise_of_the_sensor_do_not_count(rng):
    press, noise = pressed(10, 10, 30), 8.0
    images = [press + rng.normal(scale=noise, size=press.shape) for _ in range(6)]
    small = [image[::2, ::2] for image in images]  # no mean over neighbours
    assert variety_of(small, BASELINE[::2, ::2]).n_new > 1
    assert variety_of(small, BASELINE[::2, ::2], noise).n_new == 1


def test_touches_that_have_nothing_in_common_are_a_root_of_two_apart():
    variety = variety_of([pressed(8, 8), pressed(32, 50), pressed(8, 8)])
    first, other, again = ((place["x"], place["y"]) for place in variety.map())
    assert_allclose(first, again, atol=1e-12)
    assert_allclose(np.hypot(*np.subtract(first, other)), 2**0.5, atol=1e-3)
    assert [place["like"] for place in variety.map()] == [None, None, 1]
    assert variety_of([]).map() == []
    (alone,) = variety_of([pressed(8, 8)]).map()
    assert (alone["x"], alone["y"]) == (0, 0)


def test_the_opposite_of_many_touches_stays_on_the_map():
    """A dark picture among bright ones is 5/3 from their middle; the map ends at 1."""
    pressure = pressed(8, 8) - BASELINE
    places = variety_of([*[BASELINE + pressure] * 5, BASELINE - pressure]).map()
    xs = [place["x"] for place in places]
    assert_allclose(np.abs(xs), [0.2] * 5 + [1.0], atol=1e-6)


@pytest.fixture(scope="module")
def quality(drawn):
    """A recogniser of the disc and of a bar under two names, and its quality."""
    bars = np.flatnonzero(drawn.object == "bar")
    names = drawn.object.copy()
    names[bars[::2]] = "rod"
    learnt = drawn.with_columns(object=names)[np.flatnonzero(names != "both")]
    recogniser = ObjectRecogniser().fit(learnt)
    return recogniser, recogniser.object_quality()


def test_left_out_touches_are_counted(quality):
    recogniser, qualities = quality
    bar, disc, rod = qualities
    assert disc["name"] == "disc"
    assert (disc["after_one"], disc["after_eight"], disc["taken_for"]) == (1, 1, None)
    assert (bar["taken_for"], rod["taken_for"]) == ("rod", "bar")
    assert [figures["n_touches"] for figures in qualities] == [15, 30, 15]
    # The same is counted from each left-out touch by itself.
    log_likelihood = recogniser.left_out_log_likelihood()
    for figures in qualities:
        rows = log_likelihood[recogniser.memory_.labels == figures["name"]]
        right = sum(
            recogniser.classes_[row.argmax()] == figures["name"] for row in rows
        )
        assert figures["after_one"] == right / len(rows)


def test_a_model_that_was_read_says_the_same(quality, tmp_path):
    recogniser, qualities = quality
    read = ObjectRecogniser.load(recogniser.save(tmp_path / "m.palpate"))
    assert read.object_quality() == qualities


EACH = "ten more touches of each, elsewhere."


def of(name, after_eight, other=None, after_one=0.8):
    figures = {"after_one": after_one, "after_eight": after_eight}
    return {"name": name, "taken_for": other, **figures}


@pytest.mark.parametrize(
    ("qualities", "advice"),
    [
        ([of("cup", 1.0, "mug"), of("mug", 0.95, "cup")], []),
        (
            [of("cup", 0.5, "mug"), of("mug", 0.95)],
            ["cup is taken for mug: ten more touches of cup, elsewhere."],
        ),
        (
            [of("cup", 0.5, "mug"), of("mug", 0.8, "cup")],
            ["cup and mug are taken for each other: " + EACH],
        ),
        (
            [of("cup", 1.0, "mug"), of("mug", 1.0, "pen", 0.4)],
            ["mug is taken for pen: ten more touches of mug, elsewhere."],
        ),
        (
            [of(str(n), 0.1 * n, "mug", 0.1 * n) for n in range(8)],
            [
                f"{n} is taken for mug: ten more touches of {n}, elsewhere."
                for n in range(4)
            ],
        ),
        (
            [of("cup", 0.5, "mug"), of("mug", 0.5, "pen"), of("pen", None)],
            [
                "cup is taken for mug: ten more touches of cup, elsewhere.",
                "mug is taken for pen: ten more touches of mug, elsewhere.",
                "Fewer than 8 touches with contact cannot be judged: pen.",
            ],
        ),
    ],
)
def test_advice_follows_from_the_figures(qualities, advice):
    assert ObjectRecogniser().teaching_advice(qualities) == advice


@pytest.mark.slow
def test_a_lesson_in_one_place_is_reported_and_one_in_several_places_is_not(
    make_session, hand, tmp_path, drawn
):
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline()
        session.teach("cup", 5)
        for number in range(1, 6):
            hand.show(session, pressed=True)
            hand.show(session, pressed=False)
            assert waited(lambda n=number: session.teacher.library.count() == n)
            if number < 5:
                lesson = session.to_dict()["lesson"]
                assert lesson["n_new"] == 1
                assert ("elsewhere" in lesson["prompt"]) == (number > 2)
        verdict = "Of 5 touches of cup 4 are like others"
        assert waited(lambda: verdict in session.message)
        assert session.advice[0].startswith(verdict)
        session.forget("cup")
        assert session.advice == []
    session = make_session()
    with session:
        for name in ("disc", "bar"):
            session.teach(name, 8)
            session.place(name)
            assert waited(lambda: session.teacher.lesson is None)
            session.place(None)
            time.sleep(0.3)
        assert session.advice == []
        session.learn(wait=True)
        qualities = session.to_dict()["quality"]
        assert [figures["after_eight"] for figures in qualities] == [1, 1]
        for image in drawn.images[drawn.object == "bar"][-6:]:
            session.post_lesson("cup", image)
        session.learn(wait=True)
        # Six touches of a thing that looks like a bar, which is taken for it.
        taken_over, few, day = session.advice
        assert taken_over == "bar is taken for cup: ten more touches of bar, elsewhere."
        assert few == "Fewer than 8 touches with contact cannot be judged: cup."
        assert day.startswith("All was taught in one session. For another day: lift")
        assert "What to teach next" in session.message


def test_touches_without_contact_do_not_count(drawn):
    learnt = drawn[drawn.object != "both"]
    images = learnt.images.copy()
    images[:5] = drawn.no_contact  # of the disc
    about = {"no_contact": drawn.no_contact, "geometry": "array"}
    touches = Touches(images, object=learnt.object, **about)
    bar, disc = ObjectRecogniser().fit(touches).object_quality()
    assert (bar["n_touches"], disc["n_touches"]) == (30, 25)
    assert disc["after_one"] == 1


def test_a_lesson_asks_for_another_touch_where_one_shows_no_contact(
    make_session, drawn
):
    empty = drawn.no_contact.copy()
    empty[0, 0] = 1
    with make_session() as session:
        session.teach("disc", 3)
        messages = [
            session._take(image, {"force_n": 0.5}) for image in drawn.images[:2]
        ]
        assert messages[-1] == "Touch 2 of 3 of disc is stored."
        assert session.teacher.touches("disc").columns["force_n"].tolist() == [0.5] * 2
        assert "of disc shows no contact and does not count" in session._take(empty)
        state = session.to_dict()
        lesson = state["lesson"]
        assert [lesson[key] for key in ("done", "stored", "no_contact")] == [2, 3, [3]]
        (silent,) = state["no_contact"]
        assert session.teacher.newest("disc", 1)[0].id == silent
        session.undo()
        assert session.to_dict()["lesson"]["no_contact"] == []
        session._take(empty.T[::-1])
        assert session._take(drawn.images[2]).startswith("Touch 3 of 3 of disc")
        assert session.teacher.lesson is None
        session.teach("bar", 3)
        for image in drawn.images[30:33]:
            session._take(image)
        session.learn(wait=True)
        assert silent not in session.to_dict()["no_contact"]  # it was undone
        assert session.to_dict()["no_contact"] == [
            session.teacher.newest("disc", 2)[1].id
        ]


def test_touches_without_contact_do_not_count_after_a_restart(
    make_session, drawn, tmp_path
):
    empty = drawn.no_contact.copy()
    empty[0, 0] = 1
    images = *drawn.images[:2], empty, empty.T[::-1]
    with make_session(library=tmp_path / "library") as session:
        session.teach("disc", 3)
        for image in images:
            session._take(image)
        session.rename("disc", "coin")
        assert session.teacher.lesson.done == 2
    for _ in range(2):
        with make_session(library=tmp_path / "library") as session:
            interrupted = session.to_dict()["library"]["interrupted"]
            assert interrupted == {"name": "coin", "wanted": 3, "done": 2}
            session.resume_teaching()
            assert (session.teacher.lesson.done, session.teacher.lesson.wanted) == (
                2,
                3,
            )


@pytest.mark.parametrize("geometry", ["dome", "array", "plane"])
def test_a_touch_without_contact_is_reported_before_there_is_a_model(
    geometry, rng, tmp_path
):
    row, col = np.mgrid[:60, :80]
    pins = 60 * ((row % 6 < 2) & (col % 6 < 2))
    baseline = ((60 + pins) * (np.hypot(row - 30, col - 40) < 25)).astype(np.uint8)
    images = np.tile(baseline, (4, 1, 1))
    images[3, 0, 0] += 1
    images[:3, 20:40, 30:50] = rng.integers(0, 255, (3, 20, 20), dtype=np.uint8)
    teacher = lesson_of(Still((60, 80), geometry, "grey level"), tmp_path / "library")
    messages = [teacher.take(image, baseline, 0.0) for image in images]
    uncounted = ["does not count" in message for message in messages]
    assert uncounted == [False, False, False, True]
    assert "does not count" not in teacher.take(images[3], None, 0.0)
    teacher.close()


def test_the_sentence_and_the_count_are_of_touches_that_count(make_session, drawn):
    learnt = drawn[drawn.object != "both"]
    with make_session(sensor=False) as session:
        session._use(ObjectRecogniser().fit(learnt[::2]))
        for image in (drawn.no_contact, drawn.images[1], *[drawn.no_contact] * 2):
            session.post_touch(image)
        for image in drawn.images[3:9:2]:
            episode = session.post_touch(image)
        assert (episode["n_counted"], len(episode["touches"])) == (4, 7)
        assert episode["decision"] == "disc"
        assert episode["sentence"].endswith("after 4 touches")
        assert session.episode.belief.reason().endswith("after 4 touches")


@pytest.mark.parametrize(("n_touches", "first"), [(3, 1), (60, 1), (63, 4)])
def test_the_newest_sixty_touches_are_on_the_map(n_touches, first, rng):
    variety = variety_of(rng.uniform(0, 99, (n_touches, 6, 6)), None, 0.1)
    numbers = [place["number"] for place in variety.map()]
    assert numbers == list(range(first, n_touches + 1))


def test_a_touch_that_is_dropped_leaves_its_like_new(rng):
    image = rng.uniform(0, 99, (6, 6))
    variety = variety_of([image, rng.uniform(0, 99, (6, 6)), image], None, 0.1)
    assert variety.like == [None, None, 1]
    assert variety.n_new == 2
    variety.drop(0)
    assert variety.like == [None, None]


def test_a_driver_may_not_name_its_columns_as_those_of_every_touch(tmp_path):
    teacher = lesson_of(Still((4, 4)), tmp_path / "library")
    teacher.begin("mug", 2)
    image, columns = np.zeros((4, 4), np.uint8), {"time_s": 1.0, "images": 2.0}
    message = "must not be called images, time_s: .* Rename them in its driver"
    with pytest.raises(ValueError, match=message):
        teacher.take(image, None, 1.0, columns)
    assert teacher.lesson.to_dict()["done"] == 0
    teacher.close()


def test_colours_are_compared_one_by_one(rng):
    """Two touches of one grey that differ in their colours are not alike."""
    base = rng.uniform(0, 99, (6, 8))
    red, blue = np.zeros((6, 8, 3)), np.zeros((6, 8, 3))
    red[..., 0], blue[..., 2] = base, base
    variety = variety_of([red, blue, red], None, 0.1)
    assert variety.like == [None, None, 1]


def test_limits_are_given_where_few_objects_or_touches_were_learnt(drawn, tmp_path):
    path = tmp_path / "m.palpate"

    def limits(touches):
        model = ObjectRecogniser(rehearse=False).fit(touches).save(path)
        return LiveSession(model=model).episode.limits

    names = np.repeat([f"thing {n}" for n in range(6)], 10)
    images = drawn.images[:60].copy()
    images[:, 0, 0] = np.arange(60)
    many = Touches(images, object=names, geometry="array")
    assert limits(many) == ""
    five = limits(many[:50])
    assert five.startswith("It knows 5 objects and nothing else: ")
    assert "fewer than" not in five
    few = limits(many[1:])
    assert few.startswith("Of thing 0 it learnt fewer than 10 touches: ")
    fewer = limits(many[::2])
    assert fewer.startswith("Of thing 0, thing 1, thing 2 and 3 more it learnt")


def test_limits_stand_in_the_episode_and_its_report(
    make_session, connected, drawn, drawn_model
):
    with connected(make_session(sensor=False, model=drawn_model)) as client:
        client.session.post_touch(drawn.images[0])
        limits = client.get("/api/episode").json()["limits"]
        assert limits.startswith("It knows 2 objects and nothing else")
        assert limits in client.get("/api/episode/report").text


def test_advised_objects_are_read_from_the_advice():
    teaching_advice = ObjectRecogniser().teaching_advice
    pair = teaching_advice([of("a mug", 0.5, "a cup"), of("a cup", 0.5, "a mug")])
    assert sorted(advised(pair)) == ["a cup", "a mug"]
    assert advised(teaching_advice([of("pen", 0.5, "a cup, blue")])) == ["pen"]
    assert advised(teaching_advice([of("pen", 0.5)])) == ["pen"]
    assert advised(teaching_advice([of("pen", None, "cup")])) == []
    alike = (
        "Of 12 touches of a mug 9 are like others: ten more touches of it, elsewhere"
    )
    assert advised([f"{alike}, unless it is the same all over."]) == ["a mug"]


def test_the_table_gives_shares_of_episodes():
    right = {"object": "pen", "right": "0" + "1" * 11, "first": "pen"}
    wrong = {"object": "cup", "right": "1" + "0" * 11, "first": "pen"}
    none = {"object": "mug", "right": "1" * 12, "first": None}
    stranger = {"object": "box", "right": "1" * 12, "first": "unknown"}
    outcome = {
        "asked": [right, wrong, none, stranger],
        "taught": {"pen": 12, "cup": 22},
    }
    line = table([{"in a row": outcome}] * 2).splitlines()[2]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells == ["in a row", "17", *["25"] * 4, "75", "0", "75", "0", "75"]


@pytest.mark.realdata
@pytest.mark.slow
def test_three_recorded_things_are_recognised_where_they_were_not_taught(
    data_folder, tmp_path
):
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    names = ["ball_greenfootball", "can_largeyellow", "stapler_greyred"]
    things = touches[np.isin(touches.object, names)]
    desk = Desk(things, tmp_path / "desk", np.random.default_rng(0))
    with desk.session as session:
        session.take_baseline()
        for name in names:
            desk.teach(name, N_TAUGHT, in_a_row=False, obey=True)
        state = session.to_dict()
        stored = [entry["n_touches"] for entry in state["library"]["objects"]]
        assert min(stored) == N_TAUGHT  # touches without contact are stored beside
        assert sum(stored) - len(state["no_contact"]) == 3 * N_TAUGHT
        desk.learn()
        assert desk.follow_advice() <= 3
        records = desk.ask()
    tested_rows = {name: set(desk.last[name]) for name in names}
    assert all(not tested_rows[name] & set(desk.taught[name]) for name in names)
    # Chance is a third of the touches, and one thing of three after eight.
    marks = [record["right"] for record in records]
    assert np.mean([episode[7] == "1" for episode in marks]) >= 2 / 3
    assert np.mean([mark == "1" for episode in marks for mark in episode]) > 0.6
    assert all(len(episode) == N_ASKED for episode in marks)
    assert [record["first"] for record in records].count("unknown") <= 1
