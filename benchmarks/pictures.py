"""Which picture of the documentation is made by what, and whether it is of today.

    python benchmarks/pictures.py                   # which pictures are stale
    python benchmarks/pictures.py live-desktop.png  # make it anew, and note that
    python benchmarks/pictures.py --made NAME ...   # note that they were made
    python benchmarks/pictures.py --study corradi2015 [--quick] [NAME ...]
    python benchmarks/pictures.py --study corradi2015 --of result.json [NAME ...]

`docs/images/made.json` holds for each picture the command that makes it, the files that
say what it shows, and a hash of these. Of Python files the code counts, not comments,
docstrings and layout; of a page named as `PAGE.md#tables` the rows of its tables: the
picture of a study belongs to the tables of the same run. A picture whose files have
changed is stale: make it anew, and look at it. `--study` runs a study with the recorded
touches of PALPATE_DATA and writes its pictures (all, or those named); `--of` takes what
`palpate study NAME --json` printed instead. Where all are written, the tables of its
page are too, with one figure a cell: those whose heads are the study's; alike ones come
in its order.
"""

import argparse
import ast
import hashlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import tokenize
from pathlib import Path
from typing import Any

from tables import split

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
MADE = IMAGES / "made.json"
TABLES = "#tables"


def main() -> None:
    """Tell what is stale, or make pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--made", action="store_true")
    parser.add_argument("--study")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--of", type=Path, metavar="FILE")
    options = parser.parse_args()
    records = json.loads(MADE.read_text("utf-8"))
    if options.study:
        draw_study(options.study, options.names, options.quick, options.of)
        return
    if not options.names:
        print("\n".join(stale(records)) or "All pictures are of today.")
        return
    for command in {records[name]["command"] for name in options.names}:
        if not options.made:
            subprocess.run([sys.executable, *command.split()[1:]], check=True, cwd=ROOT)
    for name in options.names:
        records[name]["sha256"] = inputs_hash(records[name]["inputs"])
    MADE.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")


def stale(records: dict[str, dict[str, Any]]) -> list[str]:
    """Return the pictures whose inputs have changed since they were made."""
    return [
        name
        for name, record in records.items()
        if inputs_hash(record["inputs"]) != record["sha256"]
    ]


def inputs_hash(inputs: list[str]) -> str:
    """Return one hash of all that some patterns below the root name."""
    digest = hashlib.sha256()
    for pattern in inputs:
        paths = sorted(ROOT.glob(pattern.removesuffix(TABLES)))
        if not paths:
            raise FileNotFoundError(f"{MADE} names {pattern}, which is not there.")
        for path in paths:
            digest.update(_content(path, tables=pattern.endswith(TABLES)))
    return digest.hexdigest()


def _content(path: Path, *, tables: bool) -> bytes:
    """Return the content of a file that its hash covers."""
    data = path.read_bytes()
    if tables:
        return b"\n".join(line for line in data.splitlines() if line[:1] == b"|")
    if path.suffix != ".py":
        return data
    lines = data.decode().splitlines()
    for node in ast.walk(ast.parse(data)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            first = node.body[0] if node.body else None
            if ast.get_docstring(node) is not None and isinstance(first, ast.Expr):
                gone = range(first.lineno - 1, first.end_lineno or first.lineno)
                lines = ["" if n in gone else line for n, line in enumerate(lines)]
    kept = "\n".join(lines)
    for token in tokenize.generate_tokens(io.StringIO(data.decode()).readline):
        if token.type == tokenize.COMMENT:
            kept = kept.replace(token.string, "")
    return "".join(kept.split()).encode()


def draw_study(name: str, wanted: list[str], quick: bool, of: Path | None) -> None:
    """Run a study and write its pictures, in the one look, and its page's tables."""
    import matplotlib.pyplot as plt

    from palpate.studies import STUDIES

    plt.style.use(ROOT / "docs" / "palpate.mplstyle")
    study = STUDIES[name]
    if of is not None:
        result = json.loads(of.read_text("utf-8"))
    else:
        result = study.run(data=os.environ.get("PALPATE_DATA"), quick=quick, seed=0)
    with tempfile.TemporaryDirectory() as place:
        for path in study.write_pictures(place, result):
            picture = path.name.replace(f"{name}-{name}", name)
            if not wanted or picture in wanted:
                (IMAGES / picture).write_bytes(path.read_bytes())
                print(IMAGES / picture)
    if not wanted and not quick:
        page = ROOT / "docs" / "explanation" / f"{name}.md"
        tables = study.tables(result)
        page.write_text(with_tables(page.read_text("utf-8"), tables), "utf-8")


def with_tables(page: str, tables: list[tuple[str, list[str], list[list[str]]]]) -> str:
    """Return a page, its tables by those of a study; what has no place is printed."""
    parts: dict[str, str] = {}
    for title, *table in tables:
        heads, rows = split(*table, brackets="paper")
        head, mark = row_of(heads), f"<!-- table {len(parts)} -->"
        match = re.search(
            rf"^{re.escape(head)}\n[|: -]+\n(\|.*\n)*", page, re.MULTILINE
        )
        if match is None:
            print(f"not on the page: {title}")
            continue
        lines = [head, "|---" * len(heads) + "|", *map(row_of, rows)]
        parts[mark] = "".join(f"{line}\n" for line in lines)
        page = page[: match.start()] + mark + page[match.end() :]
    for mark, part in parts.items():
        page = page.replace(mark, part)
    return page


def row_of(cells: list[str]) -> str:
    """Return a row of a table of Markdown."""
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
