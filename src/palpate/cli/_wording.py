"""Words of the command line for those of the library, in messages.

A message of a lower room names arguments and functions: as the first word before
"must", or between backticks (`where`, `shape=16x16`, `check_library`). The verb that
was typed turns them into its options, and functions into verbs; what it does not know
stays as it is.
"""

import re
import sys
from functools import cache, partial
from typing import Any

import typer

# What to type for what to call; arguments follow as they are.
_VERBS = {
    "TouchLibrary.add": "palpate library add",
    "TouchLibrary.export": "palpate library export",
    "TouchLibrary.list": "palpate library list",
    "check_library": "palpate library check",
    "repair_library": "palpate library check --repair",
    "migrate_library": "palpate library migrate",
    "fetch": "palpate data fetch",
    "ObjectRecogniser.save": "palpate learn",
    "ObjectRecogniser.fit_pose": "palpate learn --pitch-mm MM",
}
_QUOTED = re.compile(r"`([\w.]+)(?:=([^`\s]+)|\(([^`]*)\))?`")
_FIRST_WORD = re.compile(r"(?:^|(?<=[.;:] ))(\w+)(?= must )")
_NO = ("no", "False", "0")
_UNITS = ("mm", "n", "s", "deg")  # an option leaves the unit of an argument out
_ROOT: list[typer.Typer] = []  # the command, once it is put together


def translate_for(app: typer.Typer) -> None:
    """Take the command whose verbs and options messages are to name."""
    _ROOT[:] = [app]


def as_typed(text: str) -> str:
    """Return a message in words of the verb that was typed."""
    if not (_QUOTED.search(text) or _FIRST_WORD.search(text)):
        return text
    options = _options_of(tuple(sys.argv[1:]))
    text = _QUOTED.sub(partial(_as_quoted, options), text)
    return _FIRST_WORD.sub(lambda word: options.get(word[1], (word[1],))[0], text)


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
            names += [parameter.envvar] if isinstance(parameter.envvar, str) else []
            options |= dict.fromkeys(names, pair)
    return options
