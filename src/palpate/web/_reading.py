"""Threads that read images that come in, apart from all else the server does.

What is slow to read holds up others of its kind alone: teaching, websockets and the
page's own pictures have other threads.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from fastapi import HTTPException

_Given = ParamSpec("_Given")
_Read = TypeVar("_Read")


class ReadingRoom:
    """A few threads that read images, each in bounded time, waiting included.

    A thread cannot be stopped: it goes on until what it reads ends, which the limits
    on size and scans bound, and its result is dropped.
    """

    def __init__(self, name: str, n_threads: int, limit_s: float) -> None:
        self._limit_s = limit_s
        self._pool = ThreadPoolExecutor(n_threads, f"palpate-{name}")

    async def read(
        self,
        read: Callable[_Given, _Read],
        *args: _Given.args,
        **how: _Given.kwargs,
    ) -> _Read:
        """Return what `read` returns; answer 503 where that takes too long."""
        reading = asyncio.wrap_future(self._pool.submit(read, *args, **how))
        try:
            return await asyncio.wait_for(reading, self._limit_s)
        except TimeoutError:
            raise HTTPException(
                503,
                f"The image took more than {self._limit_s:g} s to read, or to wait for "
                "others. Send it again, or a smaller one.",
                {"Retry-After": "1"},
            ) from None


PICTURES = ReadingRoom("pictures", 4, 10.0)
NUMBERS = ReadingRoom("numbers", 2, 30.0)
