"""Every command and every Python block of the pages is run, or marked why it is not.

A page is run from top to bottom in a folder of its own. Blocks of ```sh are commands,
blocks of ```python share their names. `<!-- not run: REASON -->` before a block leaves
it out; so does a page whose first lines say `<!-- blocks not run: REASON -->`. After
`<!-- needs PACKAGE -->` a block is run where the package is. A ```text block right
below one is what that prints; a line "..." stands for any lines.
"""

import io
import os
import re
import shlex
import subprocess
import sys
import time
import warnings
from contextlib import redirect_stdout
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *(
        path
        for path in sorted((ROOT / "docs").rglob("*.md"))
        if not {"_build", "gallery", "generated"} & {*path.parts}
    ),
]
FENCE = re.compile(
    r"(?P<before>[^\n]*)\n(?P<mark>`{3,})(?P<kind>[^\n]*)\n(?P<body>.*?)^(?P=mark) *$",
    re.DOTALL | re.MULTILINE,
)
NEEDS = re.compile(r"<!-- needs (\w+) -->")
NOT_RUN = re.compile(r"<!-- not run: \w.{7,} -->")
# Shown, not run: no commands and no Python.
SHOWN = {"text", "toml", "json", "c", "{eval-rst}"}


def blocks(page):
    """Return (line, kind, body, reason) of every fenced block of a page."""
    text = "\n" + page.read_text("utf-8")
    found = []
    for block in FENCE.finditer(text):
        before = block["before"]
        needed = NEEDS.search(before)
        missing = needed is not None and find_spec(needed[1]) is None
        reason = before.strip() if missing or NOT_RUN.search(before) else None
        line = text.count("\n", 0, block.start("mark"))
        found.append((line, block["kind"].strip(), block["body"], reason))
    return found


def is_slow(page):
    """Return whether a page says that its blocks take more than some seconds."""
    return "<!-- slow -->" in page.read_text("utf-8")[:200]


def test_every_block_says_what_it_is():
    """A block without a word for its language would never be run."""
    unsaid = [
        f"{page.relative_to(ROOT)}:{line}: {kind or 'no language'}"
        for page in PAGES
        for line, kind, _, _ in blocks(page)
        if kind not in {"sh", "python", *SHOWN}
    ]
    assert unsaid == []


def test_commands_are_not_hidden_as_text():
    hidden = [
        f"{page.relative_to(ROOT)}:{line}"
        for page in PAGES
        for line, kind, body, _ in blocks(page)
        if kind == "text" and re.match(r"(palpate|pip|make|python) ", body)
    ]
    assert hidden == []


def printed_below(page):
    """Return what stands right below a block as what that prints, by its line."""
    lines, found = page.read_text("utf-8").splitlines(), blocks(page)
    shown = {}
    for (line, _, body, _), (next_line, kind, text, _) in pairwise(found):
        end = line + body.count("\n") + 1
        if kind == "text" and not "".join(lines[end : next_line - 1]).strip():
            shown[line] = text
    return shown


def is_like(output, shown):
    """Return whether lines are those shown, of which "..." is any number."""
    patterns = (
        r"(.*\n)*" if line.strip() == "..." else re.escape(line.rstrip()) + r" *\n"
        for line in shown.splitlines()
    )
    return re.fullmatch("".join(patterns), output.rstrip() + "\n") is not None


def test_what_is_printed_is_compared_with_what_is_shown():
    assert is_like("a\nb  \nc\n", "a\nb\nc\n")
    assert is_like("a\nb\nc\n", "...\nc\n")
    assert not is_like("a\nb\nc\n", "a\nb\n")
    assert not is_like("mug 0.9\n", "mug 1.0\n")


def run_pages():
    """Return a parameter for every page with something to run."""
    return [
        pytest.param(
            page,
            id=str(page.relative_to(ROOT)),
            marks=[pytest.mark.slow] if is_slow(page) else [],
        )
        for page in PAGES
        if any(
            kind in {"sh", "python"} and reason is None
            for _, kind, _, reason in blocks(page)
        )
    ]


@pytest.mark.parametrize("page", run_pages())
def test_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setenv("PALPATE_DATA_HOME", str(tmp_path / ".cache"))  # ready models
    monkeypatch.setenv("PATH", f"{_commands(tmp_path)}{os.pathsep}{os.environ['PATH']}")
    names = {"__name__": "__main__"}
    begun = time.monotonic()
    shown = printed_below(page)
    for line, kind, body, reason in blocks(page):
        if reason is not None or kind not in {"sh", "python"}:
            continue
        if kind == "python":
            printed = io.StringIO()
            with warnings.catch_warnings(), redirect_stdout(printed):
                if "torch" in body:  # warns about itself
                    warnings.simplefilter("ignore")
                exec(compile(body, f"{page}:{line}", "exec"), names)
            output = printed.getvalue()
        else:
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", body],
                capture_output=True,
                text=True,
                check=False,
            )
            said = f"{page}:{line}\n{done.stdout}\n{done.stderr}"
            assert done.returncode == 0, said
            output = done.stdout
        print(output)
        if line in shown:
            assert is_like(output, shown[line]), f"{page}:{line} prints\n{output}"
    print(f"{page.name}: {time.monotonic() - begun:.0f} s")


def _commands(folder):
    """Return a folder with a `palpate` and a `python` that are those of this test."""
    place = folder / ".commands"
    place.mkdir()
    python = shlex.quote(sys.executable)
    for name, words in {"palpate": "-m palpate", "python": ""}.items():
        path = place / name
        path.write_text(f'#!/bin/sh\nexec {python} {words} "$@"\n')
        path.chmod(0o755)
    return place
