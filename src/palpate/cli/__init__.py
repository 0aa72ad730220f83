"""The command `palpate`: one verb per file, each a thin layer over the library.

What goes wrong becomes one sentence and exit code 1. Nothing heavy is imported here:
each verb imports what it needs when it runs, so that `palpate --help` answers at once.
"""

import errno
import io
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from inspect import cleandoc
from typing import Annotated, Any, NoReturn

import typer

from .. import __version__
from . import _options, _output

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Recognise things by touch: learn objects from touches, recognise them "
    "touch by touch, and say when something is unknown.",
    epilog="To begin: `palpate demo`. With touches of your own: `palpate check`, then "
    "`palpate learn`. `palpate COMMAND -h` says what each takes.",
)
# Each is the function, or the group of several, of that name in the file of that name.
VERBS = (
    *("check", "learn", "recognise", "evaluate", "benchmark", "demo", "study", "bench"),
    *("remount", "doctor", "serve", "record", "live", "simulate", "library", "data"),
    *("explore", "sensor"),
)
for name in VERBS:
    verb = getattr(import_module(f".{name}", __package__), name)
    if isinstance(verb, typer.Typer):
        app.add_typer(verb, name=name)
    else:
        app.command()(verb)
_output.translate_for(app)


def _join_lines(group: typer.Typer) -> None:
    """Let a terminal of any width break the lines of what is said of verbs."""
    for verb in group.registered_commands:
        if verb.callback is not None and verb.callback.__doc__:
            parts = cleandoc(verb.callback.__doc__).split("\n\n")
            verb.callback.__doc__ = "\n\n".join(" ".join(p.split()) for p in parts)
    for inner in group.registered_groups:
        if inner.typer_instance is not None:
            _join_lines(inner.typer_instance)


_join_lines(app)

_Usage: Any = typer.BadParameter.__base__  # every wrong use of the command line
# What a verb may fail with; anything else is a fault of palpate and shows where.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES)
_STOPPED, _BY_CTRL_C = 130, "Stopped by Ctrl-C: no file is half written."
FAILURES = (ValueError, TypeError, OSError, RuntimeError, ImportError, MemoryError)


def _print_version(wanted: bool) -> None:
    if wanted:
        _output.say(f"palpate {__version__}")
        raise typer.Exit


_version = _options.flag(
    "--version", "Print the version.", callback=_print_version, is_eager=True
)


@app.callback()
def _root(version: Annotated[bool, _version] = False) -> None:
    """Take the verbs as they are."""


def main() -> None:
    """Run the command line; exit 1 for a failure, 2 for wrong usage, 130 for Ctrl-C.

    With --json what went wrong is printed as `{"error": ...}` too. PALPATE_DEBUG=1 in
    the environment shows the whole traceback of a failure.
    """
    as_json = "--json" in sys.argv
    if isinstance(sys.stdout, io.TextIOWrapper):  # as standard error does by itself
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with _plain_warnings():
            code = app(prog_name="palpate", standalone_mode=False)
        if code != _STOPPED:
            sys.exit(code)
        _end_stopped(_BY_CTRL_C)
    except _output.Stopped as stopped:
        _end_stopped(str(stopped))
    except typer.Abort as abort:
        if isinstance(abort.__cause__, KeyboardInterrupt):  # of older packages
            _end_stopped(_BY_CTRL_C)
        message, code = "Ended without an answer.", 1
    except FAILURES as error:
        if os.environ.get("PALPATE_DEBUG"):
            raise
        wrong_use = isinstance(error, _output.WrongUse)
        message, code = _output.as_typed(_sentence(error)), 1 + wrong_use
    except _Usage as error:
        error.message = _output.as_typed(_no_number(error) or error.message)
        if not as_json:
            _output.say(_shown(error), file=sys.stderr)
            sys.exit(error.exit_code)
        message, code = error.format_message(), error.exit_code
    _output.answer(as_json, {"error": message})
    _output.say(f"palpate: {message}", file=sys.stderr)
    sys.exit(code)


def _no_number(error: Any) -> str:
    """Return what an option that must be a number got, and one; "" of other uses.

    A flag must be true or false, which a file of options may say otherwise.
    """
    match = re.search("valid (number|float|integer|boolean)", error.message)
    if match is None:
        return ""
    # What was typed stands in the cause; of older packages it begins the message.
    problems: list[Any] = getattr(error.__cause__, "errors", list)()
    typed = error.message.partition(" is not")[0]
    got = repr(problems[0]["input"]) if problems else typed
    default = error.param.default
    number = default if isinstance(default, int | float) else 1
    kinds = {"integer": f"a whole number such as {number}", "boolean": "true or false"}
    kind = kinds.get(match[1], f"a number such as {number}")
    return f"{max(error.param.opts, key=len)} must be {kind}, got {got}."


def _end_stopped(message: str) -> NoReturn:
    _output.say(f"palpate: {message}", file=sys.stderr)
    sys.exit(_STOPPED)


def _shown(error: Any) -> str:
    """Return what typer shows of a wrong use: how to use it, and what was wrong."""
    text = io.StringIO()
    error.show(file=text)
    return text.getvalue().rstrip("\n")


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings with what a terminal would obey, in names of files, written out.

    Those meant for users without the line of code that they come from.
    """
    usual = warnings.formatwarning

    def plain(message: Any, category: Any, *rest: Any, **more: Any) -> str:
        text = _output.printable(_output.as_typed(str(message)))
        if category is UserWarning:
            return f"palpate: {text}\n"
        return usual(text, category, *rest, **more)

    warnings.formatwarning = plain
    try:
        yield
    finally:
        warnings.formatwarning = usual


def _sentence(error: BaseException) -> str:
    """Return what went wrong; what the disk says, as a sentence with the fix."""
    if not isinstance(error, OSError) or error.errno not in _NO_ROOM:
        return str(error)
    return (
        f"{error.filename or 'The disk'} must be a place with room that may be written "
        f"to, got: {error.strerror}. Free space, or give another place."
    )


__all__ = ["main"]
