"""Touches -> object: the recogniser that learns touch by touch."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import ClassifierMixin
from sklearn.metrics import accuracy_score, confusion_matrix
from sklearn.utils import Tags

from .._checks import STRANGERS, listed
from .._numbers import with_floor
from .._parallel import opencv_on_one_thread, results_of
from .._types import Array, Floats
from ..classifiers import EncodingPool, KernelRidgeClassifier
from ..images import Poses
from ..touches import Touches
from . import _evidence, _memory
from ._alarm import MountingCheck, check_mounting, rim_moved
from ._belief import Belief, BeliefModel, Level
from ._contact import encoded_and_flagged
from ._encoder import BATCH
from ._episode import Episode
from ._evidence import NO_CONTACT, Evidence
from ._learner import Learner, n_axes
from ._model_checks import MOST_TRIED, check_parts, try_one_touch
from ._model_file import (
    ModelFileError,
    check_model_path,
    read_model,
    write_model,
)
from ._sentences import N_JUDGED, advice_of, draw_confusion
from ._user_parts import Encoding, UserEncoding, user_encodings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Touches of one task; a multiple of the encoder's batches, for the same results.
SHARD = 4 * BATCH
# Draws of touches that tell how well an object is known.
N_DRAWN = 40
# With so few objects 70 % of things never taught are named, and with so few touches of
# an object names are least sure: docs/explanation/page.md.
_FEW_OBJECTS, FEW_TOUCHES = 5, 10


class ObjectRecogniser(ClassifierMixin, Learner):
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
        now = copy(self)  # another thread may learn meanwhile
        best = now.predict_log_proba(X).argmax(axis=1)
        return np.asarray(now.classes_[best])

    def predict_proba(self, X: Touches | ArrayLike) -> Floats:
        """Return the belief after each touch alone, shape (n_touches, n_objects)."""
        return np.exp(self.predict_log_proba(X))

    def predict_log_proba(self, X: Touches | ArrayLike) -> Floats:
        """Return the log belief after each touch alone, (n_touches, n_objects)."""
        self._check_fitted()
        now = copy(self)
        log_likelihood = now.log_likelihood(now._as_touches(X))
        floored = with_floor(log_likelihood, now.floor_)
        used, how = _evidence.is_informative(floored), now.sequence_calibration_
        alone = used[:, np.newaxis], floored[:, np.newaxis]
        return _evidence.beliefs_after(*alone, now.log_prior(), how)[0][:, 0]

    def score(
        self,
        X: Touches | ArrayLike,
        y: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Return the share of single touches that are recognised.

        `y` (n_touches,) are the labels, by default the touches' own.
        """
        if y is not None:
            return float(super().score(X, y, sample_weight))
        truth = _memory.named_labels(self._as_touches(X), self.label)
        names = self.predict(X).astype(str)
        return float(accuracy_score(truth, names, sample_weight=sample_weight))

    def log_likelihood(self, touches: Touches) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_objects), columns as in `classes_`; neither floor nor
        sequence calibration is in it yet. The row of a touch without contact is all
        zeros, see `uses_no_contact_`.
        """
        return self.evidence(touches).log_likelihood

    def evidence(self, touches: Touches | ArrayLike) -> Evidence:
        """Return all that touches tell; see `Evidence`.

        Many touches are encoded in shards of 1024, wherever `joblib.parallel_config`
        says.
        """
        self._check_fitted()
        now = copy(self)
        seen = touches if isinstance(touches, Touches) else now._one_or_more(touches)
        if len(seen) <= SHARD:
            return now._evidence_of(seen)

        def shard(number: int) -> tuple[Touches]:
            return (seen[number * SHARD : (number + 1) * SHARD],)

        n_shards = -(-len(seen) // SHARD)
        return Evidence.together([*results_of(now._evidence_of, n_shards, shard)])

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
        # It goes on by what was learnt when it began, whatever is learnt meanwhile.
        now = copy(self)
        return Belief(now.belief_model(), now.evidence, prior, strangers)

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

    def belief_model(self) -> BeliefModel:
        """Return what a belief needs of this recogniser."""
        self._check_fitted()
        check = self._mounting
        remount = self.chosen_.get("remount", {})
        unconfirmed = not remount.get("labelled", True) or bool(remount.get("confirm"))
        return BeliefModel(
            classes=self.classes_.astype(str),
            log_prior=self.log_prior(),
            floor=self.floor_,
            sequence_calibration=self.sequence_calibration_,
            strangers=self.strangers_,
            senses=self.modalities_,
            categories=self._category_of(self.memory_),
            memory=self.memory_,
            other_session=unconfirmed or (check is not None and check.changed),
            uses_no_contact=self.uses_no_contact_,
        )

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
        images = _evidence.as_touches(touches).images
        return self.pose_.estimate(images, np.asarray(labels).astype(str))

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
        now = copy(self)
        log_likelihood, truth = now._left_out_with_contact()
        columns = np.arange(len(now.classes_))
        counts = confusion_matrix(truth, log_likelihood.argmax(axis=1), labels=columns)
        return draw_confusion(counts, now._names(), ax)

    def object_quality(self) -> list[dict[str, Any]]:
        """Return how often left-out touches of each object are recognised.

        By `name`: `n_touches` with contact; `after_one` and `after_eight`, shares of
        right answers after one touch and after eight drawn ones, None where there are
        not so many; `taken_for`, the most frequent wrong answer to one touch, or None.
        Each touch is asked as if it, and its neighbours, had not been taught: places
        that were never touched are not judged.
        """
        now = copy(self)  # another thread may learn meanwhile
        log_likelihood, codes = now._left_out_with_contact()
        log_likelihood, names = with_floor(log_likelihood, now.floor_), now._names()
        rng, result = np.random.default_rng(0), []
        for code, name in enumerate(names):
            rows = np.flatnonzero(codes == code)
            best = log_likelihood[rows].argmax(axis=1)
            answers = np.bincount(best, minlength=len(names))
            right, answers[code] = answers[code], 0
            drawn = rng.permuted(np.tile(rows, (N_DRAWN, 1)), axis=1)[:, :N_JUDGED]
            best = log_likelihood[drawn].sum(axis=1).argmax(axis=1)
            after_eight = float(np.mean(best == code))
            result.append(
                {
                    "name": name,
                    "n_touches": len(rows),
                    "after_one": float(right / len(rows)) if len(rows) else None,
                    "after_eight": after_eight if len(rows) >= N_JUDGED else None,
                    "taken_for": names[answers.argmax()] if answers.any() else None,
                }
            )
        return result

    def teaching_advice(
        self, qualities: list[dict[str, Any]] | None = None
    ) -> list[str]:
        """Return what to teach next, in sentences, of what `object_quality` returned.

        That is asked now, unless `qualities` are what it returned. Of objects that too
        few touches, one or eight, are right of, the worst first.
        """
        return advice_of(self.object_quality() if qualities is None else qualities)

    def limits_message(self, *, of_touches: bool = True) -> str:
        """Return what a name is worth where few objects, or touches, were learnt.

        Few touches count only with `of_touches`.
        """
        self._check_fitted()
        names, counts = np.unique(self.memory_.labels.astype(str), return_counts=True)
        sentences = []
        if len(names) <= _FEW_OBJECTS:
            kind = "objects" if self.label == "object" else "categories"
            sentences.append(
                f"It knows {len(names)} {kind} and nothing else: a thing that is none "
                "of them is often called by one of their names."
            )
        few = names[counts < FEW_TOUCHES].tolist()
        if few and of_touches:
            sentences.append(
                f"Of {listed(few, 3)} it learnt fewer than {FEW_TOUCHES} touches: a "
                "wrong name may look certain."
            )
        return " ".join(sentences)

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
                _check_as_learnt(encoding)
            model._check_parameters()
            if not hasattr(model, "strangers_"):  # written by palpate 0.2 or older
                model.strangers_ = model._learnt_strangers()
            check_parts(model.belief_model(), model.encoder_, model.pose_)
            if isinstance(model.classifier_, EncodingPool | KernelRidgeClassifier):
                model.classifier_.resume(model.memory_.features, model.memory_.labels)
            if prod(model.encoder_.image_shape_) <= MOST_TRIED:
                with np.errstate(all="ignore"):
                    blank = model.evidence(model.encoder_.blank_touch())
                    row = model.classifier_.log_likelihood(blank.features)
                    try_one_touch(model.start(), blank, row)
        except ModelFileError:
            raise
        except Exception as error:
            raise ModelFileError(f"{path} is damaged: {error}. Learn again.") from error
        return model

    @staticmethod
    def check_path(path: str | Path) -> Path:
        """Return `path` if `save` can write there, or explain (`ModelFileError`)."""
        return check_model_path(path)

    def _user_encodings(self) -> dict[str, UserEncoding]:
        """Return the encodings of the user's own that are in use, as learnt."""
        learnt = self.encoder_.encodings_.values()
        all_steps = [step for steps in learnt for step in steps]
        return {step.name: step for step in all_steps if isinstance(step, UserEncoding)}

    def _one_or_more(self, touches: Any) -> Touches:
        """Return touches, or one or several of what `fit` saw, as touches."""
        alone = hasattr(self, "n_features_in_") and n_axes(touches) == 1
        if alone and hasattr(self, "feature_names_in_") and hasattr(touches, "iloc"):
            return self._as_touches(touches.to_frame().T)  # a row, names and all
        return self._as_touches(np.asarray(touches)[np.newaxis] if alone else touches)

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
        used = self._contact_only(pooled, np.array(flags) == NO_CONTACT)
        distances = self.memory_.nearest.log_distances(features)
        return Evidence(features, used, flags, each, distances, looks)

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


def _check_as_learnt(encoding: UserEncoding) -> None:
    """Refuse an encoding that was given with a file and is not as it was learnt."""
    try:
        encoding.check_again()
    except Exception as error:
        raise ModelFileError(
            f"encodings[{encoding.name!r}] must be as it was learnt: "
            f"{str(error).rstrip('.')}. What a file cannot hold it must still have: "
            "give it as it was fitted."
        ) from error


def adapt(recogniser: ObjectRecogniser, touches: Touches) -> ObjectRecogniser:
    """Return a copy of `recogniser` that was remounted with `touches`.

    What is done, and what is refused: `ObjectRecogniser.remount`.
    """
    return copy(recogniser).remount(touches)
