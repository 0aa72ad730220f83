"""What was done with the touches of a library on the page, kept to be undone later.

A text file of one JSON object a line in the library's folder. A line is written after
the library has done what it says; one that is lost, or torn by a power cut, costs
that undo and nothing else, so nothing waits for the disk.
"""

import json
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MOST_ACTIONS = 1000
_SITTING_S = 3600.0  # a sitting ends where the page was not used for longer
_LONGEST_BYTES = 2**22  # of the file's end that is read


@dataclass(frozen=True)
class Action:
    """Touches "taught", "removed" or "moved" from `object`, as `copies`, `to` one."""

    kind: str
    object: str
    ids: list[str]
    copies: list[str] = field(default_factory=list)
    to: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return what the page shows of it."""
        return {"kind": self.kind, "object": self.object, "to": self.to}


@dataclass
class Interrupted:
    """A lesson under way: what is taught, how often, the touches stored so far."""

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)


class Journal:
    """Actions that can be undone, the newest last, and the lesson under way.

    `interrupted` is the lesson that was under way when the file was written last, until
    one begins or it is ended. `changed` are the objects whose touches are others than
    when the model learnt last. `session` is that of the touches stored last, with the
    name of their sensor.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.actions: list[Action] = []
        self.changed: set[str] = set()
        self.session: tuple[str, str] | None = None
        self.n_lessons = 0
        self._lesson: Interrupted | None = None
        for line in self._lines():
            with suppress(ValueError, TypeError, KeyError, AttributeError):
                self._take(json.loads(line))
        self.interrupted: Interrupted | None = self._lesson

    @property
    def last(self) -> Action | None:
        """The newest action that can be undone."""
        return self.actions[-1] if self.actions else None

    def add(self, action: Action) -> None:
        """Keep an action."""
        self._write({"action": dict(vars(action))})

    def pop(self) -> None:
        """Forget the newest action: it is undone."""
        self._write({"undone": True})

    def store_in(self, session: str, sensor: str) -> None:
        """Note which session touches are stored in from now on."""
        if self.session != (session, sensor):
            self._write({"session": [session, sensor]})

    def goes_on(self, sensor: str) -> str | None:
        """Return the session of this sitting, which a restart does not end."""
        try:
            rested_s = time.time() - self.path.stat().st_mtime
        except OSError:
            return None
        if self.session is None or self.session[1] != sensor or rested_s > _SITTING_S:
            return None
        return self.session[0]

    def learnt(self) -> None:
        """Note which objects are still others than what was learnt."""
        self._write({"changed": sorted(self.changed)})

    def begin_lesson(self, name: str, wanted: int, ids: Sequence[str] = ()) -> None:
        """Note that a lesson begins, with the touches that it has already."""
        self._write({"lesson": {"name": name, "wanted": wanted, "ids": [*ids]}})
        self.interrupted = None

    def end_lesson(self) -> None:
        """Note that there is no lesson any more."""
        if self._lesson is not None or self.interrupted is not None:
            self._write({"lesson": None})
        self.interrupted = None

    def _take(self, line: dict[str, Any]) -> None:
        if "action" in line:
            action = Action(**line["action"])
            self.actions = [*self.actions[1 - MOST_ACTIONS :], action]
            self._change(action)
            if self._lesson is not None and action.kind == "taught":
                self._lesson.ids += action.ids
            else:
                self._drop(action)
        elif "undone" in line and self.actions:
            undone = self.actions.pop()
            self._change(undone)
            self._drop(undone)
        elif "changed" in line:
            self.changed = {str(name) for name in line["changed"]}
        elif "session" in line:
            session, sensor = line["session"]
            self.session = str(session), str(sensor)
        elif "lesson" in line:
            lesson = line["lesson"]
            self.n_lessons += lesson is not None
            self._lesson = None if lesson is None else Interrupted(**lesson)

    def _change(self, action: Action) -> None:
        self.changed |= {action.object, action.to} - {""}

    def _drop(self, action: Action) -> None:
        if self._lesson is not None:
            gone = set(action.ids)
            self._lesson.ids = [key for key in self._lesson.ids if key not in gone]

    def _lines(self) -> list[str]:
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - _LONGEST_BYTES))
                return file.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return []

    def _write(self, line: dict[str, Any]) -> None:
        self._take(line)
        # The touch is stored already: a disk without room only costs the undo.
        with suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
