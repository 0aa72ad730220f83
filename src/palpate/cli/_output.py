"""What the verbs print: JSON, tables, bars, and messages in words of the command.

Text is printed as it is: square brackets, as in `palpate[plot]`, are no markup.

A message of another subpackage names arguments and functions: as the first word before
"must", or between backticks (`where`, `shape=16x16`, `check_library`). `as_typed` turns
them into options and verbs of what was typed; what it does not know stays as it is.
"""

import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, TextIO

import typer

# What to type for what to call; arguments follow as they are.
_VERBS = {
    "TouchLibrary.add": "palpate library add",
    "TouchLibrary.export": "palpate library export",
    "TouchLibrary.list": "palpate library list",
    "TouchLibrary.migrate": "palpate library migrate",
    "check_library": "palpate library check",
    "TouchLibrary.repair_folder": "palpate library check --repair",
    "repair_library": "palpate library check --repair",
    "fetch": "palpate data fetch",
    "ObjectRecogniser.save": "palpate learn",
    "ObjectRecogniser.fit_pose": "palpate learn --pitch-mm MM",
}
_QUOTED = re.compile(r"`([\w.]+)(?:=([^`\s]+)|\(([^`]*)\))?`")
# Numbers of touches are an option, touches themselves are none.
_NO_NUMBER = r"touches must (?!be at |hold (?:a )?number)"
_FIRST_WORD = re.compile(rf"(?:^|(?<=[.;] ))(?!{_NO_NUMBER})(\w+)(?= must )")
_NO = ("no", "False", "0")
_UNITS = ("mm", "n", "s", "deg")  # an option leaves the unit of an argument out
_ROOT: list[typer.Typer] = []  # the command, once it is put together

BAR_WIDTH = 24
OBJECTS_SHOWN = 3
_PIPE_WIDTH = 10_000


def answer(as_json: bool, values: dict[str, Any], *parts: object) -> None:
    """Print values as one JSON object, or for people lines, and tables as tuples.

    These are what `table` takes; a part that is None is left out. In JSON numbers that
    are not finite become null.
    """
    if as_json:
        print(json.dumps(_plain(values), allow_nan=False), flush=True)
        return
    for part in parts:
        if isinstance(part, tuple):
            table(*part)
        elif part is not None:
            say(part)


def say(line: object = "", *, file: TextIO | None = None, flush: bool = False) -> None:
    """Print a line in which names of files and objects can do a terminal no harm.

    On a terminal a sentence that is longer than its lines breaks between words.
    """
    text = printable(str(line))
    out = sys.stdout if file is None else file
    if out.isatty() and not text.startswith(" "):
        width = shutil.get_terminal_size().columns
        text = "\n".join(_broken(part, width) for part in text.split("\n"))
    print(text, file=file, flush=flush)


def _broken(line: str, width: int) -> str:
    hang = "  " * line.startswith("- ")
    return textwrap.fill(
        line,
        width,
        subsequent_indent=hang,
        break_long_words=False,
        break_on_hyphens=False,
    )


def printable(text: str) -> str:
    """Return text in which what a terminal would obey is written out."""
    kept = (c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)
    return "".join(kept)


def belief_line(
    touch: int, posterior: dict[str, float], unknown: float, note: str = ""
) -> str:
    """Return one line that shows a belief: a bar for the best, figures for the next.

    `posterior` holds the probability of each learnt object, `unknown` that it is none
    of them, which is ranked among them. Where there is a `note` on the touch, that.
    """
    if note:
        return f"  {note}"
    shares = {**posterior, "unknown": unknown}
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    name, share = ranked[0]
    mark, rest = "█·" if "utf" in (sys.stdout.encoding or "").lower() else "#."
    bar = (mark * round(share * BAR_WIDTH)).ljust(BAR_WIDTH, rest)
    others = "  ".join(f"{n} {_rounded_down(p)}" for n, p in ranked[1:OBJECTS_SHOWN])
    return f"  touch {touch:3d}  {bar} {_rounded_down(share)} {name}   {others}"


def _rounded_down(share: float) -> str:
    """Return a share of 1 as sentences round it, so that both say the same."""
    return f"{math.floor(100 * share + 1e-9) / 100:4.2f}"


def table(
    title: str,
    columns: list[str],
    rows: list[list[str]],
    whole: Collection[str] = (),
    text: bool = False,
) -> None:
    """Print a table on standard output; the columns `whole` are not wrapped.

    All but the first column are figures, flush right, unless they are `text`.
    """
    from rich.console import Console
    from rich.table import Table

    drawn = Table(title=printable(title), title_justify="left")
    for number, column in enumerate(columns):
        side: Literal["left", "right"] = "left" if text or number == 0 else "right"
        kept = column in whole
        drawn.add_column(column, justify=side, no_wrap=kept, overflow="fold")
    for row in rows:
        drawn.add_row(*map(printable, row))
    # In a pipe a line is as long as it is: folded, figures break amid their digits.
    is_sized = sys.stdout.isatty() or "COLUMNS" in os.environ
    width = None if is_sized or text else _PIPE_WIDTH
    Console(markup=False, emoji=False, width=width).print(drawn)


def counted(number: int, what: str = "touch", many: str = "") -> str:
    """Return "1 problem", "2 problems"; `many` where an s does not make it many."""
    more = many or ("touches" if what == "touch" else f"{what}s")
    return f"{number} {what if number == 1 else more}"


@contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """Show the present stage of long work with a running clock, on standard error.

    Yields what is to be called with the name of each stage. Draws nothing where
    standard error is no terminal, so that logs stay readable.
    """
    if not sys.stderr.isatty():
        yield lambda stage: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    text = TextColumn("{task.description}", markup=False)
    columns = SpinnerColumn(), text, TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda stage: bar.update(task, description=printable(stage))


class WrongUse(ValueError):
    """A command that cannot be meant, whatever is on the disk; exit code 2."""


class Stopped(Exception):
    """Ctrl-C ended a verb; the message says what was kept."""


@contextmanager
def message_if_stopped(kept: str) -> Iterator[None]:
    """Turn Ctrl-C into a sentence that says what was `kept` and what was not."""
    try:
        yield
    except KeyboardInterrupt:
        raise Stopped(f"Stopped by Ctrl-C: {kept}") from None


def unless_made(what: str, written: Path | None) -> str:
    """Return a sentence on what is not made, and on what was there before it."""
    as_before = written is not None and written.exists()
    return f"{what}, and {written} is as it was." if as_before else f"{what}."


def translate_for(app: typer.Typer) -> None:
    """Take the command whose verbs and options messages are to name."""
    _ROOT[:] = [app]


def as_typed(text: str, *words: str) -> str:
    """Return a message in words of the verb that was typed, or of that in `words`."""
    if not (_QUOTED.search(text) or _FIRST_WORD.search(text)):
        return text
    options = _options_of(words or tuple(sys.argv[1:]))
    text = _QUOTED.sub(partial(_as_quoted, options), text)
    return _FIRST_WORD.sub(lambda word: options.get(word[1], (word[1],))[0], text)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _as_quoted(options: dict[str, tuple[str, str]], word: re.Match[str]) -> str:
    name, value, arguments = word.groups()
    if name in _VERBS:
        words = re.sub(r",\s*", " ", arguments or "")
        return f"`{_VERBS[name]} {words}".rstrip() + "`"
    if name not in options or arguments is not None:
        return word[0]
    option, negative = options[name]
    if negative and value is not None:
        return negative if value in _NO else option
    return option if value is None else f"{option} {value}"


@cache
def _options_of(words: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Return options of the verb in `words`, and their negatives, by argument."""
    command: Any = typer.main.get_command(*_ROOT)
    for word in words:
        command = getattr(command, "commands", {}).get(word, command)
    options: dict[str, tuple[str, str]] = {}
    for parameter in command.params:
        if parameter.param_type_name == "option":
            option = max(parameter.opts, key=len)
            pair = option, max(parameter.secondary_opts, key=len, default="")
            stem = option.lstrip("-").replace("-", "_")
            names = [stem, str(parameter.name), *(f"{stem}_{unit}" for unit in _UNITS)]
            names += [stem.replace("mega", "")]
            names += [parameter.envvar] if isinstance(parameter.envvar, str) else []
            options |= dict.fromkeys(names, pair)
    return options
