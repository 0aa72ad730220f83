"""Cards say what a person must know, and the page of recorded touches says the same."""

import re
from pathlib import Path

import pytest

from palpate.datasets import card, names

DOCS = Path(__file__).parents[2] / "docs"
NEEDED = {
    *("name", "what", "sensor", "touches", "objects", "sessions", "licence", "makes"),
    *("leaks", "not_for", "tried", "source", "holds", "figures"),
}


def row(name):
    """Return the row of a set in docs/reference/data.md."""
    one = card(name)
    place = ", ".join(f"`{place}`" for place in one["makes"])
    source = (
        f"[{one['source']['page'].split('//')[1].rstrip('/')}]({one['source']['page']})"
    )
    state = "no" if "why_not" in one else "yes"
    cells = (
        f"`{name}`",
        one["what"],
        place,
        source,
        one["licence"].split(".")[0],
        state,
    )
    return f"| {' | '.join(cells)} |"


@pytest.mark.parametrize("name", names())
def test_a_card_is_complete(name):
    one = card(name)
    assert set(one) >= NEEDED
    assert ("why_not" in one) != ("convert" in one)
    for known in one["figures"]:
        assert set(known) == {"figure", "split", "command", "page"}
    if "convert" in one:
        columns = set(one["convert"].get("columns", {}))
        assert set(one["arrays"]) <= columns | set(one["holds"])
        assert one["source"]["most_mb"] > 0
        assert re.search(r"[0-9a-f]{8}|1\.0\.0", one["source"]["url"])
        assert all(re.fullmatch("[0-9a-f]{64}", s) for s in one["arrays"].values())


@pytest.mark.parametrize("name", names())
def test_figures_stand_on_their_page(name):
    """Every number of a figure is on the page that the card names for it."""
    for known in card(name)["figures"]:
        page = (DOCS.parent / known["page"]).read_text(encoding="utf-8")
        numbers = re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w])", known["figure"])
        assert numbers
        for number in numbers:
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.]*\d)", page), (
                number
            )


@pytest.mark.parametrize("name", names())
def test_the_page_of_recorded_touches_has_the_set(name):
    assert row(name) in (DOCS / "reference/data.md").read_text("utf-8"), row(name)


def test_no_licence_is_made_up():
    for name in names():
        licence = card(name)["licence"]
        assert licence.startswith(("None stated", "GPL-3 of the", "Open Data Commons"))
        if licence.startswith("None stated"):
            assert "do not hand it on" in licence
