"""axe-core, a checker of accessibility, finds no fault on the page, in any state.

The checker is no part of this repository: `make check-page` fetches its package.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from palpate.library import TouchLibrary
from palpate.web import LiveSession

from .browser import expect

AXE = Path(os.environ.get("PALPATE_AXE", ".venv/axe/package/axe.min.js"))
if not AXE.is_file():
    pytest.skip(
        "axe-core is not there: `make check-page` fetches it", allow_module_level=True
    )

FAULTS = """async () => (await axe.run(document, {runOnly: ["wcag2a", "wcag2aa",
    "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]})).violations.map(
    (fault) => [fault.id, fault.help,
    fault.nodes.map((node) => node.target.join(" "))])"""


def check(page):
    """Ask axe at both widths, in the light and in the dark."""
    for width, height in ((1280, 900), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            page.wait_for_timeout(300)
            page.evaluate("window.axe !== undefined") or page.evaluate(AXE.read_text())
            faults = page.evaluate(FAULTS)
            assert faults == [], (width, scheme)


def test_the_page_has_no_fault_before_there_is_a_baseline(
    page, hand, serving, tmp_path
):
    with serving(LiveSession(hand, library=tmp_path / "library")) as (address, token):
        page.goto(f"{address}/")  # the sign-in page
        check(page)
        page.goto(f"{address}/?token={token}")
        expect(page.locator("#contact")).to_have_text("no baseline")
        check(page)


def test_the_page_has_no_fault_while_teaching_and_after_a_restart(
    page, make_session, open_page, tmp_path
):
    folder = tmp_path / "library"
    with open_page(make_session(library=folder)):
        page.fill("#name", "disc")
        page.press("#wanted", "Enter")
        page.select_option("#placed", "disc")
        expect(page.locator("#lesson-strip li")).not_to_have_count(0)
        page.select_option("#placed", "")
        if page.locator("#stop").is_visible():
            check(page)
    TouchLibrary.open(folder).close()
    session = make_session(library=folder)
    session.teach("bar", 8)
    session.stop()
    with open_page(make_session(library=folder)):
        expect(page.locator("#interrupted")).to_be_visible()
        check(page)


def test_the_page_has_no_fault_while_recognising_and_editing(
    page, taught, open_page, drawn
):
    with open_page(taught):
        expect(page.locator("#learnt")).to_have_text("2 objects learnt")
        check(page)
        for image in drawn.images[:5]:
            taught.post_touch(image)
        expect(page.locator("#strip li")).to_have_count(5)
        page.locator("#why summary").click()
        page.get_by_text("Download").click()
        check(page)
        page.keyboard.press("Escape")
        page.locator(".thumbs .look").first.click()
        expect(page.locator("#editor")).to_be_visible()
        check(page)
        page.keyboard.press("Escape")
        page.get_by_role("button", name="Forget disc").click()
        check(page)
        page.keyboard.press("Escape")
        page.get_by_role("button", name="Rename disc").click()
        check(page)


def test_the_page_has_no_fault_with_two_sensors_and_many_objects(
    page, open_page, make_session, drawn
):
    sessions = [make_session(rate_hz=60.0) for _ in range(2)]
    names = [f"thing {n}" for n in np.arange(90) % 20]
    for session, placed in zip(sessions, ("disc", "bar"), strict=True):
        session.teacher.library.add(drawn.with_columns(object=names))
        session.place(placed)
    with open_page(sessions):
        expect(page.locator("#sifted")).to_have_text("20 of 20 objects")
        expect(page.locator("#mixed")).to_be_visible()
        check(page)
