"""What the verbs print: JSON for machines, tables and bars for people.

Text is printed as it is: square brackets, as in `palpate[plot]`, are no markup.
"""

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Any, Literal, TextIO

BAR_WIDTH = 24
SHOWN = 3


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; numbers that are not finite become null."""
    print(json.dumps(_plain(value), allow_nan=False))


def answer(as_json: bool, values: dict[str, Any], *lines: object) -> None:
    """Print values as one JSON object, or lines for people."""
    if as_json:
        print_json(values)
        return
    for line in lines:
        say(line)


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


def belief_line(touch: int, posterior: dict[str, float], unknown: float) -> str:
    """Return one line that shows a belief: a bar for the best, figures for the next.

    Of the probabilities of the learnt objects and of none of them.
    """
    shares = {**posterior, "unknown": unknown}
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    name, share = ranked[0]
    bar = ("█" * round(share * BAR_WIDTH)).ljust(BAR_WIDTH, "·")
    others = "  ".join(f"{n} {p:.2f}" for n, p in ranked[1:SHOWN])
    return f"  touch {touch:3d}  {bar} {share:4.2f} {name}   {others}"


def table(
    title: str,
    columns: list[str],
    rows: list[list[str]],
    whole: Collection[str] = (),
    *,
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
    Console(markup=False, emoji=False).print(drawn)


def counted(number: int, what: str = "touch", many: str = "") -> str:
    """Return "1 problem", "2 problems"; `many` where an s does not make it many."""
    more = many or ("touches" if what == "touch" else f"{what}s")
    return f"{number} {what if number == 1 else more}"


def percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


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


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
