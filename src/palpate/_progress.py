"""A progress bar on standard error for work of more than two seconds."""

import sys
import time
from typing import Any, Self

_PATIENCE_S = 2.0  # what ends sooner needs no bar


class Progress:
    """Count work; draw a bar once it takes long.

    `show` is whether to draw at all; None means where standard error is a terminal.
    """

    def __init__(self, total: int, what: str, show: bool | None) -> None:
        self._total, self._what = total, what
        self._show = sys.stderr.isatty() if show is None else show
        self._start = time.monotonic()
        self._done = 0
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, n_done: int) -> None:
        """Count `n_done` more pieces."""
        self.reach(self._done + n_done)

    def reach(self, n_done: int) -> None:
        """Count `n_done` pieces in all."""
        self._done = n_done
        late = time.monotonic() - self._start > _PATIENCE_S
        if self._bar is None and self._show and late and self._done < self._total:
            from rich.console import Console
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(console=Console(stderr=True))
            self._bar.add_task(self._what, total=self._total)
            self._bar.start()
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._done)
