"""The command `palpate`: one verb per file, each a thin layer over the library."""

from ._app import app as app
from ._app import main

__all__ = ["main"]
