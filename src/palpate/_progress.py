"""A progress bar on standard error for work of more than two seconds."""

import sys
import time
from types import TracebackType
from typing import Any, Self

_PATIENCE_S = 2.0


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, n_done: int) -> None:
        """Count `n_done` more pieces."""
        self._done += n_done
        late = time.monotonic() - self._start > _PATIENCE_S
        if self._bar is None and self._show and late and self._done < self._total:
            self._bar = _started_bar(self._what, self._total)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._done)


def _started_bar(what: str, total: int) -> Any:
    from rich.console import Console
    from rich.progress import Progress as RichProgress

    bar = RichProgress(console=Console(stderr=True))
    bar.add_task(what, total=total)
    bar.start()
    return bar
