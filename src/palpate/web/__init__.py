"""A sensor on the desk: the live loop, and the page and API that show it.

`LiveSession` is the loop and needs none of the extras; `create_app` wraps it in a
FastAPI application (the extra `web`).
"""

from ._learning import LearningError as LearningError
from ._learning import learn_job as learn_job
from ._learning import remember_library as remember_library
from ._ros import RosPublisher as RosPublisher
from ._sensor_watch import Event as Event
from ._serving import PageServer as PageServer
from ._serving import create_app
from ._serving import page_token as page_token
from ._session import LiveSession
from ._teaching import MOST_PER_LESSON as MOST_PER_LESSON

__all__ = ["LiveSession", "create_app"]
