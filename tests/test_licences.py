"""The table of licences is that of the packages that are installed."""

from importlib.metadata import version
from pathlib import Path

import pytest

import licences

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/reference/licences.md").read_text()


@pytest.mark.skipif(
    f"threadpoolctl=={version('threadpoolctl')}\n"
    not in (ROOT / "constraints.txt").read_text(),
    reason="these are not the packages of constraints.txt, whose licences are listed",
)
def test_the_page_says_what_the_packages_say():
    wanted = set(licences.rows())
    assert wanted <= set(PAGE.splitlines()), "run python benchmarks/licences.py"


def test_every_package_has_a_row():
    named = {line.split("|")[1].strip() for line in PAGE.splitlines() if "|" in line}
    assert {name for name, _ in licences.requirements()} <= named
