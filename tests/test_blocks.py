"""Every command and every Python block of the pages is run, or says why not.

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
# Blocks that are neither commands nor Python.
KINDS_NOT_RUN = {"text", "toml", "json", "c", "{eval-rst}"}


def blocks(page):
    """Return (line, kind, body, reason) of every fenced block of a page."""
    text = "\n" + page.read_text("utf-8")
    fenced = []
    for block in FENCE.finditer(text):
        before = block["before"]
        needed = NEEDS.search(before)
        missing = needed is not None and find_spec(needed[1]) is None
        reason = before.strip() if missing or NOT_RUN.search(before) else None
        line = text.count("\n", 0, block.start("mark"))
        fenced.append((line, block["kind"].strip(), block["body"], reason))
    return fenced


def is_slow(page):
    """Return whether a page is marked as one that takes more than some seconds."""
    return "<!-- slow -->" in page.read_text("utf-8")[:200]


def test_every_block_says_what_it_is():
    """A block that does not name its language would never be run."""
    unlabelled = [
        f"{page.relative_to(ROOT)}:{line}: {kind or 'no language'}"
        for page in PAGES
        for line, kind, _, _ in blocks(page)
        if kind not in {"sh", "python", *KINDS_NOT_RUN}
    ]
    assert unlabelled == []


def test_commands_are_not_hidden_as_text():
    hidden = [
        f"{page.relative_to(ROOT)}:{line}"
        for page in PAGES
        for line, kind, body, _ in blocks(page)
        if kind == "text" and re.match(r"(palpate|pip|make|python) ", body)
    ]
    assert hidden == []


def printed_below(page):
    """Return the text right below each block, which it prints, by the block's line."""
    lines, page_blocks = page.read_text("utf-8").splitlines(), blocks(page)
    printed = {}
    for (line, _, body, _), (next_line, kind, text, _) in pairwise(page_blocks):
        end = line + body.count("\n") + 1
        if kind == "text" and not "".join(lines[end : next_line - 1]).strip():
            printed[line] = text
    return printed


def is_like(output, expected):
    """Return whether an output has the expected lines; "..." is any number of them."""
    patterns = (
        r"(.*\n)*" if line.strip() == "..." else re.escape(line.rstrip()) + r" *\n"
        for line in expected.splitlines()
    )
    return re.fullmatch("".join(patterns), output.rstrip() + "\n") is not None


def test_output_is_compared_with_the_text_below_a_block():
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
    expected = printed_below(page)
    for line, kind, body, reason in blocks(page):
        if reason is not None or kind not in {"sh", "python"}:
            continue
        if kind == "python":
            printed = io.StringIO()
            with warnings.catch_warnings(), redirect_stdout(printed):
                if "torch" in body:  # torch warns about itself
                    warnings.simplefilter("ignore")
                exec(compile(body, f"{page}:{line}", "exec"), names)
            output = printed.getvalue()
        else:
            completed = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", body],
                capture_output=True,
                text=True,
                check=False,
            )
            report = f"{page}:{line}\n{completed.stdout}\n{completed.stderr}"
            assert completed.returncode == 0, report
            output = completed.stdout
        print(output)
        if line in expected:
            assert is_like(output, expected[line]), f"{page}:{line} prints\n{output}"


def _commands(folder):
    """Return a folder with the `palpate` and the `python` that run this test."""
    place = folder / ".commands"
    place.mkdir()
    python = shlex.quote(sys.executable)
    for name, arguments in {"palpate": "-m palpate", "python": ""}.items():
        path = place / name
        path.write_text(f'#!/bin/sh\nexec {python} {arguments} "$@"\n')
        path.chmod(0o755)
    return place
