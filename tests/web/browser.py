"""What the tests of the page in a browser share."""

import pytest

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed"
)
expect = playwright.expect
expect.set_options(timeout=20_000)
PATIENT = 40_000


def card_of(page, name):
    """Return the card of an object that was taught."""
    title = page.get_by_role("heading", name=name, exact=True)
    return page.locator("li.object", has=title)


def resize(page, width, height):
    """Make the window larger or smaller; the page is laid out anew before the next."""
    page.set_viewport_size({"width": width, "height": height})
    for _ in range(1000):  # ten seconds
        if page.evaluate("window.innerWidth") == width:
            return
        page.wait_for_timeout(10)
    raise AssertionError(f"the window is not {width} pixels wide")


def fits(page):
    """Whether nothing is wider than the window."""
    width = page.viewport_size["width"]
    return page.evaluate("document.documentElement.scrollWidth") <= width
