"""Rooms import downwards only, as docs/explanation/architecture.md says."""

import ast
import re
from pathlib import Path

import pytest

import palpate
from structure import update_passed

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "palpate"
EVERYTHING = {"everything above", "everything"}


def table():
    """Read the rooms and what each may import from the architecture page, in order."""
    page = (ROOT / "docs/explanation/architecture.md").read_text()
    rows = re.findall(r"^\| `(\w+)/` \|.*\| ([^|]+) \|$", page, re.MULTILINE)
    allowed: dict[str, set[str]] = {}
    for room, cell in rows:
        cell = cell.strip()
        if cell.startswith("all above but"):
            allowed[room] = set(allowed) - {cell.split("but ")[1]}
        elif cell in EVERYTHING:
            allowed[room] = {name for name, _ in rows} if room == "cli" else {*allowed}
        else:
            allowed[room] = set() if cell == "-" else set(re.split(r",\s*", cell))
    return allowed


ALLOWED = table()


def imports_of(path):
    """Yield (room, name) of everything a file takes from another room of palpate."""
    here = path.relative_to(SOURCE).parts[0]
    depth = len(path.relative_to(SOURCE).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ImportFrom) or node.level != depth:
            continue
        parts = (node.module or "").split(".")
        rooms = [parts[0]] if parts[0] else [alias.name for alias in node.names]
        for room in rooms:
            if room in ALLOWED and room != here:
                names = [alias.name for alias in node.names] if parts[0] else []
                yield room, [*parts[1:], *(n for n in names if n.startswith("_"))]


def test_every_room_is_on_the_page():
    rooms = {p.name for p in SOURCE.iterdir() if (p / "__init__.py").exists()}
    assert rooms == set(ALLOWED)


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_no_arrow_upwards_and_no_private_name(room):
    wrong = [
        f"{path.relative_to(SOURCE)}: {other}{'.' if inner else ''}{'.'.join(inner)}"
        for path in sorted((SOURCE / room).rglob("*.py"))
        for other, inner in imports_of(path)
        if other not in ALLOWED[room] or any(part.startswith("_") for part in inner)
    ]
    assert wrong == []


def test_one_touch_goes_the_way_that_is_drawn():
    """Every station is there, and an update reaches them in this order."""
    page = (ROOT / "docs/explanation/architecture.md").read_text()
    drawn = re.findall(r"^ *(\w+/\w+\.py) +(\w+)  ", page, re.MULTILINE)
    assert len(drawn) >= 8
    for file, name in drawn:
        assert re.search(rf"^(class|def) {name}\b", (SOURCE / file).read_text(), re.M)
    inside = Path(palpate.__file__).parent
    passed = [str(Path(file).relative_to(inside)) for file in update_passed()]
    assert list(dict.fromkeys(f for f in passed if f in dict(drawn))) == [*dict(drawn)]
    # 150 calls in 27 files when this was written: a fifth more wants to be noticed.
    assert len(passed) < 180
    assert len({*passed}) < 33


def test_every_file_that_the_page_names_is_there():
    page = (ROOT / "docs/explanation/architecture.md").read_text()
    names = re.findall(r"`(?:src/palpate/)?((?:\w+/)*_?\w+\.py)`", page)
    files = {str(path.relative_to(SOURCE)) for path in SOURCE.rglob("*.py")}
    outside = {name for name in names if (ROOT / name).is_file()}
    assert {n for n in names if not any(f.endswith(n) for f in files)} <= outside
