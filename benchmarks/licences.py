"""Print the table of docs/reference/licences.md, from what is installed here.

`python benchmarks/licences.py`; a package that is not installed has no row.
"""

import re
import tomllib
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Licences by their text, where the metadata do not name them in a word.
BY_TEXT = {"embreex": "BSD-2-Clause", "scikit-image": "BSD-3-Clause"}
_SHORT = {"MIT License": "MIT", "Apache Software License": "Apache-2.0"}


def requirements():
    """Yield each package that palpate may need, and the extra that brings it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for extra, lines in {"": project["dependencies"], **extras}.items():
        for line in lines:
            name = re.match(r"[\w.-]+", line)[0]
            if name != "palpate" and extra not in ("dev", "docs", "test"):
                yield name, extra or "always"


def licence(name):
    """Return the licence that an installed package states, in a word or two."""
    about = metadata.metadata(name)
    classified = [
        line.rsplit(" :: ", 1)[1]
        for line in about.get_all("Classifier", [])
        if line.startswith("License :: ") and not line.endswith(":: OSI Approved")
    ]
    stated = [about.get("License-Expression"), BY_TEXT.get(name), *classified]
    short = (about.get("License") or "not told").splitlines()[0]
    text = next((entry for entry in stated if entry), short)
    return _SHORT.get(text, text)


def rows():
    """Yield the rows of the table for the packages that are installed."""
    for name, extra in requirements():
        try:
            yield f"| {name} | {extra} | {licence(name)} |"
        except metadata.PackageNotFoundError:
            continue


if __name__ == "__main__":
    print("\n".join(["| package | extra | licence |", "|---|---|---|", *rows()]))
