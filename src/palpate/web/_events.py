"""What a live session tells those who listen, from whatever thread it happens in."""

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Any


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happened: a kind, plain values, and the bytes of a picture.

    Kinds: "frame", "contact", "touch", "state".
    """

    kind: str
    values: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""


Listener = Callable[[Event], None]


class Listeners:
    """Those who want to know; one that fails is left out from then on."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._listeners: list[Listener] = []

    def __len__(self) -> int:
        return len(self._listeners)

    def add(self, listener: Listener) -> None:
        """Tell this one too."""
        with self._lock:
            self._listeners.append(listener)

    def remove(self, listener: Listener) -> None:
        """Tell this one no more."""
        with self._lock:
            if listener in self._listeners:
                self._listeners.remove(listener)

    def tell(self, event: Event) -> None:
        """Tell all; called from the thread in which it happened."""
        for listener in tuple(self._listeners):
            try:
                listener(event)
            except Exception:  # one broken listener must not stop the sensor
                self.remove(listener)
