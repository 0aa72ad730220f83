"""A sensor on the desk: the live loop, and the page and API that show it.

`LiveSession` is the loop and needs none of the extras; `create_app` wraps it in a
FastAPI application (the extra `web`).
"""

from ._learning import LearningError as LearningError
from ._learning import learn_job as learn_job
from ._learning import remember_library as remember_library
from ._lesson import Variety as Variety
from ._quality import advice as advice
from ._quality import object_quality as object_quality
from ._ros import RosPublisher as RosPublisher
from ._sensor_watch import Event as Event
from ._serving import address_of as address_of
from ._serving import checked_token as checked_token
from ._serving import create_app
from ._serving import kept_token as kept_token
from ._serving import new_token as new_token
from ._serving import open_socket as open_socket
from ._serving import qr_code as qr_code
from ._serving import require_web as require_web
from ._serving import run_app as run_app
from ._serving import served_at as served_at
from ._serving import server_of as server_of
from ._serving import serving_at as serving_at
from ._session import LiveSession
from ._session import start_all as start_all

__all__ = ["LiveSession", "create_app"]
