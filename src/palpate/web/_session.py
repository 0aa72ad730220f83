"""A live session: touches in, a belief that moves, objects taught and learnt."""

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from .._checks import check_number
from ..recognition import ObjectRecogniser
from ..sensors import LiveSensor, SensorError, SensorMemory, desk_of
from ._episode import LiveEpisode
from ._events import Event, Listeners
from ._health import Health
from ._learning import LearningError, learn_apart
from ._neighbours import Neighbours
from ._suited import misfit, model_state, suited_to
from ._teaching import Lesson, Teacher, checked_name
from ._watch import SensorWatch

LONGEST_EPISODE = 1000


class LiveSession:
    """A sensor, what it has learnt, and the episode under way.

    Parameters
    ----------
    sensor : LiveSensor, optional
        Not connected yet; without one touches come through `post_touch` alone.
    model : path, optional
        Model file to start from, and to write when something is learnt; by default
        `model.palpate` in the library.
    library : path, optional
        Folder of the library that keeps what is taught; made where there is none.
    error : float, default=0.01
        Accepted share of wrong decisions.
    summary : {"peak", "mean"}, default="peak"
        What stands for a touch, see `TouchDetector`.

    Attributes
    ----------
    listeners : Listeners
        Told of "frame", "contact", "touch" and "state", from other threads.
    episode : LiveEpisode
        The episode under way.
    trouble : str
        Why the last touch of the sensor could not be taken; empty where it could.

    Raises
    ------
    SensorError
        On `start`: the sensor is missing or busy.
    ValueError
        On `start`: the model is of images of another size, and nothing can be taught.
    ModelFileError, LibraryError
        The model or the library cannot be read.
    """

    def __init__(
        self,
        sensor: LiveSensor | None = None,
        *,
        model: str | Path | None = None,
        library: str | Path | None = None,
        error: float = 0.01,
        summary: str = "peak",
    ) -> None:
        self.error = check_number("error", error, low=1e-6, high=0.5)
        self.listeners, self.health = Listeners(), Health()
        self.watch: SensorWatch | None = None
        if sensor is not None:
            self.watch = SensorWatch(
                sensor, self._taken, self.listeners, self.health, summary
            )
        self.teacher = None if library is None else Teacher(library, sensor)
        self._stopped = False
        self.recogniser: ObjectRecogniser | None = None
        self._neighbours: Neighbours | None = None
        self.episode = LiveEpisode(1, None, self.error)
        self.learning, self.learn_error = False, ""
        self.message = self.trouble = ""
        self._nearest: list[dict[str, Any]] = []
        self._drop_next: list[str] | None = None
        self._lock, self._learn_lock = threading.RLock(), threading.Lock()
        self.model_path = None if model is None else Path(model)
        if model is None and library is not None:
            self.model_path = Path(library) / "model.palpate"
        if self.model_path is not None and (
            library is None or self.model_path.exists()
        ):
            self._use(ObjectRecogniser.load(self.model_path))

    def start(self) -> Self:
        """Connect the sensor and follow it; nothing happens where that is done.

        The library is made after the sensor is found, so that a missing sensor
        leaves none behind.
        """
        told = misfit(
            self.recogniser, None if self.watch is None else self.watch.sensor
        )
        if told and self.teacher is None:
            raise ValueError(told)
        if self.watch is not None:
            self.watch.start()
        try:
            if self.teacher is not None:
                self.teacher.open()
        except ValueError:
            self.stop()
            raise
        return self

    def stop(self) -> None:
        """Free the sensor and the library."""
        if self._stopped:
            return
        self._stopped = True
        if self.watch is not None:
            self.watch.stop()
        if self.teacher is not None and self._learn_lock.acquire(timeout=5.0):
            self.teacher.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.stop()

    @property
    def zero(self) -> NDArray[Any] | None:
        """The frame of no contact, where there is one."""
        return None if self.watch is None else self.watch.detector.baseline

    def post_touch(self, image: NDArray[Any]) -> dict[str, Any]:
        """Take one touch from outside into the episode; return the episode.

        Raises
        ------
        ValueError
            The image does not suit the sensor or the model.
        """
        self._recognise(self._suited(image), time.monotonic())
        return self.episode.told()

    def post_lesson(self, name: str, image: NDArray[Any]) -> str:
        """Store one touch of an object from outside; return its id."""
        with self._lock:
            key = self._teacher().store(
                checked_name(name), self._suited(image), self.zero
            )
        self._tell_state()
        return key

    def begin_episode(self) -> None:
        """Put the touches of the episode aside; the next one begins a new one."""
        with self._lock:
            self._new_episode()
        self._tell_state()

    def end_episode(self) -> dict[str, Any]:
        """End the episode and return it; the next touch begins a new one."""
        with self._lock:
            self.episode.open = False
            told = self.episode.told()
        self._tell_state()
        return told

    def teach(self, name: str, wanted: int) -> None:
        """Store the next touches of the sensor as touches of an object."""
        with self._lock:
            self._teacher().begin(name, wanted)
            self.message = self.trouble = ""
            self._new_episode()
        self._tell_state()

    def stop_teaching(self) -> None:
        """End the lesson; what was stored stays."""
        with self._lock:
            self._teacher().end()
        self._tell_state()

    def undo(self) -> str:
        """Leave out the touch stored last in this session; return its object."""
        with self._lock:
            name = self._teacher().undo()
            self.message = f"The last touch of {name} is undone."
        self._tell_state()
        return name

    def rename(self, old: str, new: str) -> None:
        """Give an object of the library another name, and learn it by that name."""
        with self._lock:
            tidy = self._teacher().rename(old, new, learnt=self._knows(old))
            self.message = f"{old} is called {tidy} now."
        self._learn_again([old])

    def forget(self, name: str) -> None:
        """Leave all touches of an object out, and learn without it.

        Raises
        ------
        ValueError
            Neither library nor model know it.
        """
        with self._lock:
            self._teacher().forget(name, learnt=self._knows(name))
            self.message = f"{name} is forgotten."
        self._learn_again([name])

    def learn(self, drop: Sequence[str] = (), *, wait: bool = False) -> None:
        """Learn what the library holds, in another process; tells when it is done.

        Parameters
        ----------
        drop : sequence of str
            Objects of the model that are not kept.
        wait : bool, default=False
            Return only when it is done.

        Raises
        ------
        LearningError
            It is learning already.
        """
        self._teacher()
        if not self._learn_lock.acquire(blocking=False):
            raise LearningError("It is learning already; wait until it has finished.")
        self.learning, self.learn_error = True, ""
        self._tell_state()
        thread = threading.Thread(target=self._learn, args=(list(drop),), daemon=True)
        thread.start()
        if wait:
            thread.join()

    def take_zero(self, *, force: bool = False) -> None:
        """Take the frame of no contact; see `SensorWatch.take_zero`."""
        if self.watch is None:
            raise SensorError("There is no sensor here to take a zero of.")
        self.watch.take_zero(force=force)
        self.message = "The zero is taken."
        self._tell_state()

    def place(self, name: str | None) -> None:
        """Put something else before a replayed or simulated sensor, or nothing."""
        desk = None if self.watch is None else desk_of(self.watch.sensor)
        if desk is None:
            raise ValueError("What lies before a real sensor cannot be chosen here.")
        desk.place(name)
        self._tell_state()

    def state(self) -> dict[str, Any]:
        """Return everything but pictures, as plain values."""
        with self._lock:
            teacher = self.teacher
            lesson = None if teacher is None else teacher.lesson
            return {
                "sensor": None if self.watch is None else self.watch.state(),
                "model": model_state(self.recogniser, self.model_path),
                "library": None if teacher is None else teacher.told(),
                "lesson": None if lesson is None else lesson.told(),
                "episode": self.episode.told(),
                "nearest": list(self._nearest),
                "learning": self.learning,
                "learn_error": self.learn_error,
                "message": self.message,
                "health": self.health_state(),
            }

    def health_state(self) -> dict[str, Any]:
        """Return frame rate (Hz), frames dropped, and latencies (ms)."""
        if self.watch is not None:
            return self.watch.health_state()
        return {**self.health.told(), "n_dropped": 0}

    def _teacher(self) -> Teacher:
        if self.teacher is None:
            raise ValueError(
                "Nothing can be taught without a library. Start again with "
                "--library FOLDER."
            )
        return self.teacher

    def _suited(self, image: NDArray[Any]) -> NDArray[Any]:
        sensor = None if self.watch is None else self.watch.sensor
        stored = None if self.teacher is None else self.teacher.newest_type()
        return suited_to(image, sensor, stored, self.recogniser)

    def _knows(self, name: str) -> bool:
        return self.recogniser is not None and name in self.recogniser.classes_

    def _use(self, recogniser: ObjectRecogniser | None) -> None:
        """Recognise with another model from the next touch on."""
        stored = None if recogniser is None else recogniser.memory_.sensor
        memory = None if stored is None else SensorMemory.from_dict(stored)
        ids = set() if self.teacher is None else self.teacher.known_ids()
        neighbours = None if recogniser is None else Neighbours(recogniser, ids)
        with self._lock:
            self.recogniser, self._neighbours = recogniser, neighbours
            if self.watch is not None:
                self.watch.remember(memory, misfit(recogniser, self.watch.sensor))
            self._new_episode()

    def _new_episode(self) -> None:
        number = self.episode.number + bool(self.episode.touches)
        self.episode = LiveEpisode(number, self.recogniser, self.error)
        self._nearest = []

    def _taken(self, image: NDArray[Any], ended_s: float) -> None:
        """Take a touch of the sensor: into the lesson, else into the episode."""
        try:
            lesson = self._stored(image)
            if lesson is None:
                self._recognise(image, ended_s)
                self.trouble = ""
                return
            count = f"{len(lesson.ids)} of {lesson.wanted}"
            self.message = f"Touch {count} of {lesson.name} is stored."
            if len(lesson.ids) >= lesson.wanted:
                self.message += " Learn to recognise it."
            self.trouble = ""
        except (ValueError, OSError, MemoryError) as error:
            self.message = self.trouble = str(error)
        self._tell_state()

    def _stored(self, image: NDArray[Any]) -> Lesson | None:
        with self._lock:
            if self.teacher is None or self.teacher.lesson is None:
                return None
            return self.teacher.take(image, self.zero)

    def _recognise(self, image: NDArray[Any], ended_s: float) -> None:
        with self._lock:
            if not self.episode.open or len(self.episode.touches) >= LONGEST_EPISODE:
                self._new_episode()
            touch, features = self.episode.add(image)
            if features is not None and self._neighbours is not None:
                self._nearest = self._neighbours.of(features)
            touch.latency_ms = 1e3 * (time.monotonic() - ended_s)
            self.health.count_touch(touch.latency_ms)
            episode = {**self.episode.told(), "touches": [touch.told()]}
            values = {"episode": episode, "nearest": list(self._nearest)}
        self.listeners.tell(Event("touch", values))

    def _learn_again(self, drop: Sequence[str]) -> None:
        """Learn after a change, where there was a model; after learning under way."""
        if self.recogniser is None:
            self._tell_state()
            return
        try:
            self.learn(drop)
        except LearningError:
            self._drop_next = [*(self._drop_next or ()), *drop]
            self._tell_state()

    def _learn(self, drop: Sequence[str]) -> None:
        try:
            self._learn_apart(drop)
        except (ValueError, OSError) as error:
            self.learn_error = str(error)
        finally:
            self.learning = False
            self._learn_lock.release()
            self._tell_state()
            if self._drop_next is not None:
                drop, self._drop_next = self._drop_next, None
                self._learn_again(drop)

    def _learn_apart(self, drop: Sequence[str]) -> None:
        assert self.teacher is not None
        assert self.model_path is not None
        base = self.model_path if self.model_path.is_file() else None
        shape = self.teacher.image_shape()
        answer = learn_apart(self.teacher.folder, self.model_path, base, drop, shape)
        names = answer["objects"]
        if names:
            self._use(ObjectRecogniser.load(self.model_path))
            touches = f"{answer['n_touches']} touches"
            self.message = f"Learnt {len(names)} objects from {touches}."
            return
        self._use(None)
        self.model_path.unlink(missing_ok=True)
        raise LearningError(
            "Too little to learn: at least two objects with two touches each."
        )

    def _tell_state(self) -> None:
        if len(self.listeners):
            self.listeners.tell(Event("state", self.state()))
