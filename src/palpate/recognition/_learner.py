"""Learning objects from touches, more of them later, and getting used to sessions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import validate_data

from .._checks import (
    as_groups,
    check_count,
    check_number,
    check_option,
    check_targets,
    one_spelling,
    unmasked,
)
from .._numbers import log_softmax, with_floor, without_gaps
from .._parallel import on_one_thread
from .._types import Array, Bools, Floats, Indices, Label, Presentation, PresetName
from ..classifiers import EncodingPool, TouchClassifier
from ..images import PressPose
from ..touches import Touches, TouchSource
from . import _evidence, _memory
from ._alarm import MountingCheck
from ._calibration import (
    LeftOut,
    draw_episodes,
    fit_sequence_calibration,
    fit_strangers,
    left_out_log_likelihood,
)
from ._contact import ContactCheck, consists_of_nothing
from ._encoder import TouchEncoder
from ._evidence import as_touches
from ._learning import (
    encoded,
    learn_encoding,
    memory_of,
    naming_empty,
    refuse_too_large,
)
from ._learnt import Learnt, RemountedEncoder
from ._memory import Memory, Nearest
from ._presets import PRESENTATIONS, Preset, find_preset, resolved_preset
from ._rehearsal import rehearsal_message, rehearse
from ._remounting import across_sessions, remounted, without_nuisance
from ._strangers import StrangerModel
from ._user_parts import Encoding, Modality


class Learner(BaseEstimator):
    """What `ObjectRecogniser` learns: encoding, classifier, memory, calibrations."""

    max_memory_gb: ClassVar[float] = 8.0
    encoder_: TouchEncoder | RemountedEncoder
    contact_: ContactCheck
    classifier_: TouchClassifier
    memory_: Memory
    chosen_: dict[str, Any]
    pose_: PressPose | None
    modalities_: dict[str, Modality]

    # The last check of the mounting: of today, so that no file holds it.
    _mounting: MountingCheck | None = None

    def __init__(
        self,
        preset: PresetName | None = "default",
        *,
        encodings: Mapping[str, Encoding] | None = None,
        classifier: Any = None,
        label: Label = "object",
        floor: float | None = None,
        prior: Literal["uniform", "counts"] = "uniform",
        presentation: Presentation = "auto",
        rehearse: bool = True,
        random_state: int = 0,
    ) -> None:
        self.preset = preset
        self.encodings = encodings
        self.classifier = classifier
        self.label = label
        self.floor = floor
        self.prior = prior
        self.presentation = presentation
        self.rehearse = rehearse
        self.random_state = random_state

    def fit(
        self,
        X: Touches | TouchSource | ArrayLike | Sequence[Touches],
        y: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> Self:
        """Learn objects from labelled touches.

        Parameters
        ----------
        X : Touches, TouchSource, or array-like of shape (n_touches, n_rows, n_cols)
            Or feature vectors, (n_touches, n_features), also as a data frame: touches
            without geometry, which everything that takes images then takes. Of a
            source (`TouchLibrary.select`), the encoding is learnt from some
            2000 touches and the rest are encoded piece by piece, so that their
            images are never all in memory.
        y : array-like of shape (n_touches,), optional
            Labels; by default the touches' own.
        groups : array-like of shape (n_touches,), optional
            Touches of one group (a session, a block of a recording) are left out
            together; by default found out from session, order and object.

        Raises
        ------
        ValueError
            If labels are missing, there are fewer than two of them, or one has
            fewer than two touches; none is in two groups; or it would take too much
            memory. What was learnt before is then as it was.
        """
        preset, later = self._check_parameters(), copy(self)
        X, y = later._validated_input(X, y)
        touches = _memory.labelled(X, y, self.label)
        labels, objects = _memory.training_labels(touches, self.label)
        if y is not None and self.label == "object":
            labels = objects = np.asarray(y)
        elif y is not None and np.asarray(y).dtype.kind not in "OU":
            labels = np.asarray(y)
        refuse_too_large(labels, self.max_memory_gb)
        if groups is None:
            blocks = _memory.left_out_groups(touches, labels, objects, self.label)
        else:
            blocks = as_groups(groups, len(labels))
            if _memory.n_met(labels, blocks).max() < 2:
                raise ValueError(
                    f"groups must be at least two of some {self.label}, one left out "
                    "while others teach, got one of each. Give sessions or runs of a "
                    "recording, or none."
                )
        with on_one_thread(), naming_empty(touches):
            encoder, contact, chosen, encoding = learn_encoding(
                preset, touches, labels, blocks, self.presentation
            )
            memory = memory_of(touches, encoding, labels, objects, blocks)
            if groups is None:
                memory = memory.with_copies_together()
            later.encoder_, later.contact_, later.chosen_ = encoder, contact, chosen
            later.classifier_ = preset.classifier(encoder).fit(
                memory.features, memory.labels, groups=memory.blocks
            )
            if self.rehearse and isinstance(later.classifier_, EncodingPool):
                later.classifier_, weighed = rehearse(
                    later.classifier_,
                    encoder,
                    memory,
                    touches,
                    chosen["geometry"],
                    self.random_state,
                )
                chosen["rehearsal"] = weighed
                chosen["found"] = [*chosen.get("found", ()), rehearsal_message(weighed)]
            if len(later.classifier_.part_weights) > 1:
                chosen["weights"] = dict(later.classifier_.part_weights)
            later._calibrate(memory)
        later.pose_, later.modalities_, later._mounting = None, {}, None
        self.__dict__ = later.__dict__
        return self

    def add_object(self, name: str, touches: Touches | TouchSource) -> Self:
        """Learn one more object; the encoding and its choices stay as they are.

        Parameters
        ----------
        name : str
            A label not known yet (with `label="category"`, the category).
        touches : Touches
            Its touches; their own labels are ignored.

        Raises
        ------
        ValueError
            If the object is known, or has fewer than two touches.
        """
        self._check_fitted()
        name = self._spelt(name)
        if name in self._names():
            raise ValueError(
                f"name must be new, got {name!r}, which is known already. Add touches "
                "to it with extend_object, replace it, or choose another name."
            )
        return self._relearn(self.memory_.plus(self._memory_of(name, touches, 2)))

    def extend_object(
        self, name: str, touches: Touches | TouchSource, most: int | None = None
    ) -> Self:
        """Learn more touches of a known object, beside those it has.

        Parameters and errors as of `add_object`, but the object must be known, and one
        touch is enough. What it has without an id and is given once more counts once.
        With `most` no more touches of it are kept: of its sessions
        the same number where there are enough, of each the newest, so that what is
        met again every day neither grows for ever nor forgets its first days.
        """
        self._check_fitted()
        name = check_option("name", self._spelt(name), self._names())
        memory = self.memory_.plus_once(self._memory_of(name, touches, 1))
        if most is not None:
            memory = memory.newest(name, check_count("most", most, at_least=2))
        return self._relearn(memory)

    def replace_objects(
        self, touches: Touches | TouchSource | None, forget: Iterable[str] = ()
    ) -> Self:
        """Learn objects anew, in place of what was known of them, and forget others.

        Parameters
        ----------
        touches : Touches, TouchSource or None
            Labelled touches of known or new objects, two of each at least.
        forget : str or iterable of str
            Names that are forgotten; unknown ones are passed over.

        Raises
        ------
        ValueError
            If fewer than two objects would remain, or labels are missing.
        """
        self._check_fitted()
        names = [forget] if isinstance(forget, str) else forget
        memory = self.memory_.without(map(self._spelt, names))
        for name, of_object in _memory.by_label(touches, self.label):
            memory = memory.without([name]).plus(self._memory_of(name, of_object, 2))
        return self._relearn(memory)

    def learn_beside(self, kept: Memory, touches: Touches | TouchSource | None) -> Self:
        """Learn labelled touches beside what is `kept` of the memory, and no others.

        Touches of an object of which some are kept join these; of a new one two are
        needed. What is kept without an id and given once more counts once.

        Raises
        ------
        ValueError
            If fewer than two objects would remain, or labels are missing.
        """
        self._check_fitted()
        memory = kept
        for name, of_object in _memory.by_label(touches, self.label):
            least = 1 if name in memory.labels.astype(str) else 2
            memory = memory.plus_once(self._memory_of(name, of_object, least))
        return self._relearn(memory)

    def forget_object(self, name: str) -> Self:
        """Forget one object; the others are as before.

        Raises
        ------
        ValueError
            If it is not known, or fewer than two would remain.
        """
        self._check_fitted()
        name = check_option("name", self._spelt(name), self._names())
        return self._relearn(self.memory_.without([name]))

    def remount(self, touches: Touches) -> Self:
        """Get used to another session: mounted anew, another day, light or device.

        Parameters
        ----------
        touches : Touches
            The first touches of the session. With labels they are confirmed: they tell
            what the session does to touches, and join the training touches. Without
            the column of labels they are only taken for what they may be: enough where
            there are some ten of several objects. Images of a dome may have another
            shape, and a frame of no contact tells where the rim is, and what rest
            looks like.

        Returns
        -------
        ObjectRecogniser
            This one; `chosen_["remount"]` says what was found: `confirm` the labels of
            which no touch was confirmed, and `expected` between what shares were right
            in rehearsed sessions with one touch of each confirmed.

        Raises
        ------
        ValueError
            A label was not learnt, no touch shows contact, or images that are looked at
            as they are have another shape.

        Notes
        -----
        1. A dome's disc is found in the new images, and cut as large in proportion.
        2. Where training sessions met the same objects, what each adds to the features
           is taken off, and how they differ is weighed down, as far as that helps with
           sessions left out whole.
        3. The new session's features are moved to where the training touches of the
           same objects lie, less what chance would move (docs/explanation/sessions.md).
        4. Confirmed touches count as other training touches do, or less (1/4, 1/16,
           1/64), as they tell each other best.
        5. One object alone is believed all, half or not at all, as rehearsed sessions
           tell (`trust`); of more objects the doubt is shared out.
        """
        self._check_fitted()
        new = self._as_touches(touches)
        labels = new.object if self.label == "object" else new.category
        by_name = dict(zip(self._names(), self.classes_, strict=True))
        if labels is not None and by_name.keys() >= set(labels.tolist()):
            labels = np.array([by_name[name] for name in labels.tolist()])
        rehearsal = self.chosen_.get("rehearsal", {})
        trust = rehearsal.get("trust", 1.0)
        learnt, remount_report = remounted(self.learnt(), new, labels, trust)
        self.serve(learnt)
        if "confirmed" in rehearsal:
            remount_report["expected"] = list(rehearsal["confirmed"])
        self.chosen_ = {**self.chosen_, "remount": remount_report}
        self._mounting = None
        return self

    def learn_nuisance(self, touches: Touches) -> int:
        """Weigh down what tells sessions from each other and not objects.

        Parameters
        ----------
        touches : Touches
            Of any objects, known or not, each met in several sessions (columns
            `object` and `session`), 20 differences at least.

        Returns
        -------
        int
            How many differences between sessions they showed.
        """
        learnt, n_differences = without_nuisance(self.learnt(), as_touches(touches))
        self.serve(learnt)
        return n_differences

    def across_sessions(self) -> dict[str, Any]:
        """Return what the training touches say of another day, as plain values.

        `sessions` per object (least and median), `asked` (touches of objects that
        another session met too) and, where there are any, `expected`: the accuracy
        after one touch of a session that told nothing but the encoding. `rehearsed`:
        between what accuracies it was in rehearsed sessions, where those were drawn;
        `confirmed`: in these with one touch of each object confirmed, before it joins
        the training touches.
        """
        return across_sessions(self.learnt(), self.chosen_.get("rehearsal", {}))

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches, each with its block left out.

        Shape (n_left_out, n_objects), of the rows `left_out_rows` of `memory_`; touches
        without contact are recognised like any other.
        """
        self._check_fitted()
        return left_out_log_likelihood(self.classifier_)

    def _left_out_counted(self) -> Floats:
        """Return the same, in which touches that do not count say nothing."""
        nothing = self.memory_.nothing[self.left_out_rows]
        return self._contact_only(self.left_out_log_likelihood(), nothing)

    def _left_out_with_contact(self) -> tuple[Floats, Indices]:
        """Return the same of touches that count, and the columns of their labels."""
        rows, memory = self.left_out_rows, self.memory_
        counts = ~memory.nothing[rows] | self.uses_no_contact_
        codes = np.searchsorted(self.classes_, memory.labels[rows[counts]])
        return self.left_out_log_likelihood()[counts], codes

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches were left out, (n_left_out,): all but of very many."""
        self._check_fitted()
        return self.classifier_.left_out_rows

    def learnt(self) -> Learnt:
        """Return what was learnt of touches, before beliefs are made of it."""
        self._check_fitted()
        return Learnt(
            encoder=self.encoder_,
            contact=self.contact_,
            classifier=self.classifier_,
            memory=self.memory_,
            uses_no_contact=self.uses_no_contact_,
        )

    def fit_pose(self, touches: Touches, pitch_mm: float | None = None) -> Self:
        """Learn also where and how parts lie on a pressure array.

        Parameters
        ----------
        touches : Touches
            The training touches; a column `angle_deg` fixes what is reported as 0.
        pitch_mm : float, optional
            Distance of neighbouring taxels in mm; by default the touches' own
            `set_pitch_mm`.

        Raises
        ------
        ValueError
            If no pitch is known.
        """
        self._check_fitted()
        touches = as_touches(touches)
        pitch = touches.whole.get("set_pitch_mm") if pitch_mm is None else pitch_mm
        if pitch is None:
            raise ValueError(
                "pitch_mm must be given to learn poses, got None, and the touches have "
                "no 'set_pitch_mm'; pass the distance of neighbouring taxels."
            )
        self.pose_ = PressPose(pitch_mm=float(pitch)).fit(
            touches.images,
            _memory.training_labels(touches, self.label)[0],
            touches.columns.get("angle_deg"),
        )
        return self

    def learn_modality(
        self,
        name: str,
        X: ArrayLike,
        y: ArrayLike,
        *,
        groups: ArrayLike | None = None,
        classifier: Any = None,
    ) -> Self:
        """Learn another sense of the same objects, such as photographs.

        It enters a belief by `Belief.update_sense`; a belief without it is as before.

        Parameters
        ----------
        name : str
            What to call it, such as "sight".
        X, y : array-like of shape (n_examples, n_features) and (n_examples,)
            Examples and labels; objects without examples are neither favoured nor
            ruled out.
        groups : array-like of shape (n_examples,), optional
            Examples that resemble each other are left out together to find how
            their evidence adds up.
        classifier : classifier with `predict_proba`, optional
            See `Modality`.
        """
        self._check_fitted()
        modality = Modality(classifier, random_state=self.random_state)
        modality.fit(X, y, groups)
        self.modalities_ = {**self.modalities_, _memory.check_name(name): modality}
        return self

    def left_out_groups(self, touches: Touches | TouchSource) -> Indices:
        """Return which touches learning from these leaves out together, (n_touches,).

        Groups as of `fit`: persons, else sessions, else blocks of each recording; where
        categories are learnt, objects.
        """
        labels, objects = _memory.training_labels(touches, self.label)
        return _memory.left_out_groups(touches, labels, objects, self.label)

    def remember_sensor(self, values: Mapping[str, Any] | None) -> Self:
        """Keep what the sensor was like, as plain values; it travels with the model."""
        self._check_fitted()
        self.memory_ = replace(self.memory_, sensor=values)
        return self

    def _memory_of(
        self, name: str, touches: Touches | TouchSource, least: int
    ) -> Memory:
        checked = touches
        if not isinstance(touches, TouchSource):
            checked = self._as_touches(touches)
        _memory.check_name(name)
        if len(checked) < least:
            raise ValueError(
                f"{name!r} must have at least {least} touches, got {len(checked)}."
            )
        labels = np.full(len(checked), self._as_label(name))
        objects: Array = labels
        blocks = _memory.blocks_in_order(labels, checked.order)
        if self.label == "category" and checked.object is not None:
            objects = checked.object
            blocks = _memory.left_out_groups(checked, labels, objects, self.label)
        encoding = encoded(self.encoder_, self.contact_, checked)
        memory = memory_of(checked, encoding, labels, objects, blocks)
        return memory.with_copies_together()

    def _validated_input(self, X: Any, y: Any) -> tuple[Any, Any]:
        """Return what `fit` is given; feature vectors as touches without geometry."""
        for name in {"n_features_in_", "feature_names_in_"} & vars(self).keys():
            delattr(self, name)
        X = unmasked("X", X)
        if isinstance(X, list) and X and isinstance(X[0], Touches):
            X = as_touches(X)
        if isinstance(X, Touches | TouchSource) or n_axes(X) != 2:
            return X, y
        vectors, labels = validate_data(
            self, X, y, dtype=np.float64, ensure_min_samples=2
        )
        check_targets(labels)
        return without_places(vectors), labels

    def _as_touches(self, X: Any) -> Touches:
        """Return touches, or what is like what `fit` saw, as touches."""
        if isinstance(X, Touches) or not hasattr(self, "n_features_in_"):
            return as_touches(X, self.encoder_.channels_)
        X = unmasked("X", X)
        return without_places(validate_data(self, X, reset=False, dtype=np.float64))

    def _spelt(self, name: str) -> str:
        """Return a name as it was learnt, else in the one spelling of `Touches`."""
        if name in self._names() or not isinstance(name, str):
            return name
        return one_spelling(name) or name

    def _as_label(self, name: str) -> Any:
        """Return a name as a label of the kind of the known ones."""
        dtype, names = self.memory_.labels.dtype, self._names()
        if dtype.kind == "U":
            return name
        if name in names:
            return self.classes_[names.index(name)]
        try:
            label = dtype.type(name)
        except (OverflowError, ValueError) as error:
            raise ValueError(
                f"name must be a number like the known labels, of {dtype}, got "
                f"{name!r}."
            ) from error
        if label in self.classes_:
            raise ValueError(
                f"name must be new, got {name!r}, which as {dtype} is the known label "
                f"{label}. Add touches to that with extend_object, or learn texts."
            )
        return label

    def _relearn(self, memory: Memory) -> Self:
        """Learn a memory with the encoding and the choices made; all or nothing."""
        refuse_too_large(memory.labels, self.max_memory_gb)
        if len(memory.classes) < 2:
            raise ValueError(
                "At least two objects must remain, got only "
                f"{memory.classes.tolist()}. Add another object first."
            )
        self.serve(self.learnt().relearnt(memory))
        if remount := self.chosen_.get("remount"):
            names = self._names()
            confirm = [name for name in remount.get("confirm", ()) if name in names]
            self.chosen_ = {**self.chosen_, "remount": {**remount, "confirm": confirm}}
        return self

    def serve(self, learnt: Learnt) -> Self:
        """Recognise by what was learnt from now on; all or nothing."""
        refuse_too_large(learnt.memory.labels, self.max_memory_gb)
        later = copy(self)
        later.encoder_, later.contact_ = learnt.encoder, learnt.contact
        later.classifier_ = learnt.classifier
        if learnt.memory is not self.memory_:
            with on_one_thread():
                later._calibrate(learnt.memory, self.memory_.nearest)
        self.__dict__.update(vars(later))
        return self

    def _calibrate(self, memory: Memory, before: Nearest | None = None) -> None:
        preset = find_preset(self.preset)
        self.memory_, self.classes_ = memory, memory.classes
        self.floor_ = preset.floor if self.floor is None else float(self.floor)
        self.uses_no_contact_ = not preset.skips_no_contact or consists_of_nothing(
            memory.labels, memory.nothing
        )
        self.sequence_calibration_ = _evidence.SequenceCalibration()
        if preset.calibrates_sequence:
            rows = self.left_out_rows
            self.sequence_calibration_ = fit_sequence_calibration(
                with_floor(self._left_out_counted(), self.floor_),
                np.searchsorted(self.classes_, memory.labels[rows]),
                self._episodes_to_come(memory, memory.blocks[rows]),
                self._log_prior(memory),
            )
        self.strangers_ = self._learnt_strangers(before)

    def _episodes_to_come(
        self, memory: Memory, blocks: Indices | None = None
    ) -> list[Indices]:
        """Return left-out touches such as an episode may have, of each object."""
        objects, n_known = memory.objects[self.left_out_rows], len(self.classes_)
        return draw_episodes(objects, self.random_state, n_known, blocks)

    def _learnt_strangers(self, before: Nearest | None = None) -> StrangerModel:
        memory = self.memory_
        # As they are: bounded, all objects but one may tie, and then nothing is left
        # of what a touch says without it.
        parts = without_gaps(self.classifier_.left_out_by_part())
        each = np.swapaxes(log_softmax(parts, axis=-1), 0, 1)
        weights = np.array([*self.classifier_.part_weights.values()])
        rows = self.left_out_rows
        uncorrected = self._contact_only(weights @ each, memory.nothing[rows])
        pool = self.classifier_ if isinstance(self.classifier_, EncodingPool) else None
        if pool is not None and pool.scaling_ is None:
            pool = None
        left_out = LeftOut(
            log_likelihood=uncorrected if pool is None else self._left_out_counted(),
            uncorrected=uncorrected,
            pool=pool,
            each=each,
            log_distances=memory.nearest.left_out(rows, before),
            codes=np.searchsorted(self.classes_, memory.labels[rows]),
            log_prior=self._log_prior(memory),
            floor=self.floor_,
            calibration=self.sequence_calibration_,
            weights=weights / max(weights.sum(), 1e-12),
            categories=self._category_of(memory),
        )
        episodes = self._episodes_to_come(memory)
        return fit_strangers(left_out, episodes, *memory.units)

    def _category_of(self, memory: Memory) -> NDArray[np.str_]:
        if self.label == "category":
            return np.full(len(memory.classes), "")
        return memory.category_of

    def _contact_only(self, log_likelihood: Floats, nothing: Bools) -> Floats:
        """Let touches without contact say nothing, unless a label consists of them."""
        if self.uses_no_contact_:
            return log_likelihood
        return np.where(nothing[:, np.newaxis], 0.0, log_likelihood)

    def _log_prior(self, memory: Memory) -> Floats:
        counts = np.unique(memory.labels, return_counts=True)[1]
        if self.prior == "uniform":
            return np.full(len(counts), -np.log(len(counts)))
        return np.asarray(np.log(counts / counts.sum()))

    def _names(self) -> list[str]:
        return [str(name) for name in self.classes_]

    def _check_parameters(self) -> Preset:
        check_option("label", self.label, ("object", "category"))
        check_option("prior", self.prior, ("uniform", "counts"))
        check_option("presentation", self.presentation, PRESENTATIONS)
        if self.floor is not None:
            check_number("floor", self.floor, low=0, high=0.5)
        if self.random_state is not None:
            check_count("random_state", self.random_state, at_least=0)
        return resolved_preset(self.preset, self.encodings, self.classifier)

    def _check_fitted(self) -> None:
        if not hasattr(self, "memory_"):
            raise NotFittedError("It has learnt nothing yet; call fit first.")


def n_axes(X: Any) -> int:
    """Return how many axes an array-like has, sparse ones and data frames too."""
    return int(X.ndim) if hasattr(X, "ndim") else np.asarray(X).ndim


def without_places(vectors: Floats) -> Touches:
    """Return feature vectors (n_touches, n_features) as touches without geometry."""
    return Touches(vectors[:, np.newaxis], geometry="none")
