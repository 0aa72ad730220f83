"""Packages of the extra `sim`, imported when first used."""

from importlib import import_module
from types import ModuleType


def needed(name: str) -> ModuleType:
    """Import a package of the extra `sim`, or say what to install.

    Raises
    ------
    ImportError
        It is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(
            f"Simulating touches on 3-D objects needs {name.partition('.')[0]}, which "
            "is not installed. Install it with: pip install palpate[sim]"
        ) from error
