"""What is being done now, on standard error, where a person is looking."""

import sys
from types import TracebackType
from typing import Any, Self


class Stages:
    """Show the present stage of long work with a running clock.

    Called with the name of each stage. Draws nothing where standard error is no
    terminal, so that logs stay readable.
    """

    def __init__(self) -> None:
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __call__(self, stage: str) -> None:
        if not sys.stderr.isatty():
            return
        if self._bar is None:
            self._bar = _clock()
            self._bar.start()
            self._bar.add_task(stage, total=None)
        self._bar.update(self._bar.task_ids[0], description=stage)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def _clock() -> Any:
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
