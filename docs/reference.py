"""Pages that are made from the code.

`python docs/reference.py` writes docs/reference/names.md: every public name, with the
first line of its docstring. Sphinx (`make docs`) calls `write_generated`, which makes a
page for every subpackage, command and address of the API; these are not kept.
"""

import inspect
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

SUBPACKAGES = (
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
PAGE = Path(__file__).parent / "reference" / "names.md"


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


def line(item: object) -> str:
    """Return what a name is, in one line."""
    if not (inspect.isclass(item) or inspect.isroutine(item)):
        return f"{type(item).__name__}: {', '.join(f'`{key}`' for key in item)}"
    return inspect.getdoc(item).splitlines()[0].replace("|", "\\|")


def write_generated(folder: Path) -> None:
    """Write what Sphinx reads besides the pages that people wrote."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {
        f"{subpackage}.rst": subpackage_page(subpackage) for subpackage in SUBPACKAGES
    }
    made |= {"command-line.md": command_page(), "http.md": http_page()}
    for name, text in made.items():
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
    found = [_commands(one, (*words, name)) for name, one in inner.items()]
    return [one for some in found for one in some if not one[1].hidden]


def _argument(parameter: Any) -> str:
    name = (parameter.metavar or parameter.name.upper()).strip("{}[]")
    many = "..." if parameter.nargs == -1 and not name.endswith("...") else ""
    return f"{name}{many}" if parameter.required else f"[{name}{many}]"


def _options(parameters: list[Any]) -> str:
    rows = []
    for one in parameters:
        if getattr(one, "hidden", False) or "--help" in one.opts:
            continue
        argument = one.param_type_name == "argument"
        name = _argument(one) if argument else ", ".join(one.opts)
        kind = "" if argument or one.is_flag else f" {_type(one)}"
        default = one.default
        known = default not in (None, "", ()) and default is not False
        said = "required" if one.required else f"`{default}`" if known else ""
        help_ = _escaped(one.help or "").replace("|", "\\|")
        rows.append(f"| `{name}{kind}` | {help_} | {said} |")
    return "| | what | default |\n|---|---|---|\n" + "\n".join(rows)


def _type(parameter: Any) -> str:
    """Return the type of an option; typer before 0.29 has click's name of it."""
    described = getattr(parameter, "type_descriptor", None)
    known = parameter.type.name if described is None else described.annotation.__name__
    return str(known)


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
    every = [{*about["responses"]} for *_, about in calls]
    shared = set.intersection(*every) - {"200"}
    about = (
        f"Of `palpate serve`; the running server describes itself at "
        f"`{app.openapi_url}`. How to come in, and how touches are sent: "
        "[the live page](../live.md#for-robots-the-api)."
    )
    parts = [
        "# The HTTP API",
        about,
        "Every address may refuse with one of these; the `detail` says what to do:",
        _answers(calls[0][2], shared),
    ]
    for path, verb, call in calls:
        parts += [f"## {verb.upper()} {path}", *_call(call, described, shared)]
    return "\n\n".join(parts) + "\n"


def _answers(about: dict[str, Any], codes: set[str]) -> str:
    rows = [
        f"| {code} | {_escaped(one.get('description', ''))} | "
        f"{', '.join(one.get('content', {})) or '-'} |"
        for code, one in about["responses"].items()
        if code in codes
    ]
    return "| answer | what | as |\n|---|---|---|\n" + "\n".join(rows)


def _call(
    about: dict[str, Any], described: dict[str, Any], shared: set[str]
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
        takes += [(n, kind, one, n in musts) for n, one in inside.items()]
    if takes:
        rows = [
            f"| `{n}` | {where} | {_kind(s, described)} | {'yes' if must else ''} | "
            f"{_escaped(s.get('description', '')).replace('|', chr(92) + '|')} |"
            for n, where, s, must in takes
        ]
        head = "| takes | in | type | must | what |\n|---|---|---|---|---|\n"
        parts.append(head + "\n".join(rows))
    parts.append(_answers(about, {*about["responses"]} - shared))
    return parts


def _resolved(schema: dict[str, Any], described: dict[str, Any]) -> dict[str, Any]:
    name = schema.get("$ref", "").rpartition("/")[2]
    return described["components"]["schemas"][name] if name else schema


def _kind(schema: dict[str, Any], described: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_kind(one, described) for one in schema["anyOf"])
    if "$ref" in schema:
        return schema["$ref"].rpartition("/")[2]
    return str(schema.get("type", "any"))


if __name__ == "__main__":
    PAGE.write_text(reference())
    print(PAGE)
