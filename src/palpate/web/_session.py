"""A live session: touches in, a belief that moves, objects taught and learnt."""

import copy
import math
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from .._checks import STRANGERS, check_number, check_strangers
from .._durable import replacing
from .._types import Array
from ..exploration import SurfaceMap
from ..recognition import Evidence, ObjectRecogniser
from ..sensors import (
    ContactError,
    DetectedTouch,
    LiveSensor,
    SensorError,
    channels_of,
)
from ..touches import Touches
from ._episode import LiveEpisode, TopView, place_of
from ._images import ImageKind, Names, check_image
from ._learning import (
    LearningError,
    learn_in_process,
    start_learning,
)
from ._sensor_watch import Event, Health, Listeners, SensorWatch
from ._teaching import MOST_PER_LESSON, Teacher, teachable_name

if TYPE_CHECKING:
    from ._ros import RosPublisher

ONE_SESSION = (
    "All was taught in one session. For another day: lift the sensor, place it again, "
    "let the light settle, take the baseline, and teach ten more touches of each."
)
BEFORE_BASELINE = "No touch was made since the baseline was taken: touch it again."
NOT_KEPT = "Those from before the baseline was taken are not kept."
TOO_LITTLE = "Too little to learn: at least two objects with two touches each."
LOOK_EVERY = 10  # contacts, at the mounting: fewer are too few for its false alarms


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
        Accepted share of wrong names.
    refusal : float, optional
        As for `Belief.decide`; `error` unless given.
    strangers : float, default=0.05
        The share of episodes with something never learnt.
    summary : {"peak", "mean"}, default="peak"
        What stands for a touch, see `TouchDetector`.

    Attributes
    ----------
    listeners : Listeners
        Called with "frame", "contact", "touch" and "state", from other threads.
    episode : LiveEpisode
        The episode under way.
    learning : bool
        Whether it is learning now; `learn_error` says why it failed the last time.
    trouble : str
        Why the last touch of the sensor could not be taken; empty where it could.
    began_before : str
        The `trouble` of a touch that was under way when another one was asked for.
    most_per_lesson : int
        Touches that a lesson may want at most.
    longest_episode : int
        Touches after which the next one begins another episode.

    Raises
    ------
    SensorError
        On `start`: the sensor is missing or busy.
    ValueError
        On `start`: the model is of images of another size, and nothing can be taught.
    ModelFileError, LibraryError
        The model or the library cannot be read.
    """

    most_per_lesson: ClassVar[int] = MOST_PER_LESSON
    longest_episode: ClassVar[int] = 1000
    began_before: ClassVar[str] = (
        "That touch began before, perhaps on another thing: it does not count, touch "
        "again."
    )

    def __init__(
        self,
        sensor: LiveSensor | None = None,
        *,
        model: str | Path | None = None,
        library: str | Path | None = None,
        error: float = 0.01,
        refusal: float | None = None,
        strangers: float = STRANGERS,
        summary: str = "peak",
    ) -> None:
        refusal = error if refusal is None else refusal
        self.episode_options: dict[str, Any] = {"error": error, "refusal": refusal}
        for name, share in self.episode_options.items():
            check_number(name, share, low=1e-6, high=0.5)
        self.episode_options["strangers"] = check_strangers(strangers)
        self.listeners, self.health = Listeners(), Health(sensor)
        self.watch: SensorWatch | None = None
        if sensor is not None:
            observers = self.listeners, self.health
            self.watch = SensorWatch(sensor, self._on_touch, *observers, summary)
        self.teacher = None if library is None else Teacher(library, sensor)
        self._stopped = False
        self._placed_s = self._requested_s = -math.inf
        self._before_baseline: tuple[LiveEpisode, int] | None = None
        self.recogniser: ObjectRecogniser | None = None
        self._top_view: TopView | None = None
        self._stored_ids: set[str] = set()
        self._quality: list[dict[str, Any]] = []
        self._n_elsewhere: dict[str, int] = {}
        self._no_contact_ids: set[str] = set()
        can_teach = self.teacher is not None
        self.episode = LiveEpisode(1, None, self.episode_options, can_teach=can_teach)
        self.learning, self.learn_error = False, ""
        self.message = self.trouble = self.alarm = ""
        self._contact_evidence: list[Evidence] = []
        self._n_contacts = 0
        self._learn_next = False
        self._changed_before: set[str] = set()
        self._lock, self._learn_lock = threading.RLock(), threading.Lock()
        if model is None and library is not None:
            model = Path(library) / "model.palpate"
        self.model_path = path = None if model is None else Path(model)
        if path is not None and (library is None or path.exists()):
            try:
                self._use(ObjectRecogniser.load(path))
            except BaseException:
                self.stop()
                raise

    def start(self) -> Self:
        """Connect the sensor and follow it; nothing happens where that is done.

        The library is made after the sensor is found, so that a missing sensor
        leaves none behind.
        """
        if self.watch is not None:
            self.watch.sensor.connect()  # it may know its size only now
            self.watch.compare_with(self.recogniser)
            if self.watch.misfit and self.teacher is None:
                self.watch.sensor.disconnect()
                raise ValueError(self.watch.misfit)
            self.watch.start()
        try:
            if self.teacher is not None:
                _ = self.teacher.library
                self._note_as_learnt()  # since, perhaps by another program
        except ValueError:
            self.stop()
            raise
        return self

    @staticmethod
    def start_all(sessions: Sequence["LiveSession"]) -> None:
        """Start sessions; one that fails says so on its page, if another can go on."""
        failed: list[Exception] = []
        for session in sessions:
            if session._stopped:  # left out before
                continue
            try:
                session.start()
            except (ValueError, OSError, SensorError) as error:
                failed.append(error)
                if session.watch is not None:
                    session.watch.failed = f"It is left out: {error}"
        if len(failed) == len(sessions):
            raise failed[0]

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
        try:
            return self.start()
        except BaseException:
            self.stop()
            raise

    def __exit__(self, *exception: object) -> None:
        self.stop()

    @property
    def baseline(self) -> Array | None:
        """The frame of touching nothing, where there is one."""
        return None if self.watch is None else self.watch.detector.baseline

    @property
    def unlearnt(self) -> bool:
        """Whether touches were taught, removed or moved since it learnt."""
        is_behind = self.teacher is not None and bool(self.teacher.journal.changed)
        return is_behind and self.recogniser is not None

    @property
    def advice(self) -> list[str]:
        """What to teach next, in sentences, as lessons and learning tell."""
        sentences = [self.alarm]
        if self.teacher is not None:
            sentences += self.teacher.verdicts.values()
        if (recogniser := self.recogniser) is not None:
            sentences += recogniser.teaching_advice(self._quality)
            sessions = recogniser.memory_.sessions
            if self.watch is not None and len(np.unique(sessions)) == 1:
                sentences.append(ONE_SESSION)
        return [sentence for sentence in sentences if sentence]

    def post_touch(
        self, image: Array | None, place: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Take one touch from outside into the episode; return the episode.

        Without an `image` nothing was met. `place` holds its `position_mm` and
        `direction`, and its `force_n`, where they are known.

        Raises
        ------
        ValueError
            The image does not suit the sensor or the model; or the way on which
            nothing was met is far from the object.
        """
        channels: Names = None
        if image is not None:
            image, channels = self._checked(image)
        self._recognise(image, channels, time.monotonic(), place or {})
        return self.episode.to_dict()

    def post_lesson(
        self, name: str, image: Array, place: Mapping[str, Any] | None = None
    ) -> str:
        """Store one touch of an object from outside; return its id."""
        with self._changing():
            checked = self._checked(image)
            return self._teacher().store(name, *checked, self.baseline, place)

    def publish(self, address: str) -> "RosPublisher":
        """Publish beliefs, and do what is asked, on ROS 2 until the result is closed.

        `address` is `ros:PREFIX?domain=0&via=dds`: the prefix of all names, and where;
        `&services=no` offers none, for a node that does.

        Raises
        ------
        AddressError
            The address is none.
        SensorError
            The network is not there.
        """
        from ._ros import RosPublisher

        return RosPublisher(self, address)

    def view_from_above(self) -> dict[str, Any]:
        """Return what the places of the episode's touches tell; see `TopView`."""
        with self._lock:
            view, touches = self._top_view, list(self.episode.touches)
            belief = copy.copy(self.episode.belief)
        return {} if view is None else view.of(touches, belief)

    def begin_episode(self) -> None:
        """Put the touches of the episode aside; the next one begins a new one."""
        with self._changing():
            self._expect_new_touch()
            self._new_episode()

    def end_episode(self) -> dict[str, Any]:
        """End the episode and return it; the next touch begins a new one."""
        with self._changing():
            self.episode.open = False
            return self.episode.to_dict()

    @staticmethod
    def check_name(name: str) -> str:
        """Return the name of an object as `teach` keeps it, or say what is wrong."""
        return teachable_name(name)

    def teach(self, name: str, wanted: int, *, keep_episode: bool = False) -> None:
        """Store the next touches of the sensor as touches of an object.

        With `keep_episode` the last `wanted` of the episode become its first: earlier
        ones may be of a thing that lay there before. Those from before the baseline was
        taken do not: it is not theirs.
        """
        teacher, watch = self._teacher(), self._watched()
        start_learning()
        with self._changing():
            teacher.begin(name, wanted)
            self._expect_new_touch()
            watch.end_press()
            self.message = self.trouble = ""
            touched = self.episode.since_baseline()[-wanted:]
            if keep_episode and not touched:
                self.message = BEFORE_BASELINE
            try:
                for image, columns in touched if keep_episode else ():
                    if teacher.lesson is None:  # the whole recording is stored already
                        break
                    self.message = self._take(image, columns)
                n_wanted = min(wanted, len([*self.episode.pictured()]))
                if keep_episode and touched and len(touched) < n_wanted:
                    self.message += f" {NOT_KEPT}"
            except BaseException:  # refused: what is touched next is not of that name
                teacher.end()
                raise
            self._new_episode()

    def stop_teaching(self) -> None:
        """End the lesson; what was stored stays."""
        with self._changing():
            teacher = self._teacher()
            if (lesson := teacher.lesson) is not None:
                done = f"{lesson.done} of {lesson.wanted}"
                self.message = f"The lesson of {lesson.name} is over: {done} stored."
            teacher.end()

    def resume_teaching(self) -> None:
        """Go on with the lesson that a restart interrupted.

        Before a simulated sensor its object is put down again; nothing where it is
        called otherwise there, so that no other thing is stored by its name.
        """
        teacher, watch = self._teacher(), self._watched()
        start_learning()
        with self._changing():
            name = teacher.resume(self.baseline, watch.detector.noise)
            self._expect_new_touch()
            watch.end_press()
            self.message = self.trouble = ""
            desk = watch.sensor.desk
            if desk is not None:
                is_there = name in desk.objects
                self._put(name if is_there else None)
                if not is_there:
                    self.message = f"Choose what {name} is: nothing is on the desk now."
            self._new_episode()

    def undo(self) -> str:
        """Take back what was done last with touches; return the object they are of."""
        with self._changing():
            name, self.message = self._teacher().undo()
            self._note_as_learnt()
            return name

    def _note_as_learnt(self, *, ended: bool = False) -> None:
        """Note which changed objects have just the touches that were learnt.

        While it is learning, and that has not `ended`, nobody knows which these are.
        """
        teacher = self._teacher()
        journal = teacher.journal
        waits = self.learning and not ended
        if self.recogniser is None or waits or not journal.changed:
            return
        if not {old for old, _ in journal.renamed} & self._n_elsewhere.keys():
            journal.renamed.clear()  # the model knows none of these from elsewhere
        renamed = {name for names in journal.renamed for name in names}
        memory = self.recogniser.memory_
        labels, stored = memory.labels.astype(str), teacher.known_ids()
        for name in journal.changed - renamed:
            learnt = {*memory.touch_ids[labels == name].tolist()} & stored
            if teacher.ids_of(name) == learnt:
                journal.changed.discard(name)
                journal.learnt()

    def remove_touches(self, ids: Sequence[str]) -> str:
        """Leave stored touches out, which `undo` takes back; return what to say."""
        with self._changing():
            self.message = self._teacher().remove(ids)
            return self.message

    def move_touches(self, ids: Sequence[str], name: str) -> str:
        """Let stored touches be of another object; return what to say."""
        with self._changing():
            self.message = self._teacher().move(ids, name)
            return self.message

    def rename(self, old: str, new: str, *, merge: bool = False) -> None:
        """Give an object of the library another name, and learn it by that name.

        With `merge` it becomes one with the object that has the name already.
        """
        with self._lock:
            learnt = self._knows(old)
            tidy = self._teacher().rename(old, new, learnt=learnt, merge=merge)
            self.message = f"{old} is called {tidy} now."
        self._learn_again([(old, tidy)])

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
        self._learn_again([(name, "")])

    def learn(self, *, wait: bool = False) -> None:
        """Learn what the library holds, in another process; `learning` says it is on.

        What the model knows from elsewhere is kept, and goes on under the names that it
        was given here. The model file is written anew; one that was given from outside
        the library stays there, as it was, as `given_model`.

        Parameters
        ----------
        wait : bool, default=False
            Return only when it is done.

        Raises
        ------
        LearningError
            It is learning already.
        """
        self._begin_learning("Learning.", wait=wait)

    def _begin_learning(self, message: str = "", *, wait: bool = False) -> None:
        journal = self._teacher().journal
        if not self._learn_lock.acquire(blocking=False):
            raise LearningError("It is learning already; wait until it has finished.")
        self.learning, self.learn_error = True, ""
        with self._lock:
            self._changed_before, journal.changed = journal.changed, set()
            changes = list(journal.renamed)
            self.message = message or self.message
        self._notify_state()
        thread = threading.Thread(target=self._learn, args=(changes,), daemon=True)
        thread.start()
        if wait:
            thread.join()

    def take_baseline(
        self, *, force: bool = False, ask_press: bool = False, changed: str = ""
    ) -> None:
        """Take the frame of touching nothing; see `SensorWatch.take_baseline`.

        What is taught from now on is of another session; `changed` says why, in words.
        """
        watch, began_s = self._watched(), time.monotonic()
        try:
            watch.take_baseline(force=force, ask_press=ask_press)
        except ContactError as error:
            desk = watch.sensor.desk
            if desk is None or desk.placed is None:
                raise
            raise ContactError(
                f"{desk.placed} touches the sensor. Put nothing on the desk, then take "
                "the baseline again."
            ) from error
        self.message = "The baseline is taken."
        # A touch that is on its way is of the baseline before.
        self._requested_s = max(self._requested_s, began_s)
        episode = self.episode
        self._before_baseline = episode, episode.n_before_baseline
        episode.n_before_baseline = len(episode.touches)
        self._contact_evidence, self._n_contacts, self.alarm = [], 0, ""
        if self.teacher is not None:
            self.teacher.begin_session(changed or "new baseline")
        self._notify_state()

    def end_press(self, *, undo: bool = False) -> None:
        """End the trial of a baseline, and go back to the one before with `undo`."""
        watch = self._watched()
        if undo:
            watch.undo_baseline()
            self._undo_session()
            self.message = "The baseline is undone."
        else:
            watch.end_press()
        self._notify_state()

    def _undo_session(self) -> None:
        """Go on with the session, and the touches, of the baseline before."""
        episode, n_touches = self.episode, len(self.episode.touches)
        if self._before_baseline is None:
            episode.n_before_baseline = n_touches
            return
        before, n_before = self._before_baseline
        is_same = episode is before and episode.n_before_baseline == n_touches
        episode.n_before_baseline = n_before if is_same else n_touches
        self._before_baseline = None
        if self.teacher is not None:
            self.teacher.undo_session()

    def press_difference(self) -> Array:
        """Return how the test press differs from the baseline."""
        return self._watched().press_difference()

    def _watched(self) -> SensorWatch:
        if self.watch is None:
            raise SensorError(
                "There is no sensor here. Post touches, or start again with a `sensor`."
            )
        return self.watch

    def place(self, name: str | None) -> None:
        """Put something else before a replayed or simulated sensor, or nothing."""
        with self._lock:
            self._put(name)
        self._notify_state()

    def _put(self, name: str | None) -> None:
        """Put something on the desk; the touch under way is of what was there."""
        desk = None if self.watch is None else self.watch.sensor.desk
        if desk is None:
            raise ValueError("What lies before a real sensor cannot be chosen here.")
        is_other = name != desk.placed
        desk.place(name)
        if is_other:
            self._placed_s = time.monotonic()

    def tell_state(self, listener: Callable[[Event], None]) -> None:
        """Tell one listener the state, before whatever changes it next."""
        with self._lock:
            numbered = {**self.to_dict(), "sensor_number": self.listeners.number}
            listener(Event("state", numbered))

    def to_dict(self) -> dict[str, Any]:
        """Return everything but pictures, as plain values."""
        with self._lock:
            teacher, model, original = self.teacher, self.recogniser, self.given_model
            lesson = None if teacher is None else teacher.lesson
            if self.watch and self.watch.misfit and self._n_elsewhere:
                original = None  # Learn is refused
            return {
                "sensor": None if self.watch is None else self.watch.to_dict(),
                "model": None
                if model is None
                else {
                    "objects": model.classes_.tolist(),
                    "n_touches": len(model.memory_),
                    "encoding": str(model.chosen_.get("encoding", "")),
                    "file": str(self.model_path),
                    "n_elsewhere": self._n_elsewhere,
                    "to_keep": str(original)
                    if original and not original.exists()
                    else "",
                },
                "library": None if teacher is None else teacher.to_dict(),
                "lesson": None if lesson is None else lesson.to_dict(),
                "episode": self.episode.to_dict(),
                "nearest": self.episode.nearest,
                "quality": self._quality,
                "no_contact": sorted(
                    self._no_contact_ids.union(
                        teacher.journal.no_contact_ids if teacher else ()
                    )
                ),
                "advice": self.advice,
                "alarm": self.alarm,
                "learning": self.learning,
                "unlearnt": self.unlearnt,
                "learn_error": self.learn_error,
                "message": self.message,
                "trouble": self.trouble,
                "health": self.health.to_dict(),
            }

    def _teacher(self) -> Teacher:
        if self.teacher is None:
            raise LearningError(
                "Nothing can be taught without a library. Start again with "
                "`library=FOLDER`."
            )
        return self.teacher

    def _kind(self) -> ImageKind | None:
        """Return what images are like: the sensor's, newest stored, or the model's.

        Without these as the first of the episode.
        """
        if self.watch is not None:
            sensor = self.watch.sensor
            return ImageKind(sensor.image_shape, sensor.dtype, sensor.channels)
        stored = None if self.teacher is None else self.teacher.newest_kind()
        if stored is not None:
            return stored
        if self.recogniser is None:
            episode = self.episode
            first = next(episode.pictured(), None) if episode.open else None
            return first and ImageKind(first[1].shape, None, episode.channels)
        encoder = self.recogniser.encoder_
        return ImageKind(encoder.image_shape_, None, encoder.channels_)

    def takes_colour(self) -> bool:
        """Whether images have channels, so that pictures are read in colour."""
        kind = self._kind()
        return kind is not None and kind.channels is not None

    def _checked(self, image: Array) -> tuple[Array, Names]:
        """Return a posted image of the right kind, and its channels, or explain."""
        if image.dtype.kind == "f" and np.isnan(image).all():
            raise ValueError(
                "image must hold at least one number, got only NaN (null in JSON), "
                "which nothing can be learnt from. Send the frame as it was read."
            )
        kind = self._kind()
        if kind is None:
            return image, channels_of(image.shape)
        return check_image(image, kind), kind.channels

    def _knows(self, name: str) -> bool:
        return self.recogniser is not None and name in self.recogniser.classes_

    def _use(self, recogniser: ObjectRecogniser | None) -> None:
        """Recognise with another model from the next touch on."""
        ids = set() if self.teacher is None else self.teacher.known_ids()
        quality = [] if recogniser is None else recogniser.object_quality()
        with self._lock:
            self.recogniser, self._stored_ids = recogniser, ids
            self._top_view = None if recogniser is None else self._view_of(recogniser)
            self._contact_evidence, self._n_contacts, self.alarm = [], 0, ""
            self._quality, self._n_elsewhere, self._no_contact_ids = quality, {}, set()
            if recogniser is not None:
                memory = recogniser.memory_
                nothing = memory.nothing & (not recogniser.uses_no_contact_)
                self._no_contact_ids = set(memory.touch_ids[nothing].tolist()) & ids
                names = memory.labels[~np.isin(memory.touch_ids, list(ids))]
                counts = Counter(names.astype(str).tolist())
                self._n_elsewhere = dict(sorted(counts.items()))
            if self.teacher is not None:
                self.teacher.elsewhere = {*self._n_elsewhere}
            if self.watch is not None:
                self.watch.compare_with(recogniser)
            self._new_episode()

    def _view_of(self, recogniser: ObjectRecogniser) -> TopView:
        def read_learnt() -> Touches | None:
            touches = None
            if self.teacher is not None:
                ids = recogniser.memory_.touch_ids.tolist()
                shape = recogniser.encoder_.image_shape_
                touches = self.teacher.touches_of_ids(ids, shape)
            archive = self.model_path and self.model_path.with_suffix(".npz")
            if touches is None and archive is not None and archive.is_file():
                return Touches.load(archive)
            return touches

        def learnt(surface_map: SurfaceMap | None) -> None:
            with self._changing():
                waits = self.episode.is_placed and not self.episode.by_place
                if surface_map is not None and waits and self.recogniser is recogniser:
                    self.episode.believe_by_place(surface_map)

        return TopView(recogniser, read_learnt, learnt)

    def _new_episode(self) -> None:
        number = self.episode.number + bool(self.episode.touches)
        self.episode = LiveEpisode(
            number,
            self.recogniser,
            self.episode_options,
            self._stored_ids,
            can_teach=self.teacher is not None,
        )

    def _take(self, image: Array, columns: Mapping[str, Any] | None = None) -> str:
        """Take a touch into the lesson; return what to say."""
        noise = self._watched().detector.noise
        return self._teacher().take(image, self.baseline, noise, columns or {})

    def _expect_new_touch(self) -> None:
        """Let a touch that is under way, perhaps of another thing, count for nothing.

        On a desk it is known what lies there.
        """
        if self.watch is not None and self.watch.sensor.desk is None:
            self._requested_s = time.monotonic()

    def _on_touch(self, detected: DetectedTouch, ended_s: float) -> None:
        """Take a touch of the sensor: into the lesson, else into the episode."""
        teaching, was_well = False, not self.trouble
        try:
            with self._lock:
                if detected.began_s < self._placed_s:
                    return
                if detected.began_s < self._requested_s:
                    raise ValueError(self.began_before)
                teaching = self.teacher is not None and self.teacher.lesson is not None
                image, columns = detected.image, detected.touch_columns
                if teaching:
                    self.message = self._take(image, columns)
            if not teaching:
                channels = self._watched().sensor.channels
                device_time_s = detected.device_time_s
                self._recognise(image, channels, ended_s, columns, device_time_s)
            self.trouble = ""
        except (ValueError, OSError, MemoryError) as error:
            self.message = self.trouble = str(error)
        except Exception as error:  # of a model's own parts: others do not end with it
            self.message = self.trouble = repr(error)
        if teaching or self.trouble or not was_well:
            self._notify_state()

    def _recognise(
        self,
        image: Array | None,
        channels: Names,
        ended_s: float,
        columns: Mapping[str, Any],
        device_time_s: float | None = None,
    ) -> None:
        if self.watch is not None and self.watch.misfit:
            raise ValueError(self.watch.misfit)
        with self._lock:
            n_touches = len(self.episode.touches)
            if not self.episode.open or n_touches >= self.longest_episode:
                self._new_episode()
            self._use_places(columns)
            touch = self.episode.add(image, channels, columns, self._rest)
            touch.device_time_s = device_time_s
            touch.latency_ms = 1e3 * (time.monotonic() - ended_s)
            self.health.count_touch(touch.latency_ms)
            episode = {**self.episode.to_dict(), "touches": [dict(vars(touch))]}
            values = {"episode": episode, "nearest": self.episode.nearest}
            self.listeners.notify(Event("touch", values, b"", image, channels))
        if image is not None:
            self._check_mounting()

    @property
    def _rest(self) -> Array | None:
        """What the sensor reads at rest today, where touches are changes from it."""
        encoder = None if self.recogniser is None else self.recogniser.encoder_
        return self.baseline if getattr(encoder, "as_changes", False) else None

    def _use_places(self, columns: Mapping[str, Any]) -> None:
        """Let the belief be by places from the first touch on that has one."""
        view, episode = self._top_view, self.episode
        if view is None or episode.by_place or "position_mm" not in place_of(columns):
            return
        if view.map is None:
            view.learn()
        else:
            episode.believe_by_place(view.map)
            self._notify_state()

    def _check_mounting(self) -> None:
        """After every ten contacts, tell whether the sensor is as it was."""
        with self._lock:
            recogniser, evidence = self.recogniser, self.episode.evidence
            if recogniser is None or evidence is None:
                return
            if not evidence.shows_contact[0]:
                return
            latest = [*self._contact_evidence, evidence][-3 * LOOK_EVERY :]
            self._contact_evidence = latest
            self._n_contacts += 1
            if self._n_contacts % LOOK_EVERY:
                return
        check = recogniser.check_mounting(Evidence.together(latest))
        self.alarm = check.message()
        self._notify_state()

    def _learn_again(self, changes: Sequence[tuple[str, str]] = ()) -> None:
        """Learn after a change, where there was a model; after learning under way."""
        with self._lock:
            if self.recogniser is None and not self.learning:
                self._notify_state()
                return
            journal = self._teacher().journal
            journal.renamed += changes
            journal.changed |= {name for change in changes for name in change} - {""}
            journal.learnt()  # a restart before the end loses none
            try:
                self._begin_learning()
            except LearningError:
                self._learn_next = True
                self._notify_state()

    def _learn(self, changes: Sequence[tuple[str, str]]) -> None:
        journal = self._teacher().journal
        try:
            self._learn_in_process(changes)
            with self._lock:
                del journal.renamed[: len(changes)]
                journal.learnt()
                self._note_as_learnt(ended=True)  # what was taught as it began
        except Exception as error:
            is_plain = isinstance(error, (ValueError, OSError, MemoryError))
            self.learn_error = str(error) if is_plain else repr(error)
            with self._lock:
                self.message = ""
                journal.changed |= self._changed_before
                journal.learnt()
        finally:
            with self._lock:
                self.learning = False
                self._learn_lock.release()
                again, self._learn_next = self._learn_next, False
            self._notify_state()
            if again:
                self._learn_again()

    @property
    def given_model(self) -> Path | None:
        """Where a model from outside the library is kept as it was given."""
        path, teacher = self.model_path, self.teacher
        if path is None or teacher is None or not path.is_file():
            return None
        folder = teacher.folder.resolve()
        inside = path.resolve().is_relative_to(folder)
        return None if inside else folder / f"given-{path.name}"

    def _learn_in_process(self, changes: Sequence[tuple[str, str]]) -> None:
        assert self.teacher is not None
        assert self.model_path is not None
        path, shape = self.model_path, self.teacher.image_shape()
        base, original = path if path.is_file() else None, self.given_model
        if original is not None and not original.exists():
            with path.open("rb") as source, replacing(original) as target:
                shutil.copyfileobj(source, target)
        answer = learn_in_process(self.teacher.folder, path, base, changes, shape)
        if names := answer["objects"]:
            self._use(ObjectRecogniser.load(path))
            more = " What to teach next stands under Teach." * bool(self.advice)
            message = f"Learnt {len(names)} objects from {answer['n_touches']} touches"
            before = answer["n_elsewhere"]
            message += f", {before} of them known from elsewhere." if before else "."
            if empty := answer["left_out"]:
                message += (
                    f" Left out as holding no number: {', '.join(empty[:3])}"
                    f"{' and more' * (len(empty) > 3)}; retract them for good."
                )
            self.message = message + more
            return
        if stays := answer["stays"]:
            raise LearningError(
                f"{TOO_LITTLE} The model stays as it was, for {stays[0]}. Teach "
                "another object, then learn."
            )
        self._use(None)
        path.unlink(missing_ok=True)
        self.teacher.journal.renamed.clear()  # nothing is known from elsewhere
        raise LearningError(TOO_LITTLE)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        try:
            with self._lock:
                yield
        finally:
            self._notify_state()

    def _notify_state(self) -> None:
        with self._lock:  # so that no state comes after a newer one
            if len(self.listeners):
                self.listeners.notify(Event("state", self.to_dict()))
