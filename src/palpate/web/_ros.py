"""A live session on topics and services of ROS 2: beliefs out, commands in.

Under a prefix such as `/palpate`:

- `belief`, `vision_msgs/msg/Classification`: after each touch its header and names with
  probabilities, the most probable first; "unknown" is none of the learnt objects.
- `decision`, `std_msgs/msg/String`: a name, "unknown", or nothing while undecided.
- `command` (in) and `answer`, `std_msgs/msg/String`: `start`, `object NAME`, `teach
  [NAME]`, `stop`, `confirm [NAME]`, `learn`, `session`; "done: ..." or "refused: ...".
  With a number before it, as in `#7 start`, a command gets an answer with that number.
- Services `start`, `stop`, `confirm`, `learn`, `session` (`std_srvs/srv/Trigger`) and
  `teach` (`std_srvs/srv/SetBool`; true is `teach`, false `stop`).
"""

import re
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from ..sensors import ros_place
from ..sensors.ros import (
    CLASSIFICATION,
    SET_BOOL,
    STRING,
    TRIGGER,
    Header,
    classification,
    text_message,
)
from ..sensors.ros import read_message as read
from ..sensors.ros import write_message as write
from ._sensor_watch import Event
from ._teaching import teachable_name

if TYPE_CHECKING:
    from ._session import LiveSession

_TICK_S = 0.02
_LONGEST = 200  # characters of a command
_COMMANDS = ("start", "object", "teach", "stop", "confirm", "learn", "session")
_SERVICES = {name: TRIGGER for name in _COMMANDS if name != "object"}
_SERVICES["teach"] = SET_BOOL
_NAMING = ("object", "teach", "confirm")  # these may be followed by a name
_NUMBERED = re.compile(r"(#\d+) +(.*)", re.DOTALL)


class RosPublisher:
    """Publishes what a session believes, and does what is asked over the same wire.

    Made by `LiveSession.publish`.
    """

    def __init__(self, session: "LiveSession", address: str) -> None:
        place = ros_place(address)
        self.prefix = place.prefix
        self._session, self._object = session, ""
        self._warned = self._failed = False
        self._learning, self._in_use = False, threading.Lock()
        self._node = node = place.open_node()
        at = self.prefix.rstrip("/")
        self._belief = node.publish(f"{at}/belief", CLASSIFICATION)
        self._decision = node.publish(f"{at}/decision", STRING)
        self._answer = node.publish(f"{at}/answer", STRING)
        self._commands = node.subscribe(f"{at}/command", STRING, reliable=True)
        self._services = [
            node.serve(f"{at}/{name}", kind, partial(self._requested, name))
            for name, kind in (_SERVICES if place.services else {}).items()
        ]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        session.listeners.add(self.take, frames=False)
        self._thread.start()

    def close(self) -> None:
        """Leave the network."""
        self._session.listeners.discard(self.take)
        self._stop.set()
        self._thread.join(timeout=5.0)
        with self._in_use:  # by a touch that is published now
            # DDS ends what nobody holds any more.
            del self._belief, self._decision, self._answer
            del self._commands, self._services
            self._node.close()

    def take(self, event: Event) -> None:
        """Publish what a "touch" of the session tells, and how learning ended.

        What cannot be written is told once; the next touch is tried again.
        """
        with self._in_use:
            if self._stop.is_set():
                return
            try:
                if event.kind == "state":
                    self._follow_learning(event.values)
                if event.kind == "touch":
                    self._publish(event)
            except Exception as error:  # of the network: any kind
                if not self._failed:
                    print(
                        f"A touch was not published to {self.prefix}: {error!r}.",
                        file=sys.stderr,
                    )
                self._failed = True

    def _publish(self, event: Event) -> None:
        episode = event.values["episode"]
        (touch,) = episode["touches"]
        shares = dict(touch["posterior"])
        if touch["unknown"] is not None:
            shares["unknown"] = touch["unknown"]
        ordered = dict(sorted(shares.items(), key=lambda item: -item[1]))
        message = classification(self._header(touch), ordered)
        self._belief.write_bytes(write(message, CLASSIFICATION))
        decision = episode["decision"] or ""
        self._decision.write_bytes(write(text_message(decision), STRING))

    def ask(self, command: str) -> tuple[bool, str]:
        """Do what a command says; return whether it was done, and a sentence."""
        try:
            return True, self._do(*command[:_LONGEST].split(maxsplit=1))
        except (ValueError, OSError, RuntimeError, TypeError) as error:
            return False, str(error)
        except Exception as error:  # of a part of its own: commands after it are heard
            return False, repr(error)

    def _do(self, command: str = "", name: str = "") -> str:
        session = self._session
        if command not in _COMMANDS:
            raise ValueError(
                f"command must be one of {', '.join(_COMMANDS)}, got {command!r}."
            )
        if name and command not in _NAMING:
            raise ValueError(f"{command} must stand alone, got {name!r} after it.")
        if command == "object":
            self._object = teachable_name(name) if name else ""
            name = self._object
            return f"teach and confirm mean {name or 'what is decided'} now."
        if command == "start":
            session.begin_episode()
            return "The next touch begins an episode."
        if command == "teach":
            name = self._named(name)
            session.teach(name, session.most_per_lesson)
            return f"Touches teach {name}."
        if command == "stop":
            session.stop_teaching()
            return "Touches are recognised."
        if command == "confirm":
            return self._confirm(name)
        if command == "learn":
            session.learn()
            return "It is learning; another answer says when it has."
        session.take_baseline()
        session.begin_episode()
        return "The baseline is taken; a session begins."

    def _confirm(self, name: str) -> str:
        episode = self._session.episode
        name = name or self._object or episode.decision or ""
        if name == "unknown":
            name = ""
        n_touches = min(len(list(episode.pictured())), self._session.most_per_lesson)
        if not n_touches:
            raise ValueError("confirm must come after touches, got none.")
        name = self._named(name)
        teacher = self._session.teacher
        n_before = 0 if teacher is None else teacher.library.count()
        self._session.teach(name, n_touches, keep_episode=True)
        assert teacher is not None  # else that is refused
        why = self._session.message
        n_touches = teacher.library.count() - n_before
        if (lesson := teacher.lesson) is not None:
            n_touches = lesson.done  # the others show no contact
            self._session.stop_teaching()
        if not n_touches:
            raise ValueError(f"No touch is kept as {name}. {why}")
        return f"{n_touches} touches are kept as {name}; learn to use them."

    def _named(self, name: str) -> str:
        if name := name or self._object:
            return name
        raise ValueError(
            "An object must be named, got none. Publish 'object NAME' to "
            f"{self.prefix.rstrip('/')}/command first."
        )

    def _requested(self, command: str, request: Any) -> tuple[bool, str]:
        """Do what a request to a service says; "teach" with false means "stop"."""
        stops = command == "teach" and not request.data
        return self.ask("stop" if stops else command)

    def _header(self, touch: dict[str, Any]) -> Header:
        """Return the header of the message that a touch was seen in, or of now."""
        watch = self._session.watch
        sensor = None if watch is None else watch.sensor
        device_time_s = touch["device_time_s"]
        if sensor is not None and device_time_s is not None:
            header = sensor.header_at(device_time_s)
            if header is not None:
                return header
        seconds, rest = divmod(time.time_ns(), 10**9)
        return Header(seconds, rest, "" if sensor is None else sensor.name)

    def _listen(self) -> None:
        while not self._stop.is_set():
            for raw in self._commands.take(_TICK_S):
                try:
                    text = str(read(raw, STRING).data)
                except Exception:  # rosbags raises many kinds on damaged bytes
                    continue
                numbered = _NUMBERED.fullmatch(text)
                number, command = numbered.groups() if numbered else ("", text)
                self._say(*self.ask(command), number)
            for service in self._services:
                service.poll()
            self._warn()

    def _say(self, done: bool, sentence: str, number: str = "") -> None:
        answer = f"{number} {'done' if done else 'refused'}: {sentence}".lstrip()
        self._answer.write_bytes(write(text_message(answer), STRING))

    def _follow_learning(self, state: dict[str, Any]) -> None:
        """Answer a second time once it has learnt, or could not."""
        was, self._learning = self._learning, state["learning"]
        if was and not self._learning:
            error = state["learn_error"]
            self._say(not error, error or state["message"])

    def _warn(self) -> None:
        """Say once that somebody listens who cannot hear."""
        if not self._warned and (policy := self._belief.hindrance):
            self._warned = True
            print(
                f"Somebody subscribes to {self.prefix}/belief and does not hear it, "
                f"by its {policy}: it is published reliably, the last 64 kept.",
                file=sys.stderr,
            )
