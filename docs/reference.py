"""Write docs/reference.md: every public name, with the first line of its docstring.

python docs/reference.py
"""

import inspect
from importlib import import_module
from pathlib import Path

ROOMS = (
    "touches",
    "datasets",
    "images",
    "encodings",
    "classifiers",
    "library",
    "recognition",
    "evaluation",
    "simulation",
    "sensors",
    "exploration",
    "studies",
    "web",
    "bench",
)
INTRODUCTION = """\
`help(NAME)` says the rest: shapes, units, errors, sources. Made by
`python docs/reference.py`. What stays: [stability.md](stability.md).
"""
PAGE = Path(__file__).with_name("reference.md")


def reference() -> str:
    """Return the page."""
    parts = [
        "# Public names\n",
        INTRODUCTION,
        *(section(room) for room in ROOMS),
    ]
    return "\n".join(parts)


def section(room: str) -> str:
    """Return the names of one room."""
    module = import_module(f"palpate.{room}")
    summary = inspect.getdoc(module).splitlines()[0]
    rows = [f"| `{name}` | {line(getattr(module, name))} |" for name in module.__all__]
    head = f"## palpate.{room}\n\n{summary}\n\n| name | what it is |\n|---|---|\n"
    return head + "\n".join(rows) + "\n"


def line(item: object) -> str:
    """Return what a name is, in one line."""
    if not (inspect.isclass(item) or inspect.isroutine(item)):
        return f"{type(item).__name__}: {', '.join(f'`{key}`' for key in item)}"
    return inspect.getdoc(item).splitlines()[0].replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(reference())
    print(PAGE)
