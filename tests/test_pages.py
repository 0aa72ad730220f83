"""The pages have pictures with their commands, an install line, and licences."""

import json
import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

import licences
import pictures
from palpate.cli import app
from tables import one_figure_a_cell, split

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RECORDS = json.loads(pictures.MADE.read_text("utf-8"))
PICTURE = re.compile(r"!\[[^\]]+\]\((?:docs/|\.\./)?images/([\w.-]+)\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_picture_stands_beside_its_command(page):
    text = " ".join(page.read_text("utf-8").split())
    for name in PICTURE.findall(text):
        command, *_ = RECORDS[name]["command"].partition(" --quick")
        assert command in text
        script = ROOT / command.split()[1]
        assert script.is_file()
    assert len(re.findall(r"\]\([./a-z]*images/", text)) == len(PICTURE.findall(text))


def test_every_picture_is_on_a_page_and_none_is_stale():
    images = pictures.IMAGES
    names = {path.name for path in images.iterdir()} - {pictures.MADE.name}
    text = "".join(page.read_text("utf-8") for page in PAGES)
    assert set(PICTURE.findall(text)) == names == set(RECORDS)
    # CONTRIBUTING.md says how to draw the pictures named here again.
    assert pictures.stale(RECORDS) == []


def test_a_picture_is_stale_when_code_or_a_table_changes_and_not_for_words(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(pictures, "ROOT", tmp_path)
    code, page = tmp_path / "a.py", tmp_path / "b.md"
    inputs = ["*.py", "b.md#tables"]

    def hashed(source, text):
        code.write_text(source)
        page.write_text(text)
        return pictures.inputs_hash(inputs)

    first = hashed('"""Words."""\nSIZE = 3\n', "Words.\n\n| 5 |\n")
    assert (
        hashed('"""More\nwords."""\n\nSIZE = 3  # rows\n', "Other.\n| 5 |\n") == first
    )
    assert hashed('"""Words."""\nSIZE = 4\n', "Words.\n\n| 5 |\n") != first
    assert hashed('"""Words."""\nSIZE = 3\n', "Words.\n\n| 6 |\n") != first
    records = {"x.png": {"inputs": inputs, "sha256": first}}
    assert pictures.stale(records) == ["x.png"]
    with pytest.raises(FileNotFoundError, match=r"names gone\.py, which is not there"):
        pictures.inputs_hash(["gone.py"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_spread_has_a_column_of_its_own(page):
    text = page.read_text("utf-8")
    assert one_figure_a_cell(text) == text


def test_figures_spreads_and_brackets_become_columns():
    heads, rows = split(
        ["method", "after 1 / 5", "right (sd)"],
        [["default", "54 ± 16 / 69 ± 15", "3.5 (1.6)"], ["paper", "-", "4"]],
    )
    assert heads == ["method", "after 1", "±", "5", "±", "right", "sd"]
    assert rows[0] == ["default", "54", "16", "69", "15", "3.5", "1.6"]
    assert rows[1] == ["paper", "-", "-", "-", "-", "4", "-"]
    assert split(["n"], [["2.0 (1.9)"]], "paper") == (["n", "paper"], [["2.0", "1.9"]])
    kept = ["array"], [["4 (2)"], ["33 of 40"]]
    assert split(*kept) == kept


def test_the_install_line_names_the_repository_and_extras_that_exist():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    readme = PAGES[0].read_text("utf-8")
    (line,) = re.findall(r'pip install "palpate\[(.+)\] @ git\+(\S+)"', readme)
    assert line[1] == project["urls"]["Source"]
    assert set(line[0].split(",")) <= set(project["optional-dependencies"])
    assert f'pip install ".[{line[0]}]"' in readme


def test_the_first_page_is_read_in_minutes():
    words = PAGES[0].read_text("utf-8").split()
    assert len(words) < 830


@pytest.mark.parametrize("folder", ["tutorials", "howto", "explanation", "reference"])
def test_an_index_links_every_page_that_is_written_by_hand(folder):
    """A toctree is a list only on the site; links work everywhere."""
    text = (ROOT / "docs" / folder / "index.md").read_text("utf-8")
    trees = re.findall(r":::\{toctree\}\n(.*?)\n:::", text, flags=re.DOTALL)
    entries = [line for tree in trees for line in tree.split("\n") if line]
    pages = {e for e in entries if not e.startswith((":", "generated/"))}
    links = dict(re.findall(r"^- \[(.+)\]\((\S+)\.md\)$", text, flags=re.MULTILINE))
    assert set(links.values()) == pages
    for title, page in links.items():
        written = (ROOT / "docs" / folder / f"{page}.md").read_text("utf-8")
        assert f"# {title}\n" in written


def test_the_page_of_commands_has_every_command_and_what_it_cannot_do_without():
    page = (ROOT / "docs" / "reference" / "commands.md").read_text("utf-8")
    command = typer.main.get_command(app)
    for verb, inner in command.commands.items():
        for name, one in getattr(inner, "commands", {"": inner}).items():
            form = re.escape(f"palpate {verb} {name}".rstrip())
            (typed,) = re.findall(rf"\| `{form}((?: [^`a-z][^`]*)?)` \|", page)
            needed = [option.opts for option in one.params if option.required]
            options = [spellings for spellings in needed if spellings[0][0] == "-"]
            assert all({*typed.split()} & {*spellings} for spellings in options)


LICENCES = (ROOT / "docs/reference/licences.md").read_text()


@pytest.mark.skipif(
    f"threadpoolctl=={version('threadpoolctl')}\n"
    not in (ROOT / "constraints.txt").read_text(),
    reason="these are not the packages of constraints.txt, whose licences are listed",
)
def test_the_page_has_the_licences_that_the_packages_state():
    expected = set(licences.rows())
    assert expected <= set(LICENCES.splitlines()), "run python benchmarks/licences.py"


def test_every_package_has_a_row():
    named = {
        line.split("|")[1].strip() for line in LICENCES.splitlines() if "|" in line
    }
    assert {name for name, _ in licences.requirements()} <= named
