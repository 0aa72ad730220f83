"""The table of licences is that of the packages that are installed."""

from pathlib import Path

import licences

PAGE = (Path(__file__).parents[1] / "docs/reference/licences.md").read_text()


def test_the_page_says_what_the_packages_say():
    wanted = set(licences.rows())
    assert wanted <= set(PAGE.splitlines()), "run python benchmarks/licences.py"


def test_every_package_has_a_row():
    named = {line.split("|")[1].strip() for line in PAGE.splitlines() if "|" in line}
    assert {name for name, _ in licences.requirements()} <= named
