"""Optional packages, named by the extra that brings them."""

from importlib import import_module
from typing import Any


def needed(module: str, extra: str, what: str) -> Any:
    """Import an optional package, or say how to install it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{what} needs the package {module.split('.')[0]!r}, which is not "
            f"installed: pip install palpate[{extra}]"
        ) from error
