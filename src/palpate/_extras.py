"""Optional packages: imported where they are used, refused by the extra's name."""

from importlib import import_module
from typing import Any


def needed(module: str, extra: str, what: str) -> Any:
    """Import a `module` of an optional package, or say how to install it.

    `extra` is the one of palpate that brings it, `what` who needs it, as the subject of
    a sentence in the singular: "A report".
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(missing(module.partition(".")[0], extra, what)) from error


def missing(package: str, extra: str, what: str) -> str:
    """Return the sentence that says how to install a missing package."""
    return f"{what} needs {package}, which is not installed: {install(extra)}"


def install(extra: str) -> str:
    """Return the command that installs an extra, quoted so that every shell takes it.

    palpate itself is there already, however it was installed, so pip adds to it.
    """
    return f'pip install "palpate[{extra}]"'
