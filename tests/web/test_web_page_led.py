"""The page leads its user: its order, the next button, touches edited, the focus."""

import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from palpate import Touches
from palpate._numbers import figure_of
from palpate.evaluation import Plan, evaluate, write_report
from palpate.library import LibraryError, TouchLibrary
from palpate.sensors import DetectedTouch
from palpate.web import LiveSession

from .browser import PATIENT, card_of, expect, fits, resize
from .conftest import waited


def primary(page):
    """Return the ids of the next buttons that are in sight, but for dialogs."""
    return page.evaluate(
        """() => [...document.querySelectorAll('button.primary')]
        .filter((button) => button.checkVisibility() && !button.closest('dialog'))
        .map((button) => button.id)"""
    )


def step(page):
    """Return which step is marked."""
    (marked,) = page.locator("#steps [aria-current]").all()
    return marked.get_attribute("id")


def top(page, selector):
    return page.locator(selector).bounding_box()["y"]


def test_each_state_has_one_step_and_at_most_one_next_button(
    page, hand, open_page, tmp_path, drawn
):
    session = LiveSession(hand, library=tmp_path / "library")
    with open_page(session, frames=True):
        expect(page.locator("#contact")).to_have_text("no baseline")
        assert (step(page), primary(page)) == ("step-1", ["baseline"])
        page.click("#baseline")
        expect(page.locator("#press-text")).to_contain_text("Now press")
        assert (step(page), primary(page)) == ("step-1", [])
        page.click("#press-undo")
        session.take_baseline()
        expect(page.locator("#step-1 span")).to_have_text("taken")
        assert (step(page), primary(page)) == ("step-2", ["start"])
        # Nothing can be recognised yet, so nothing is counted.
        session.post_touch(drawn.images[0])
        for part in ("#belief", "#count", "#fresh"):
            expect(page.locator(part)).to_be_hidden()
        expect(page.locator("#step-3 span")).to_have_text("")
        page.fill("#name", "disc")
        page.press("#wanted", "Enter")
        expect(page.locator("#stop")).to_be_focused()
        assert (step(page), primary(page)) == ("step-2", [])
        page.keyboard.press("Enter")  # Stop here
        expect(page.locator("#progress")).to_be_hidden()
        expect(page.locator("#teach-title")).to_be_focused()
        for row in (0, 1, 2, 30, 31, 32):
            session.post_lesson(str(drawn.object[row]), drawn.images[row])
        expect(page.locator("#learn")).to_be_enabled()
        assert (step(page), primary(page)) == ("step-2", ["learn"])


def test_recognising_comes_first_once_something_is_learnt(
    page, taught, open_page, drawn
):
    with open_page(taught):
        for width, height in ((1280, 900), (390, 844)):
            page.set_viewport_size({"width": width, "height": height})
            page.reload()
            expect(page.locator("#rate")).to_contain_text("Hz", timeout=PATIENT)
            assert top(page, "#belief") < top(page, "#teach")
            assert top(page, "#belief") < height / 3
            assert step(page) == "step-3"
        assert primary(page) == []  # a touch is next
        for image in drawn.images[:4]:
            taught.post_touch(image)
        expect(page.locator("#decision")).to_have_text("disc")
        assert primary(page) == ["fresh"]
        # Also for the Tab key.
        order = page.evaluate(
            "() => [...document.querySelectorAll('main > section')].map((e) => e.id)"
        )
        assert order == ["belief", "sensor", "teach", "objects"]


def test_the_heading_says_what_is_decided_and_nothing_else(
    page, taught, open_page, drawn
):
    """The sentence below it says what the object may be, and what was withdrawn."""
    disc, bar = (drawn.images[drawn.object == name] for name in ("disc", "bar"))
    heading, states = page.locator("#decision"), set()
    with open_page(taught, frames=True):
        expect(heading).to_have_text("Touch something")
        for image in [*disc[:2], *bar[:12]]:
            taught.post_touch(image)
            episode = taught.episode.episode
            state = episode.decision, episode.in_doubt
            states.add(state)
            name = (
                episode.decision
                or ("Undecided", "Undecided again")[bool(episode.withdrawn)]
            )
            expect(heading).to_have_text(name + ", in doubt" * episode.in_doubt)
            expect(page.locator("#reason")).to_contain_text(episode.sentence)
            if episode.decision == "bar":
                break
        assert {("disc", False), ("bar", False)} <= states
        expect(page.locator("#reason")).to_contain_text("disc was withdrawn after")
        answer = taught.episode.to_dict()
        for news, words, kind in (
            ({"decision": None, "withdrawn": []}, "Undecided", "undecided"),
            ({"decision": None}, "Undecided again", "undecided"),
            ({"decision": "bar", "in_doubt": True}, "bar, in doubt", "undecided"),
            ({"decision": "unknown"}, "Nothing I know", "unknown"),
            ({"decision": None, "category": "urn"}, "an urn", "decided"),
        ):
            page.evaluate(
                """async (episode) =>
                (await import('/static/belief.js')).showEpisode(episode)""",
                answer | news,
            )
            expect(heading).to_have_text(words)
            expect(heading).to_have_class(kind)


def test_without_a_library_there_is_one_next_step(page, make_session, open_page, drawn):
    session = make_session(library=None)
    with open_page(session, frames=True):
        session.post_touch(drawn.images[0])
        expect(page.locator("#strip li")).to_have_count(1)
        expect(page.locator("#decision")).to_have_text("Nothing learnt yet")
        assert (step(page), primary(page)) == ("step-2", [])
        words = page.locator("main").inner_text()
        assert words.count("--library FOLDER") == 1
        for other in ("Belief after", "two objects", "Name an object", "learn again"):
            assert other not in words
    assert "`library=FOLDER`" in session.episode.sentence


@pytest.mark.parametrize("width", [390, 1280])
def test_a_message_covers_nothing(page, taught, open_page, width):
    """A long message, too, fits in the line above the belief."""
    page.set_viewport_size({"width": width, "height": 844})
    with open_page(taught, frames=True):
        for words in ("Short.", "A long sentence that wraps. " * 12):
            page.evaluate(
                "async (words) => (await import('/static/dom.js')).say(words)", words
            )
            status = page.locator("#status").bounding_box()
            assert status["y"] + status["height"] <= top(page, "#belief")
            assert page.locator("#status").evaluate(
                "(e) => e.scrollHeight <= e.clientHeight + 1"
            )


@pytest.mark.slow
def test_a_name_that_says_nothing_is_refused_in_one_sentence(
    page, make_session, open_page
):
    session = make_session()
    with open_page(session, frames=True):
        for name, why in (
            ("   ", "must not be blank"),
            ("mug\u202e", "can be printed"),
            ("m" * 81, "at most 80 characters, got 81"),
        ):
            page.fill("#name", name)
            page.click("#start")
            status = page.locator("#status")
            expect(status).to_contain_text("The name of an object must ")
            expect(status).to_contain_text(why)
            field = page.locator("#name")
            expect(field).to_have_js_property("validationMessage", status.inner_text())
            assert session.teacher.lesson is None


def test_no_line_breaks_between_a_number_and_its_sign(page, taught, open_page, drawn):
    with open_page([taught], frames=True):
        for image in drawn.images[:3]:
            taught.post_touch(image)
        expect(page.locator("#strip li")).to_have_count(3)
        broken = page.evaluate(
            """() => [...document.querySelectorAll('main *, #steps *')]
            .filter((e) => !e.children.length && /[0-9] %/.test(e.textContent))
            .map((e) => e.outerHTML)"""
        )
        assert broken == []
        assert "\u00a0%" in page.locator("main").inner_text()


def test_shares_are_rounded_as_in_reports_and_never_sum_to_more_than_all(
    page, open_page
):
    rng = np.random.default_rng(0)
    shares = [0, 1e-9, 0.00099, 0.001, 0.0995, 0.1, 0.29, 0.5, 0.9899, 0.99, 0.9995]
    drawn = rng.dirichlet(np.full(5, 0.2), 200)
    shares += [1 - 1e-9, 1, *drawn.ravel().tolist()]
    with open_page(LiveSession()):
        rounded = page.evaluate(
            """async (shares) => (await import("/static/dom.js")).percent
            && shares.map((await import("/static/dom.js")).percent)""",
            shares,
        )
    rounded = [figure.replace("\u00a0", " ") for figure in rounded]
    assert rounded == [*map(figure_of, shares)]
    assert [*map(figure_of, shares)][:13] == [
        *("0 %", "<0.1 %", "<0.1 %", "0.1 %", "9.9 %", "10 %", "29 %", "50 %"),
        *("98 %", "99.0 %", ">99.9 %", ">99.9 %", "100 %"),
    ]
    for belief in drawn:
        figures = [figure_of(share) for share in belief]
        least = [float(figure.strip("<> %")) * (figure[0] != "<") for figure in figures]
        assert sum(least) <= 100 + 1e-9


def test_a_card_says_that_its_object_changed_since_it_was_learnt(
    page, taught, open_page, drawn
):
    def card(name):
        return card_of(page, name).locator(".meta")

    with open_page(taught, frames=True):
        expect(card("disc")).to_have_text("30 touches, learnt")
        taught.post_touch(drawn.images[0])
        expect(page.locator("#limits")).to_contain_text("It knows 2 objects")
        key = taught.teacher.newest("disc", 1)[0].id
        taught.move_touches([key], "pen")
        expect(card("disc")).to_have_text(
            "29 touches, changed since it was learnt: learn again"
        )
        expect(card("bar")).to_have_text("30 touches, learnt")
        expect(card("pen")).to_have_text("1 touch, too few to learn")
        taught.learn(wait=True)
        expect(card("disc")).to_have_text("29 touches, learnt")


def test_without_a_connection_nothing_can_be_pressed(page, taught, open_page):
    with open_page(taught, frames=True):
        expect(page.locator("#start")).to_be_enabled()
        page.fill("#wanted", "7")
        page.fill("#name", "pen")
        page.press("#name", "Enter")
        expect(page.locator("#stop")).to_be_visible()
        page.click("#stop")
        expect(page.locator("#status")).to_contain_text("pen is over: 0 of 7")
        expect(page.locator("#name")).to_have_value("")
        expect(page.locator("#wanted")).to_have_value("7")
    expect(page.locator("#offline")).to_be_visible(timeout=PATIENT)
    page.evaluate("window.scrollTo(0, 10_000)")
    expect(page.locator("#offline")).to_be_in_viewport()
    assert page.locator("main").evaluate("(main) => main.inert")
    assert page.locator("#steps").evaluate("(steps) => steps.inert")


def test_a_touch_that_is_not_taken_is_told_until_one_is(
    page, make_session, open_page, drawn, monkeypatch
):
    def full(*arguments, **options):
        raise LibraryError("There is no room on the disk.")

    session = make_session()
    trouble = page.locator("#trouble")
    touch = DetectedTouch(drawn.images[0], math.inf, 0.0, 9.0, 3)
    with open_page(session, frames=True):
        page.clock.install()
        session.teach("pen", 8)
        expect(page.locator("#stop")).to_be_visible()
        with monkeypatch.context() as patched:
            patched.setattr(session.teacher.library, "add", full)
            for _ in range(2):
                session._on_touch(touch, 0.0)
                expect(trouble).to_have_text("There is no room on the disk.")
                page.clock.fast_forward(7000)  # a message is gone by then
                expect(trouble).to_be_visible()
        session._on_touch(touch, 0.0)
        expect(page.locator("#step-2")).to_contain_text("pen: 1 of 8")
        expect(trouble).to_be_hidden()
        session.post_lesson("pen", drawn.images[1])  # by a robot: not of the lesson
        session._on_touch(replace(touch, image=drawn.images[2]), 0.0)
        shown = page.locator("#lesson-strip li")
        expect(shown).to_have_text(["1", "2"])
        keys = [one.get_attribute("data-key") for one in shown.all()]
        assert keys == session.teacher.lesson.ids
        session.stop_teaching()
        with monkeypatch.context() as patched:
            patched.setattr(session.episode, "add", full)
            session._on_touch(touch, 0.0)
            expect(trouble).to_be_visible()
        session._on_touch(touch, 0.0)
        expect(trouble).to_be_hidden()


def test_a_button_pressed_again_before_the_answer_is_one_order(
    page, make_session, open_page, drawn
):
    """On a slow network nothing is seen at first, and people press again."""
    session, orders = make_session(sensor=False), []
    page.route("**/api/teach/undo", lambda order: orders.append(order))
    with open_page(session):
        for image in drawn.images[:2]:
            session.post_lesson("pen", image)
        for _ in range(2):
            page.click("#undo")
            expect(page.locator("#undo")).to_be_focused()
        page.evaluate("() => fetch('/api/health')")  # orders before it are on the way
        assert len(orders) == 1
        with page.expect_request_finished(lambda one: "undo" in one.url):
            orders[0].continue_()
        expect(card_of(page, "pen").locator(".meta")).to_contain_text("1 touch,")
        page.unroute("**/api/teach/undo")
        page.click("#undo")
        expect(page.locator("#none")).to_be_visible()


def test_nothing_covers_a_heading_below_the_steps(page, taught, open_page):
    """Without a message, the page itself begins right under the steps."""
    with open_page(taught, frames=True):
        page.evaluate("window.scrollTo(0, 200)")
        below = page.evaluate(
            """() => { const box = document.querySelector('#steps')
            .getBoundingClientRect(); return document.elementFromPoint(
            box.left + 60, box.bottom + 8).closest('main') !== null }"""
        )
        assert below


def test_a_lost_sensor_leaves_nothing_to_press(page, hand, open_page, tmp_path):
    session = LiveSession(hand, library=tmp_path / "library")
    with open_page(session, frames=True):
        expect(page.locator("#offer")).to_contain_text("No baseline yet")
        session.take_baseline()
        expect(page.locator("#start")).to_be_enabled()
        hand.unplugged = True
        expect(page.locator("#lost")).to_have_text("it is unplugged")
        for button in ("#baseline", "#start"):
            expect(page.locator(button)).to_be_disabled()
        expect(page.locator("#offer")).to_be_hidden()
        expect(page.locator("#why-not")).to_contain_text("the sensor gives no frames")
        hand.unplugged = False
        for button in ("#baseline", "#start"):
            expect(page.locator(button)).to_be_enabled()


def test_any_touch_is_enlarged_removed_and_moved_and_comes_back(
    page, make_session, taught_library, tmp_path, open_page
):
    folder = shutil.copytree(taught_library, tmp_path / "edited")
    with open_page(make_session(library=folder), frames=True):
        card = card_of(page, "disc")
        card.locator(".more").click()
        expect(card.locator(".thumb")).to_have_count(30)
        card.locator(".look").nth(20).click()
        editor = page.locator("#editor")
        expect(editor.locator("h2")).to_have_text("A touch of disc")
        expect(page.locator("#editor-about")).to_contain_text("21 of 30")
        expect(page.locator("#editor-picture")).to_have_js_property("naturalWidth", 480)
        page.click("#editor-remove")
        expect(page.locator("#editor-about")).to_contain_text("21 of 29")
        expect(page.locator("#editor-title")).to_be_focused()
        page.fill("#editor-name", "...")
        page.keyboard.press("Enter")
        expect(editor.locator("#status")).to_contain_text("must hold a letter")
        resize(page, 360, 600)  # a phone, on which the editor is to be scrolled
        expect(editor.locator("#status")).to_be_in_viewport(ratio=0.9)
        resize(page, 1280, 900)
        editor.locator("#editor-name").fill(" ")
        expect(editor.locator("#editor-there")).to_be_disabled()
        page.fill("#editor-name", "bar")
        page.keyboard.press("Enter")
        expect(page.locator("#editor-about")).to_contain_text("21 of 28")
        page.keyboard.press("Escape")
        expect(editor).to_be_hidden()
        expect(page.locator("#bar-top #status")).to_contain_text("moved to bar")
        expect(card.locator("h3")).to_be_focused()  # the picture pressed is gone
        expect(card.locator(".meta")).to_contain_text("28 touches")
        expect(page.locator("#step-2 span")).to_have_text("learn again")
        assert primary(page) == ["learn"]
    with open_page(make_session(library=folder), frames=True):
        expect(page.locator("#undo")).to_have_text("Undo move to bar")
        page.click("#undo")
        expect(page.locator("#undo")).to_have_text("Undo removal from disc")
        page.click("#undo")
        expect(page.locator("#undo")).to_be_disabled()
        expect(card.locator(".meta")).to_contain_text("30 touches")


def test_a_touch_of_the_episode_is_looked_at_alone(page, taught, open_page, drawn):
    with open_page(taught, frames=True):
        taught.post_touch(drawn.images[0])
        page.locator("#strip .look").click()
        expect(page.locator("#editor-title")).to_have_text("Touch 1")
        expect(page.locator("#editor-move")).to_be_hidden()
        page.keyboard.press("Escape")
        expect(page.locator("#editor")).to_be_hidden()
        page.locator(".menu summary").click()
        expect(page.locator(".menu ul")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator(".menu ul")).to_be_hidden()
        expect(page.locator(".menu summary")).to_be_focused()
        page.locator("#strip .look").click()
        taught.begin_episode()  # the picture that was pressed is gone
        expect(page.locator("#strip li")).to_have_count(0)
        page.keyboard.press("Escape")
        expect(page.locator("#belief")).to_be_focused()


def test_an_interrupted_lesson_is_offered(
    page, make_session, open_page, drawn, tmp_path
):
    with make_session(library=tmp_path / "library") as session:
        session.teach("shoe", 60)
        for image in drawn.images[:13]:
            session._take(image)
    with open_page(make_session(library=tmp_path / "library"), frames=True):
        expect(page.locator("#interrupted")).to_contain_text("shoe: 13 of 60")
        assert primary(page) == ["resume"]
        page.click("#resume")
        expect(page.locator("#step-2")).to_contain_text("shoe: 13 of 60")
        expect(page.locator("#stop")).to_be_focused()
        # The strip shows the newest twelve.
        expect(page.locator("#lesson-strip li")).to_have_count(12)


@pytest.mark.slow
def test_twenty_objects_are_sifted_and_told_apart(page, serving, drawn, tmp_path):
    """Marks differ in their letters; the worst objects come first; names are whole."""
    rng = np.random.default_rng(0)
    names = [f"thing {n}" for n in range(18)] + ["a" * 60, "b" * 60]
    labels = np.repeat(names, 4)
    images = drawn.images[rng.integers(0, 60, len(labels))].copy()
    images[:, 0, :4] = np.arange(len(labels))[:, None]  # no two touches are the same
    touches = Touches(images, object=labels, no_contact=drawn.no_contact)
    folder = tmp_path / "library"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(touches)
    session = LiveSession(library=folder)
    with serving(session) as (address, token):
        session.learn(wait=True)
        for row in (0, 20, 40):
            session.post_touch(images[row])
        page.goto(f"{address}/?token={token}")
        cards = page.locator("li.object:visible")
        expect(cards).to_have_count(20)
        quality = session.to_dict()["quality"]
        after = {figures["name"]: figures["after_one"] for figures in quality}
        shares = [after[name] for name in cards.locator("h3").all_inner_texts()]
        assert shares == sorted(shares)
        page.select_option("#order", "name")
        assert cards.locator("h3").all_inner_texts()[0] == "a" * 60
        page.fill("#filter", "THING 1")
        expect(cards).to_have_count(9)  # 1 and 10 to 17
        expect(page.locator("#sifted")).to_have_text("9 of 20 objects")
        marks = page.evaluate(
            """async (names) => {
            const { marked } = await import('/static/marks.js');
            return [...marked(names)].map(([name, mark]) => mark.letters);
            }""",
            names,
        )
        assert len({*marks}) == 20
        assert all(1 <= len(mark) <= 3 for mark in marks)
        for name in page.locator("#bars .name").all():
            assert name.evaluate("(e) => e.scrollWidth <= e.clientWidth")
        letters = page.locator("#bars .mark").all_inner_texts()
        assert len({*letters}) == len(letters) == 6


def test_a_thing_is_not_taught_under_the_name_of_another_of_the_desk_unasked(
    page, make_session, open_page
):
    session = make_session()
    session.place("bar")
    with open_page(session, frames=True):
        mixed = page.locator("#mixed")
        expect(mixed).to_be_hidden()
        page.fill("#name", "disc")
        expect(mixed).to_contain_text("On the desk lies bar")
        page.press("#name", "Enter")
        expect(page.locator("#confirm")).to_contain_text("Before the sensor lies bar")
        page.get_by_role("button", name="Cancel").click()
        assert session.teacher.lesson is None
        page.fill("#name", "my bar")  # what people call it is their affair
        expect(mixed).to_be_hidden()
        page.fill("#name", "disc")
        page.select_option("#placed", "disc")
        expect(mixed).to_be_hidden()
        page.select_option("#placed", "bar")
        expect(mixed).to_contain_text("On the desk lies bar")
        placed = page.locator("#placed")
        page.route("**/api/place", lambda route: route.fulfill(status=429, json={}))
        page.select_option("#placed", "both")  # is refused, as somebody asks too much
        expect(placed).to_have_value("bar")
        page.unroute("**/api/place")
        placed.focus()
        session.place(None)  # by another page
        expect(placed).to_have_value("")
        session.place("bar")
        expect(placed).to_have_value("bar")
        page.click("#start")
        page.get_by_role("button", name="Put disc there and start").click()
        expect(placed).to_have_value("disc")
        expect(page.locator("li.object h3")).to_have_text("disc")
        expect(page.locator("#progress")).to_be_hidden(timeout=PATIENT)
        expect(page.locator("#why-not")).to_contain_text("Teach a second object")
        session.teach("disc", 1000)
        expect(mixed).to_be_hidden()
        session.place("bar")
        words = "On the desk lies bar: its touches are stored as disc."
        expect(mixed).to_have_text(words)
        session.stop_teaching()
        expect(mixed).to_be_hidden()
        session.post_lesson("W" * 80, session.baseline)
        for width in (1280, 390):
            resize(page, width, 844)
            expect(page.locator("#undo")).to_contain_text("WWW")
            assert fits(page)


@pytest.mark.slow
def test_all_sensors_are_not_taught_different_things_unasked(
    page, open_page, make_session
):
    sessions = [make_session(rate_hz=60.0) for _ in range(2)]
    for session, placed in zip(sessions, ("disc", "bar"), strict=True):
        session.place(placed)
    with open_page(sessions, frames=True):
        expect(page.locator("#mixed")).to_contain_text("1: disc, 2: bar")
        page.fill("#name", "pen")
        page.press("#name", "Enter")
        expect(page.locator("#confirm")).to_contain_text("1: disc, 2: bar")
        page.get_by_role("button", name="Cancel").click()
        assert [session.teacher.lesson for session in sessions] == [None, None]
        page.locator("#as-one").uncheck()
        expect(page.locator("#mixed")).to_be_hidden()
        page.locator("#as-one").check()
        page.select_option("#placed", "bar")  # goes before both
        expect(page.locator("#mixed")).to_be_hidden()
        placed = [session.watch.sensor.placed for session in sessions]
        assert placed == ["bar", "bar"]
        page.press("#name", "Enter")
        expect(page.locator("#stop")).to_be_visible()
        # The second sensor is asked after the first.
        assert waited(lambda: all(session.teacher.lesson for session in sessions))
        assert [session.teacher.lesson.name for session in sessions] == ["pen", "pen"]
        for session in sessions:
            session.teach("pen", 1000)
    folders = [session.teacher.folder for session in sessions]
    sessions = [make_session(rate_hz=60.0, library=folder) for folder in folders]
    with open_page(sessions, frames=True):
        page.click("#resume")  # the lesson that the end of the server cut off
        expect(page.locator("#stop")).to_be_visible()
        assert waited(lambda: all(session.teacher.lesson for session in sessions))


@pytest.mark.slow
def test_the_answer_and_the_count_are_read_aloud(page, taught, open_page, drawn):
    with open_page(taught, frames=True):
        live = page.evaluate(
            """() => [...document.querySelectorAll('[aria-live]')].map((e) => e.id)"""
        )
        assert {"answer", "status", "progress-text", "learn-error", "lost"} <= {*live}
        taught.post_touch(drawn.images[0])
        words = re.compile("disc|bar")
        expect(page.locator("#answer")).to_contain_text(words)


@pytest.mark.slow
def test_the_report_of_an_evaluation_fits_a_phone(page, drawn, tmp_path):
    pytest.importorskip("matplotlib", reason='pip install "palpate[plot]"')
    plan = Plan(touches=(1, 3, 5, 10), orders=3, preset="liu2014")
    report = write_report(
        tmp_path / "r.html", *evaluate(drawn, split="last", plan=plan)
    )
    page.set_viewport_size({"width": 390, "height": 844})
    page.set_content(report.read_text("utf-8"))
    wide = page.evaluate(
        """() => [document.documentElement,
        ...document.querySelectorAll("table, .why")]
        .filter((e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.outerHTML)"""
    )
    assert wide == []
