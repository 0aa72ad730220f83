"""Touches -> object: the recogniser that learns touch by touch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import NotFittedError
from sklearn.utils import Tags
from sklearn.utils.validation import validate_data

from .._checks import check_count, check_number, check_option, unmasked
from .._extras import needed
from .._numbers import log_softmax
from .._parallel import on_one_thread, opencv_on_one_thread, results_of
from .._types import Array, Bools, Floats, Indices
from ..classifiers import (
    EncodingPool,
    KernelRidgeClassifier,
    TouchClassifier,
    as_groups,
    check_targets,
)
from ..images import Poses, PressPose
from ..touches import Touches, TouchSource
from . import _evidence, _memory
from ._alarm import MountingCheck, check_mounting, rim_moved
from ._belief import STRANGERS, Belief, Judge, Level
from ._calibration import (
    draw_episodes,
    fit_sequence_calibration,
    left_out_log_likelihood,
    without_gaps,
)
from ._contact import NO_CONTACT, consists_of_nothing, encoded_and_flagged
from ._encoder import BATCH, TouchEncoder
from ._episode import Episode
from ._evidence import Evidence, as_touches
from ._learning import encoded, learn_encoding, memory_of, refuse_too_large
from ._learnt import Learnt
from ._memory import Memory, Nearest
from ._model_checks import MOST_TRIED, check_parts, try_one_touch
from ._model_file import ModelFileError, read_model, write_model
from ._presets import (
    PRESENTATIONS,
    Label,
    Presentation,
    Preset,
    PresetName,
    find_preset,
    opened,
)
from ._rehearsal import rehearse, said_of_rehearsal
from ._remounted_encoder import RemountedEncoder
from ._remounting import remounted, without_nuisance
from ._senses import Modality
from ._stranger_curves import LeftOut, fit_strangers
from ._strangers import StrangerModel
from ._user_encoding import Encoding, UserEncoding, user_encodings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Touches of one task; a multiple of the encoder's batches, for the same results.
SHARD = 4 * BATCH
# Of more objects a picture has no names.
MOST_LABELLED = 30


class ObjectRecogniser(ClassifierMixin, BaseEstimator):
    """Learns objects from labelled touches and recognises them touch by touch.

    It keeps scikit-learn's contract for classifiers of images: `clone`,
    `cross_val_score`, `GridSearchCV` and `Pipeline` take it.

    Parameters
    ----------
    preset : {"default", "corradi2015", "liu2014"} or None, default="default"
        "default" (our best), or a paper as written: "corradi2015" (many touches
        of a dome) or "liu2014" (one press on an array). None has no encodings but
        `encodings`, which then get images as they are.
    encodings : mapping of str to transformer or list of transformers, optional
        Encodings of the user's own, by name, beside those of "default": any
        transformers of images, such as `OnnxEncoding`; of several steps the first
        takes images. They get images as cleaned for "default" (of a dome, the disc
        about its rim) and are weighed, or dropped, like the others.
    classifier : classifier, optional
        What learns the features, in place of the preset's: a `TouchClassifier`, or any
        classifier of scikit-learn with `predict_proba`. Model files can only hold
        palpate's own.
    label : {"object", "category"}, default="object"
        Which column of the touches is recognised. With "category" an episode is
        still the touches of one object.
    floor : float or None, default=None
        Least probability, shared by all objects, that one touch may leave to
        them; None takes the preset's, 0 lets one touch rule an object out.
    prior : {"uniform", "counts"}, default="uniform"
        Before the first touch all objects are equally probable, or as probable
        as they were frequent in training.
    presentation : {"auto", "any", "turned", "shifted", "fixed"}, default="auto"
        How objects come to the sensor: at any angle and place, at any angle, at any
        place, or always the same; "auto" finds out from the training touches, and
        `chosen_` says what it found. For the preset "default".
    rehearse : bool, default=True
        Whether some touches are seen again as in invented sessions (other gains, zeros,
        places), so that another day costs less; how far that counts is found out, and
        `chosen_["rehearsal"]` says it. For the classifier of the preset "default".
    random_state : int, default=0
        Seed of the drawn episodes that calibrate the belief.

    Attributes
    ----------
    classes_ : ndarray of shape (n_objects,)
        The labels, sorted; the columns of `log_likelihood`.
    encoder_ : TouchEncoder or RemountedEncoder
        Clean-up and encodings; after `remount`, with what takes the session off.
    classifier_ : TouchClassifier
        Features -> log-likelihoods.
    memory_ : Memory
        What is kept of the training touches.
    contact_ : ContactCheck
        Tells touches without contact.
    uses_no_contact_ : bool
        Whether touches without contact count: where a label consists of them.
    sequence_calibration_ : SequenceCalibration
        How touches of one episode add up.
    strangers_ : StrangerModel
        What tells a thing that was never learnt.
    floor_ : float
        The floor in use.
    chosen_ : dict
        What the preset chose for these touches, and why.
    pose_ : PressPose or None
        Where parts lie on a pressure array, after `fit_pose`.
    modalities_ : dict of str to Modality
        Other senses, after `learn_modality`.
    n_features_in_, feature_names_in_
        As in scikit-learn, where `fit` saw feature vectors.
    max_memory_gb : float, class attribute, default=8.0
        What would take more memory to learn, by an estimate, is refused.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.recognition import ObjectRecogniser
    >>> images = np.random.default_rng(0).random((40, 3, 24))
    >>> images[:20] += 1
    >>> touches = Touches(images, object=["pen"] * 20 + ["mug"] * 20, geometry="none")
    >>> belief = ObjectRecogniser().fit(touches).start()
    >>> belief.update(touches[:3]).best
    'pen'
    """

    max_memory_gb: ClassVar[float] = 8.0
    encoder_: TouchEncoder | RemountedEncoder
    classifier_: TouchClassifier
    memory_: Memory

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
            fewer than two touches; or it would take too much memory.
        """
        preset = self._check_parameters()
        X, y = self._seen(X, y)
        touches = _memory.labelled(X, y, self.label)
        labels, objects = _memory.training_labels(touches, self.label)
        if y is not None and self.label == "object":
            labels = objects = np.asarray(y)
        refuse_too_large(labels, self.max_memory_gb)
        if groups is None:
            blocks = _memory.left_out_groups(touches, labels, objects, self.label)
        else:
            blocks = as_groups(groups, len(labels))
        with on_one_thread():
            encoder, contact, chosen, encoding = learn_encoding(
                preset, touches, labels, blocks, self.presentation
            )
            if groups is None:
                blocks = _memory.without_copies(encoding.features, objects, blocks)
            memory = memory_of(touches, encoding, labels, objects, blocks)
            self.encoder_, self.contact_, self.chosen_ = encoder, contact, chosen
            self.classifier_ = preset.classifier(encoder).fit(
                memory.features, memory.labels, groups=memory.blocks
            )
            if self.rehearse and isinstance(self.classifier_, EncodingPool):
                self.classifier_, weighed = rehearse(
                    self.classifier_,
                    encoder,
                    memory,
                    touches,
                    chosen["geometry"],
                    self.random_state,
                )
                chosen["rehearsal"] = weighed
                chosen["found"] = [*chosen.get("found", ()), said_of_rehearsal(weighed)]
            if len(self.classifier_.part_weights) > 1:
                chosen["weights"] = dict(self.classifier_.part_weights)
            self._calibrate(memory)
        self.pose_: PressPose | None = None
        self.modalities_: dict[str, Modality] = {}
        self._mounting = None
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
        touch is enough. With `most` no more touches of it are kept: of its sessions
        the same number where there are enough, of each the newest, so that what is
        met again every day neither grows for ever nor forgets its first days.
        """
        self._check_fitted()
        check_option("name", name, self._names())
        memory = self.memory_.plus(self._memory_of(name, touches, 1))
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
        forget : iterable of str
            Names that are forgotten; unknown ones are passed over.

        Raises
        ------
        ValueError
            If fewer than two objects would remain, or labels are missing.
        """
        self._check_fitted()
        memory = self.memory_.without(forget)
        if touches is not None:
            labels = _memory.named_labels(touches, self.label)
            for name in np.unique(labels).tolist():
                of_object = touches[np.flatnonzero(labels == name)]
                memory = memory.replaced(self._memory_of(name, of_object, 2))
        return self._relearn(memory)

    def forget_object(self, name: str) -> Self:
        """Forget one object; the others are as before.

        Raises
        ------
        ValueError
            If it is not known, or fewer than two would remain.
        """
        self._check_fitted()
        check_option("name", name, self._names())
        return self._relearn(self.memory_.without([name]))

    def remount(self, touches: Touches) -> Self:
        """Get used to another session: mounted anew, another day, light or device.

        Parameters
        ----------
        touches : Touches
            The first touches of the session. With labels they are confirmed: they tell
            what the session does to touches, and join the training touches. Without
            the column of labels they are only taken for what they may be: enough where
            there are some ten of several objects. Images may have another shape, and
            a frame of no contact tells where the rim is, and what rest looks like.

        Returns
        -------
        ObjectRecogniser
            This one; `chosen_["remount"]` says what was found: `confirm` the labels of
            which no touch was confirmed, and `expected` between what shares were right
            in rehearsed sessions with one touch of each confirmed.

        Raises
        ------
        ValueError
            A label was not learnt, or no touch shows contact.

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
        self._check_fitted()
        learnt, n_differences = without_nuisance(self.learnt(), as_touches(touches))
        self.serve(learnt)
        return n_differences

    def check_mounting(self, touches: Touches | Evidence) -> MountingCheck:
        """Tell whether touches come from a session like those it was taught in.

        Some ten touches, or the evidence of them, of several objects if possible;
        labels are not used. Of sessions like those of training about one in twenty is
        called changed. Beliefs begun afterwards say so too (`Belief.promise`, `why`),
        until the next check or `remount` with labels; files do not keep it.
        """
        self._check_fitted()
        rim: list[str] = []
        if not isinstance(touches, Evidence):
            new = self._as_touches(touches)
            touches, rim = self.evidence(new), rim_moved(self.encoder_, new)
        check = check_mounting(self.learnt(), touches, rim, self.random_state)
        self._mounting = check
        return check

    def predict(self, X: Touches | ArrayLike) -> Array:
        """Return the most probable label after each touch alone, (n_touches,)."""
        best = self.predict_log_proba(X).argmax(axis=1)
        return np.asarray(self.classes_[best])

    def predict_proba(self, X: Touches | ArrayLike) -> Floats:
        """Return the belief after each touch alone, shape (n_touches, n_objects)."""
        return np.exp(self.predict_log_proba(X))

    def predict_log_proba(self, X: Touches | ArrayLike) -> Floats:
        """Return the log belief after each touch alone, (n_touches, n_objects)."""
        self._check_fitted()
        log_likelihood = self.log_likelihood(self._as_touches(X))
        floored = _evidence.with_floor(log_likelihood, self.floor_)
        alone = floored[:, np.newaxis]
        return _evidence.log_posteriors(
            alone, self.log_prior(), self.sequence_calibration_
        )[:, 0]

    def score(
        self,
        X: Touches | ArrayLike,
        y: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Return the share of single touches that are recognised.

        `y` (n_touches,) are the labels, by default the touches' own.
        """
        truth = y
        if y is None:
            truth = _memory.named_labels(self._as_touches(X), self.label)
        return float(super().score(X, truth, sample_weight))

    def log_likelihood(self, touches: Touches) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_objects), columns as in `classes_`; neither floor nor
        sequence calibration is in it yet. The row of a touch without contact is all
        zeros, see `uses_no_contact_`.
        """
        return self.evidence(touches).log_likelihood

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches, each with its block left out.

        Shape (n_left_out, n_objects), of the rows `left_out_rows` of `memory_`; touches
        without contact are recognised like any other.
        """
        self._check_fitted()
        return left_out_log_likelihood(self.classifier_)

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches were left out, (n_left_out,): all but of very many."""
        self._check_fitted()
        return self.classifier_.left_out_rows

    def evidence(self, touches: Touches | ArrayLike) -> Evidence:
        """Return all that touches tell; see `Evidence`.

        Many touches are encoded in shards of 1024, wherever `joblib.parallel_config`
        says.
        """
        self._check_fitted()
        seen = touches if isinstance(touches, Touches) else self._one_or_more(touches)
        if len(seen) <= SHARD:
            return self._evidence_of(seen)

        def shard(number: int) -> tuple[Touches]:
            return (seen[number * SHARD : (number + 1) * SHARD],)

        n_shards = -(-len(seen) // SHARD)
        return Evidence.together([*results_of(self._evidence_of, n_shards, shard)])

    def log_prior(self) -> Floats:
        """Return the log prior of the objects (nats), shape (n_objects,)."""
        self._check_fitted()
        return self._log_prior(self.memory_)

    def start(
        self,
        prior: Mapping[str, float] | None = None,
        strangers: float = STRANGERS,
    ) -> Belief:
        """Return the belief before the first touch of an episode.

        Parameters
        ----------
        prior : mapping of str to float, optional
            How probable each object is, all of them, positive; brought to sum 1. By
            default as the parameter `prior` says.
        strangers : float, default=0.05
            The share of episodes with something that was never learnt, at least 0 and
            below 1. 0 is a closed world, such as the parts of one line or the tools of
            a drawer: it is always one of the learnt objects.
        """
        judge = self.judge()
        log_prior = (
            None if prior is None else _evidence.given_prior(prior, judge.classes)
        )
        return Belief(judge, self.evidence, log_prior, strangers)

    def episode(
        self,
        *,
        error: float = 0.01,
        refusal: float | None = None,
        level: Level = "object",
        strangers: float = STRANGERS,
        prior: Mapping[str, float] | None = None,
    ) -> Episode:
        """Return an episode that takes touches, decides and keeps what each told.

        Parameters
        ----------
        error, refusal, level
            As for `Belief.decide`.
        strangers, prior
            As for `start`.
        """
        belief = self.start(prior, strangers)
        return Episode(belief, error=error, refusal=refusal, level=level)

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

    def judge(self) -> Judge:
        """Return what beliefs are made by."""
        self._check_fitted()
        check = self._mounting
        remount = self.chosen_.get("remount", {})
        unconfirmed = not remount.get("labelled", True) or bool(remount.get("confirm"))
        return Judge(
            classes=self.classes_.astype(str),
            log_prior=self.log_prior(),
            floor=self.floor_,
            sequence_calibration=self.sequence_calibration_,
            strangers=self.strangers_,
            senses=self.modalities_,
            categories=self._category_of(self.memory_),
            memory=self.memory_,
            other_session=unconfirmed or (check is not None and check.changed),
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

    def pose(self, touches: Touches, labels: ArrayLike) -> Poses:
        """Return place and angle of presses of known parts; see `PressPose.estimate`.

        Parameters
        ----------
        touches : Touches
            Presses on the array that the poses were learnt on.
        labels : array-like of shape (n_touches,)
            What each is taken for.

        Raises
        ------
        ValueError
            If poses were not learnt, or a label was not among them.
        """
        self._check_fitted()
        if self.pose_ is None:
            raise ValueError(
                "This recogniser has learnt no poses; `ObjectRecogniser.fit_pose` "
                "learns them."
            )
        return self.pose_.estimate(touches.images, labels)

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

    def remember_sensor(self, values: Mapping[str, Any] | None) -> Self:
        """Keep what the sensor was like, as plain values; it travels with the model."""
        self._check_fitted()
        self.memory_ = replace(self.memory_, sensor=values)
        return self

    def summary(self) -> dict[str, Any]:
        """Return what was learnt, as plain values for people and for JSON."""
        self._check_fitted()
        return {
            "preset": self.preset,
            "label": self.label,
            "n_labels": len(self.classes_),
            "n_train_touches": len(self.memory_),
            "n_features": self.memory_.features.shape[1],
            "labels": self._names(),
            "chosen": self.chosen_,
        }

    def plot_confusion(self, ax: Axes | None = None) -> Axes:
        """Draw what training touches are taken for, each with its block left out.

        A row for each object, whose shares (%) sum to 100: of its touches that show
        contact, one at a time. Returns matplotlib's axes (extra `plot`), `ax` or new
        ones.
        """
        self._check_fitted()
        pyplot = needed("matplotlib.pyplot", "plot", "A picture of confusions")
        counts = self._confusion()
        shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        side = float(np.clip(1.5 + 0.3 * len(shares), 3.5, 9))
        axes = ax
        if axes is None:
            axes = pyplot.subplots(figsize=(side, side), layout="constrained")[1]
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
        right = np.trace(counts) / max(counts.sum(), 1)
        title = f"Touches left out, one at a time: {right:.0%} right"
        axes.set(xlabel="taken for", ylabel="object", title=title)
        places = range(len(shares)) if len(shares) <= MOST_LABELLED else []
        names = self._names() if places else []
        axes.set_xticks(places, names, rotation=90)
        axes.set_yticks(places, names)
        for row, col in np.argwhere(shares >= 1) if places else ():
            colour = "white" if shares[row, col] > 50 else "black"
            label = f"{shares[row, col]:.0f}"
            axes.text(col, row, label, ha="center", va="center", color=colour, size=7)
        return axes

    def save(self, path: str | Path) -> Path:
        """Write the recogniser to a `.palpate` file, all or nothing."""
        self._check_fitted()
        stored = copy(self)
        stored.encodings = None  # they are in the encoder, as they were learnt
        return write_model(path, stored, self._user_encodings())

    @classmethod
    def load(
        cls, path: str | Path, *, encodings: Mapping[str, Encoding] | None = None
    ) -> Self:
        """Read a recogniser from a `.palpate` file; nothing in it is executed.

        Parameters
        ----------
        path : path
            The file.
        encodings : mapping of str to transformer or list of transformers, optional
            Encodings that are code of the user's own, which a file cannot hold, as
            they were given to learn it. What they had learnt comes from the file; what
            could not be written there (a network of torch) they must still have.

        Raises
        ------
        ModelFileError
            If the file is missing, damaged, of another version, or no recogniser, or
            an encoding is missing or not the one it was learnt with.
        """
        model = read_model(path, cls, user_encodings(encodings))
        if not isinstance(model, cls):
            raise ModelFileError(f"{path} holds no object recogniser.")
        try:
            model.encodings = model._user_encodings() or None
            for encoding in model._user_encodings().values():
                encoding.check_again()
            model._check_parameters()
            if not hasattr(model, "strangers_"):  # written by palpate 0.2 or older
                model.strangers_ = model._learnt_strangers()
            check_parts(model.judge(), model.encoder_, model.pose_)
            if isinstance(model.classifier_, EncodingPool | KernelRidgeClassifier):
                model.classifier_.resume(model.memory_.features, model.memory_.labels)
            if prod(model.encoder_.image_shape_) <= MOST_TRIED:
                with np.errstate(all="ignore"):
                    blank = model.evidence(model.encoder_.blank_touch())
                    row = model.classifier_.log_likelihood(blank.features)
                    try_one_touch(model.start(), blank, row)
        except Exception as error:
            raise ModelFileError(f"{path} is damaged: {error}. Learn again.") from error
        return model

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
        objects_of_touches = checked.object if labels.dtype.kind == "U" else None
        objects = labels if objects_of_touches is None else objects_of_touches
        encoding = encoded(self.encoder_, self.contact_, checked)
        blocks = _memory.blocks_in_order(labels, checked.order)
        blocks = _memory.without_copies(encoding.features, labels, blocks)
        return memory_of(checked, encoding, labels, objects, blocks)

    def _confusion(self) -> Indices:
        """Return how many left-out touches of each object are taken for each."""
        rows = self.left_out_rows
        counted = ~self.memory_.nothing[rows] | self.uses_no_contact_
        best = self.left_out_log_likelihood()[counted].argmax(axis=1)
        true_columns = np.searchsorted(
            self.classes_, self.memory_.labels[rows[counted]]
        )
        counts = np.zeros((len(self.classes_),) * 2, dtype=np.intp)
        np.add.at(counts, (true_columns, best), 1)
        return counts

    def _user_encodings(self) -> dict[str, UserEncoding]:
        """Return the encodings of the user's own that are in use, as learnt."""
        learnt = self.encoder_.encodings_.values()
        all_steps = [step for steps in learnt for step in steps]
        return {step.name: step for step in all_steps if isinstance(step, UserEncoding)}

    def _seen(self, X: Any, y: Any) -> tuple[Any, Any]:
        """Return what `fit` is given; feature vectors as touches without geometry."""
        for name in {"n_features_in_", "feature_names_in_"} & vars(self).keys():
            delattr(self, name)
        X = unmasked("X", X)
        of_touches = isinstance(X, list) and X and isinstance(X[0], Touches)
        if isinstance(X, Touches | TouchSource) or of_touches or _n_axes(X) != 2:
            return X, y
        vectors, labels = validate_data(
            self, X, y, dtype=np.float64, ensure_min_samples=2
        )
        check_targets(labels)
        return _without_places(vectors), labels

    def _as_touches(self, X: Any) -> Touches:
        """Return touches, or what is like what `fit` saw, as touches."""
        if isinstance(X, Touches) or not hasattr(self, "n_features_in_"):
            return as_touches(X, self.encoder_.channels_)
        X = unmasked("X", X)
        return _without_places(validate_data(self, X, reset=False, dtype=np.float64))

    def _one_or_more(self, touches: Any) -> Touches:
        """Return touches, or one or several of what `fit` saw, as touches."""
        alone = hasattr(self, "n_features_in_") and _n_axes(touches) == 1
        return self._as_touches(np.asarray(touches)[np.newaxis] if alone else touches)

    def _as_label(self, name: str) -> Any:
        """Return a name as a label of the kind of the known ones."""
        dtype = self.memory_.labels.dtype
        if dtype.kind == "U":
            return name
        try:
            return dtype.type(name)
        except ValueError as error:
            raise ValueError(
                f"name must be a number like the known labels, got {name!r}."
            ) from error

    def _relearn(self, memory: Memory) -> Self:
        """Learn a memory with the encoding and the choices made; all or nothing."""
        refuse_too_large(memory.labels, self.max_memory_gb)
        if len(memory.classes) < 2:
            raise ValueError(
                "At least two objects must remain, got only "
                f"{memory.classes.tolist()}. Add another object first."
            )
        return self.serve(self.learnt().relearnt(memory))

    def serve(self, learnt: Learnt) -> Self:
        """Recognise by what was learnt from now on."""
        refuse_too_large(learnt.memory.labels, self.max_memory_gb)
        same = learnt.memory is self.memory_
        before = self.memory_.nearest
        self.encoder_, self.contact_ = learnt.encoder, learnt.contact
        self.classifier_ = learnt.classifier
        if not same:
            with on_one_thread():
                self._calibrate(learnt.memory, before)
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
            self.sequence_calibration_ = fit_sequence_calibration(
                _evidence.with_floor(self._left_out(), self.floor_),
                np.searchsorted(self.classes_, memory.labels[self.left_out_rows]),
                self._episodes_to_come(memory, memory.blocks[self.left_out_rows]),
                self._log_prior(memory),
            )
        self.strangers_ = self._learnt_strangers(before)

    def _episodes_to_come(
        self, memory: Memory, blocks: Indices | None = None
    ) -> list[Indices]:
        """Return left-out touches such as an episode may have, of each object."""
        objects, n_known = memory.objects[self.left_out_rows], len(self.classes_)
        return draw_episodes(objects, self.random_state, n_known, blocks)

    def _left_out(self) -> Floats:
        """Return what counts of left-out training touches, (n_touches, n_objects)."""
        log_likelihood = left_out_log_likelihood(self.classifier_)
        return self._used(log_likelihood, self.memory_.nothing[self.left_out_rows])

    def _learnt_strangers(self, before: Nearest | None = None) -> StrangerModel:
        memory = self.memory_
        # As they are: bounded, all objects but one may tie, and then nothing is left
        # of what a touch says without it.
        parts = without_gaps(self.classifier_.left_out_by_part())
        each = np.swapaxes(log_softmax(parts, axis=-1), 0, 1)
        weights = np.array([*self.classifier_.part_weights.values()])
        rows = self.left_out_rows
        log_likelihood = self._used(weights @ each, memory.nothing[rows])
        left_out = LeftOut(
            log_likelihood=log_likelihood,
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

    def _evidence_of(self, touches: Touches) -> Evidence:
        with opencv_on_one_thread():
            features, flags = encoded_and_flagged(self.encoder_, self.contact_, touches)
            looks = self.encoder_.look(touches)
        return self.evidence_of(features, flags, looks)

    def evidence_of(
        self, features: Floats, flags: list[str], looks: Floats
    ) -> Evidence:
        """Return what features tell, (n_touches, n_features), with flags and looks."""
        parts = self.classifier_.log_likelihood_by_part(features)
        pooled, each = self.classifier_.pooled(parts), np.swapaxes(parts, 0, 1)
        used = self._used(pooled, np.array(flags) == NO_CONTACT)
        distances = self.memory_.nearest.log_distances(features)
        return Evidence(features, used, flags, each, distances, looks)

    def _used(self, log_likelihood: Floats, nothing: Bools) -> Floats:
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
        return opened(self.preset, self.encodings, self.classifier)

    def _check_fitted(self) -> None:
        if not hasattr(self, "memory_"):
            raise NotFittedError("It has learnt nothing yet; call fit first.")

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:
        """Return the parameters, and in a comment behind them what was learnt."""
        written = str(super().__repr__(N_CHAR_MAX=N_CHAR_MAX))
        if not hasattr(self, "strangers_"):
            return written
        names = self._names()
        few_names = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        kinds = "categories" if self.label == "category" else "objects"
        return (
            f"{written}  # knows {len(names)} {kinds} ({few_names}) from "
            f"{len(self.memory_)} touches by {self.chosen_['encoding']}"
        )

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.three_d_array = True
        tags.input_tags.allow_nan = True
        return tags


def adapt(recogniser: ObjectRecogniser, touches: Touches) -> ObjectRecogniser:
    """Return a copy of `recogniser` that was remounted with `touches`.

    What is done, and what is refused: `ObjectRecogniser.remount`.
    """
    return copy(recogniser).remount(touches)


def _n_axes(X: Any) -> int:
    """Return how many axes an array-like has, sparse ones and data frames too."""
    return int(X.ndim) if hasattr(X, "ndim") else np.asarray(X).ndim


def _without_places(vectors: Floats) -> Touches:
    """Return feature vectors (n_touches, n_features) as touches without geometry."""
    return Touches(vectors[:, np.newaxis], geometry="none")
