"""Pages that are made from the code.

`python docs/reference.py` writes two that are kept: docs/reference/names.md, every
public name with the first line of its docstring, and docs/contributing/shared.md, the
other names that subpackages take from each other. Sphinx (`make docs`) calls
`write_generated`, which makes a page for every subpackage, command and address of the
API.
"""

import ast
import inspect
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from textwrap import shorten
from typing import Any

SUBPACKAGES = (
    "touches",
    "images",
    "encodings",
    "classifiers",
    "library",
    "recognition",
    "evaluation",
    "simulation",
    "datasets",
    "sensors",
    "exploration",
    "studies",
    "web",
)
INTRODUCTION = """\
`help(NAME)` says the rest: shapes, units, errors, sources. Made by
`python docs/reference.py`. What stays: [stability.md](stability.md).
"""
ABOUT_SHARED = """\
Beside its [public names](../reference/names.md) a subpackage offers these to those
below it in [the table](../explanation/architecture.md#subpackages): names in its
`__init__.py` (recognition: `__init__.pyi`) that are not in `__all__`. They may change
with any version. What no subpackage uses, tests, benchmarks or plugs do. To make one
public, add it to `__all__` and give all its methods docstrings; both this page and that
are made by `python docs/reference.py`.
"""
HERE = Path(__file__).parent
PACKAGE = HERE.parent / "src" / "palpate"
PAGE = HERE / "reference" / "names.md"
SHARED = HERE / "contributing" / "shared.md"


def reference() -> str:
    """Return the page."""
    parts = [
        "# Public names\n",
        INTRODUCTION,
        *(section(subpackage) for subpackage in SUBPACKAGES),
    ]
    return "\n".join(parts)


def section(subpackage: str) -> str:
    """Return the names of one subpackage."""
    module = import_module(f"palpate.{subpackage}")
    summary = inspect.getdoc(module).splitlines()[0]
    rows = [f"| `{name}` | {line(getattr(module, name))} |" for name in module.__all__]
    head = f"## palpate.{subpackage}\n\n{summary}\n\n| name | what it is |\n|---|---|\n"
    return head + "\n".join(rows) + "\n"


def line(item: object, comment: str = "") -> str:
    """Return what a name is, in one line; of a constant its comment, or its value."""
    if inspect.isclass(item) or inspect.isroutine(item) or inspect.ismodule(item):
        return inspect.getdoc(item).splitlines()[0].replace("|", "\\|")
    if comment:
        return comment.replace("|", "\\|")
    if not isinstance(item, tuple | list | set | dict):
        return f"{type(item).__name__}: `{shorten(str(item), 60)}`".replace("|", "\\|")
    return f"{type(item).__name__}: {', '.join(f'`{n}`' for n in map(name_of, item))}"


def name_of(value: object) -> object:
    """Return what a value in a table of them is called."""
    return getattr(value, "name", value)


def shared() -> str:
    """Return the page of what subpackages share beside their public names."""
    users = users_of_names()
    parts = ["# Names for other subpackages\n", ABOUT_SHARED]
    for subpackage in SUBPACKAGES:
        module = import_module(f"palpate.{subpackage}")
        rows = [
            f"| `{name}` | {line(getattr(module, name), above(path, name))} | "
            f"`{path.name}` | {', '.join(users.get((subpackage, name), []))} |"
            for name, path in sorted(offered(subpackage).items())
            if name not in module.__all__
        ]
        if rows:
            head = "| name | what it is | in | used by |\n|---|---|---|---|\n"
            parts.append(f"## {subpackage}\n\n{head}" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def offered(subpackage: str) -> dict[str, Path]:
    """Return the names that a subpackage imports from its own files, and the file."""
    folder = PACKAGE / subpackage
    stub = folder / "__init__.pyi"
    path = stub if stub.exists() else stub.with_suffix(".py")
    return {
        alias.asname or alias.name: folder / f"{node.module or alias.name}.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.level == 1
        for alias in node.names
    }


def above(path: Path, name: str) -> str:
    """Return the comment above the line of a file that begins with a name, or ""."""
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    words: list[str] = []
    for text in lines:
        if text.startswith((f"{name} = ", f"{name}: ")):
            break
        words = [*words, text[2:]] if text.startswith("# ") else []
    return " ".join(words)


def users_of_names() -> dict[tuple[str, str], list[str]]:
    """Return who takes each (subpackage, name) from outside, sorted."""
    users: dict[tuple[str, str], set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        user = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for subpackage, name in taken(path):
            if subpackage != user:
                users.setdefault((subpackage, name), set()).add(user)
    return {key: sorted(names) for key, names in users.items()}


def taken(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (subpackage, name) of what a file imports or reads from subpackages."""
    depth = len(path.relative_to(PACKAGE).parts)
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == depth and node.module:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield node.value.id, node.attr


def write_generated(folder: Path) -> None:
    """Write the pages that Sphinx reads besides those that people wrote."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {
        f"{subpackage}.rst": subpackage_page(subpackage) for subpackage in SUBPACKAGES
    }
    pages |= {"command-line.md": command_page(), "http.md": http_page()}
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, encoding="utf-8")


def subpackage_page(subpackage: str) -> str:
    """Return the page of a subpackage: what it is about, and a page for each name."""
    module = import_module(f"palpate.{subpackage}")
    title = f"palpate.{subpackage}"
    names = "\n".join(f"   ~palpate.{subpackage}.{name}" for name in module.__all__)
    about = inspect.getdoc(module) or ""
    return (
        f"{title}\n{'=' * len(title)}\n\n{about.replace('`', '``')}\n\n"
        f".. autosummary::\n   :toctree: names\n\n{names}\n"
    )


def command_page() -> str:
    """Return every command with its arguments and options, as its help has them."""
    from typer.main import get_command

    from palpate.cli import app

    parts = [
        "# Options of commands",
        "What `palpate COMMAND --help` says, on one page.",
    ]
    for words, command in sorted(_commands(get_command(app), ())):
        parts += [f"## palpate {' '.join(words)}", _escaped(command.help)]
        takes = [p for p in command.params if p.param_type_name == "argument"]
        usage = " ".join(["palpate", *words, "[OPTIONS]", *map(_argument, takes)])
        parts += [f"```text\n{usage}\n```", _options(command.params)]
    return "\n\n".join(parts) + "\n"


def _commands(
    command: Any, words: tuple[str, ...]
) -> list[tuple[tuple[str, ...], Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        return [(words, command)]
    return [
        (inner_words, verb)
        for name, group in inner.items()
        for inner_words, verb in _commands(group, (*words, name))
        if not verb.hidden
    ]


def _argument(parameter: Any) -> str:
    name = (parameter.metavar or parameter.name.upper()).strip("{}[]")
    many = "..." if parameter.nargs == -1 and not name.endswith("...") else ""
    return f"{name}{many}" if parameter.required else f"[{name}{many}]"


def _options(parameters: list[Any]) -> str:
    rows = []
    for parameter in parameters:
        if getattr(parameter, "hidden", False) or "--help" in parameter.opts:
            continue
        is_argument = parameter.param_type_name == "argument"
        name = _argument(parameter) if is_argument else ", ".join(parameter.opts)
        kind = "" if is_argument or parameter.is_flag else f" {_type(parameter)}"
        value = parameter.default
        has_default = value not in (None, "", ()) and value is not False
        default = f"`{value}`" if has_default else ""
        default = "required" if parameter.required else default
        help_text = _escaped(parameter.help or "").replace("|", "\\|")
        rows.append(f"| `{name}{kind}` | {help_text} | {default} |")
    return "| | what | default |\n|---|---|---|\n" + "\n".join(rows)


def _type(parameter: Any) -> str:
    """Return the type of an option; typer before 0.29 has click's name of it."""
    described = getattr(parameter, "type_descriptor", None)
    return str(parameter.type.name if not described else described.annotation.__name__)


def _escaped(text: str) -> str:
    """Return words of help as Markdown: one paragraph, nothing taken for markup."""
    joined = " ".join(text.split()).replace("\\[", "[")
    for sign in "\\*_<[":
        joined = joined.replace(sign, f"\\{sign}")
    return joined


def http_page() -> str:
    """Return every address of the API, from the description that the server gives."""
    from palpate.web import LiveSession, create_app

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        app = create_app(LiveSession(), token="t" * 32)
    described = app.openapi()
    calls = [
        (path, verb, about)
        for path, verbs in described["paths"].items()
        for verb, about in verbs.items()
    ]
    codes = [{*about["responses"]} for *_, about in calls]
    common = set.intersection(*codes) - {"200"}
    about = (
        f"Of `palpate serve`; the running server describes itself at "
        f"`{app.openapi_url}`. How to come in, and how touches are sent: "
        "[the live page](../live.md#for-robots-the-api)."
    )
    parts = [
        "# The HTTP API",
        about,
        "Every address may refuse with one of these; the `detail` says what to do:",
        _answers(calls[0][2], common),
    ]
    for path, verb, call in calls:
        parts += [f"## {verb.upper()} {path}", *_call(call, described, common)]
    return "\n\n".join(parts) + "\n"


def _answers(about: dict[str, Any], codes: set[str]) -> str:
    rows = [
        f"| {code} | {_escaped(answer.get('description', ''))} | "
        f"{', '.join(answer.get('content', {})) or '-'} |"
        for code, answer in about["responses"].items()
        if code in codes
    ]
    return "| answer | what | as |\n|---|---|---|\n" + "\n".join(rows)


def _call(
    about: dict[str, Any], described: dict[str, Any], common: set[str]
) -> list[str]:
    parts = [_escaped(about.get("description") or about.get("summary", ""))]
    if about.get("deprecated"):
        parts.append("**Deprecated**: goes with the next release.")
    takes = [
        (p["name"], p["in"], p.get("schema", {}), p.get("required", False))
        for p in about.get("parameters", [])
    ]
    for kind, body in about.get("requestBody", {}).get("content", {}).items():
        schema = _resolved(body.get("schema", {}), described)
        inside = schema.get("properties", {"body": schema})
        musts = schema.get("required", [])
        takes += [(n, kind, inner, n in musts) for n, inner in inside.items()]
    if takes:
        rows = [
            f"| `{n}` | {where} | {_kind(s, described)} | {'yes' if must else ''} | "
            f"{_escaped(s.get('description', '')).replace('|', chr(92) + '|')} |"
            for n, where, s, must in takes
        ]
        head = "| takes | in | type | must | what |\n|---|---|---|---|---|\n"
        parts.append(head + "\n".join(rows))
    parts.append(_answers(about, {*about["responses"]} - common))
    return parts


def _resolved(schema: dict[str, Any], described: dict[str, Any]) -> dict[str, Any]:
    name = schema.get("$ref", "").rpartition("/")[2]
    return described["components"]["schemas"][name] if name else schema


def _kind(schema: dict[str, Any], described: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_kind(kind, described) for kind in schema["anyOf"])
    if "$ref" in schema:
        return schema["$ref"].rpartition("/")[2]
    return str(schema.get("type", "any"))


if __name__ == "__main__":
    for page, text in ((PAGE, reference()), (SHARED, shared())):
        page.write_text(text)
        print(page)
