"""A sensor on the desk: the live loop, and the page and API that show it.

`LiveSession` is the loop and needs none of the extras; `create_app` wraps it in a
FastAPI application (the extra `web`).
"""

from ._learning import remember_library as remember_library
from ._serving import PageServer as PageServer
from ._serving import create_app
from ._session import LiveSession

__all__ = ["LiveSession", "create_app"]
