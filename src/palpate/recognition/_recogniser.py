"""Touches -> object: the recogniser that learns touch by touch."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from .._checks import check_number, check_option
from ..touches import Touches
from ._belief import Belief, as_touches
from ._beside_touch import BesideTouch
from ._calibration import (
    calibrate,
    draw_all,
    left_out_log_likelihood,
    touch_log_likelihood,
)
from ._contact import NO_CONTACT, ContactCheck, consists_of_nothing
from ._encoder import BATCH
from ._known import KNOWN_CLASSES
from ._model_file import ModelFileError, read_model, write_model
from ._presets import Preset, find_preset
from ._sequence import Evidence, Floats, SequenceCalibration, given_prior, with_floor
from ._source import TouchSource, encoded, encoded_and_flagged, learn_encoding
from ._training import blocks_in_order, left_out_groups, training_labels
from ._trial_touch import try_one_touch
from ._unknown import UnknownScale

# Touches of one task; a multiple of the encoder's blocks, so that results are the same.
SHARD = 4 * BATCH
KEPT = ("features_", "labels_", "objects_", "blocks_", "nothing_", "unexplained_")


class ObjectRecogniser(BesideTouch, BaseEstimator):
    """Learns objects from labelled touches and recognises them touch by touch.

    Parameters
    ----------
    preset : str, default="default"
        "default" (our best), or a paper as written: "corradi2015" (many touches
        of a dome) or "liu2014" (one press on an array).
    label : {"object", "category"}, default="object"
        Which column of the touches is recognised. With "category" an episode is
        still the touches of one object.
    floor : float or None, default=None
        Least probability, shared by all objects, that one touch may leave to
        them; None takes the preset's, 0 lets one touch rule an object out.
    prior : {"uniform", "counts"}, default="uniform"
        Before the first touch all objects are equally probable, or as probable
        as they were frequent in training.
    random_state : int, default=0
        Seed of the drawn episodes that calibrate the belief.

    Attributes
    ----------
    classes_ : ndarray of str, shape (n_objects,)
        The labels, sorted; the columns of `log_likelihood`.
    encoder_ : TouchEncoder
        Clean-up and encodings.
    classifier_ : estimator
        Features -> log-likelihoods.
    features_, labels_, objects_, blocks_, nothing_ : ndarray of n_touches rows
        What is kept of the training touches.
    unexplained_ : ndarray of shape (n_touches,)
        How much of each training touch principal components that never met its
        stretch leave out; NaN where the encoding has none.
    contact_ : ContactCheck
        Tells touches without contact.
    uses_no_contact_ : bool
        Whether touches without contact are heard: where a label consists of them.
    sequence_calibration_ : SequenceCalibration
        How touches of one episode add up.
    unknown_scale_ : UnknownScale
        What episodes of known objects look like.
    floor_ : float
        The floor in use.
    chosen_ : dict
        What the preset chose for these touches, and why.
    pose_ : PressPose or None
        Where parts lie on a pressure array, after `fit_pose`.
    modalities_ : dict of str to Modality
        Other senses, after `learn_modality`.

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

    classes_: NDArray
    contact_: ContactCheck
    uses_no_contact_: bool
    sequence_calibration_: SequenceCalibration
    unknown_scale_: UnknownScale
    floor_: float
    chosen_: dict[str, Any]

    def __init__(
        self,
        preset: str = "default",
        *,
        label: str = "object",
        floor: float | None = None,
        prior: str = "uniform",
        random_state: int = 0,
    ) -> None:
        self.preset = preset
        self.label = label
        self.floor = floor
        self.prior = prior
        self.random_state = random_state

    def fit(self, touches: Touches | TouchSource) -> Self:
        """Learn objects from labelled touches.

        Parameters
        ----------
        touches : Touches or TouchSource
            Of a source (`TouchLibrary.select`), the encoding is learnt from some
            2000 touches and the rest are encoded piece by piece, so that their
            images are never all in memory.

        Raises
        ------
        ValueError
            If labels are missing, there are fewer than two of them, or one has
            fewer than two touches.
        """
        preset = self._check_parameters()
        if not isinstance(touches, Touches | TouchSource):
            raise TypeError(
                f"touches must be Touches, got {type(touches).__name__}. "
                "Write Touches(images, object=labels)."
            )
        labels, objects = training_labels(touches, self.label)
        group = left_out_groups(touches, labels, objects, self.label)
        learnt = learn_encoding(preset, touches, labels, group, self.random_state)
        self.encoder_, self.contact_ = learnt.encoder, learnt.contact
        self.features_, self.nothing_ = learnt.features, learnt.nothing
        self.unexplained_ = learnt.unexplained
        self.chosen_ = learnt.chosen
        self.labels_, self.objects_, self.blocks_ = labels, objects, group
        self.classifier_ = preset.classifier()
        self._learn(fresh=True)
        self._calibrate(preset)
        self.pose_, self.modalities_ = None, {}
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
        if name in self.classes_:
            raise ValueError(
                f"name must be new, got {name!r}, which is known already. "
                "Forget it first, or choose another name."
            )
        if not isinstance(name, str) or not name:
            raise ValueError(f"name must be a text that is not empty, got {name!r}.")
        if not isinstance(touches, TouchSource):
            touches = as_touches(touches)
        if len(touches) < 2:
            raise ValueError(f"{name!r} must have at least 2 touches, got 1.")
        features, new, nothing = encoded(self.encoder_, self.contact_, touches)
        labels = np.full(len(touches), name)
        objects = labels if touches.object is None else touches.object
        group = blocks_in_order(labels, touches.order) + self.blocks_.max() + 1
        self.features_ = np.vstack([self.features_, features])
        self.nothing_ = np.concatenate([self.nothing_, nothing])
        self.unexplained_ = np.concatenate([self.unexplained_, new])
        self.labels_ = np.concatenate([self.labels_, labels])
        self.objects_ = np.concatenate([self.objects_, objects])
        self.blocks_ = np.concatenate([self.blocks_, group])
        if hasattr(self.classifier_, "add_class"):
            self.classifier_.add_class(name, features)
        else:
            self._learn(fresh=False)
        self.classes_ = np.unique(self.labels_)
        self._calibrate(find_preset(self.preset))
        return self

    def forget_object(self, name: str) -> Self:
        """Forget one object; the others are as before.

        Raises
        ------
        ValueError
            If it is not known, or fewer than two would remain.
        """
        self._check_fitted()
        check_option("name", name, self.classes_.tolist())
        if len(self.classes_) < 3:
            raise ValueError(
                f"At least two objects must remain, cannot forget {name!r}. "
                "Add another object first."
            )
        keep = self.labels_ != name
        for attribute in KEPT:
            setattr(self, attribute, getattr(self, attribute)[keep])
        if hasattr(self.classifier_, "forget_class"):
            self.classifier_.forget_class(name)
        else:
            self._learn(fresh=False)
        self.classes_ = np.unique(self.labels_)
        self._calibrate(find_preset(self.preset))
        return self

    def log_likelihood(self, touches: Touches) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_objects), columns as in `classes_`; neither floor nor
        trust is in it yet. The row of a touch without contact is all zeros, see
        `uses_no_contact_`.
        """
        return self.evidence(touches).log_likelihood

    def flags(self, touches: Touches) -> list[str]:
        """Return what is wrong with each touch, "" for most; see `ContactCheck.flags`.

        A touch marked "no contact" is not heard; the others are.
        """
        return self.evidence(touches).flags

    def evidence(self, touches: Touches) -> Evidence:
        """Return all that touches tell; see `Evidence`.

        Many touches are felt in shards of 1024, wherever `joblib.parallel_config` says.
        """
        self._check_fitted()
        given = as_touches(touches)
        if len(given) <= SHARD:
            return self._evidence_shard(given)
        from joblib import Parallel, delayed

        shards = (given[start : start + SHARD] for start in range(0, len(given), SHARD))
        return Evidence.together(
            Parallel()(delayed(self._evidence_shard)(s) for s in shards)
        )

    def _evidence_shard(self, touches: Touches) -> Evidence:
        features, new, flags = encoded_and_flagged(
            self.encoder_, self.contact_, touches
        )
        nothing = np.array(flags) == NO_CONTACT
        heard = self._used(self.feature_log_likelihood(features), nothing)
        return Evidence(features, heard, flags, new)

    def feature_log_likelihood(self, features: Floats) -> Floats:
        """Return log-likelihoods of features, of touches taken to be in contact."""
        return touch_log_likelihood(self.classifier_, features)

    def log_prior(self) -> Floats:
        """Return the log prior of the objects (nats), shape (n_objects,)."""
        self._check_fitted()
        if self.prior == "uniform":
            return np.full(len(self.classes_), -np.log(len(self.classes_)))
        counts = np.unique(self.labels_, return_counts=True)[1]
        log_shares: Floats = np.log(counts / counts.sum())
        return log_shares

    def start(self, prior: Mapping[str, float] | None = None) -> Belief:
        """Return the belief before the first touch of an episode.

        Parameters
        ----------
        prior : mapping of str to float, optional
            How probable each object is, all of them, positive; brought to sum 1. By
            default as the parameter `prior` says.
        """
        self._check_fitted()
        return Belief(
            self, None if prior is None else given_prior(prior, self.classes_)
        )

    def refusal_threshold(self, n_touches: int, error: float = 0.05) -> float:
        """Return the unknown score above which `Belief.decide(error)` says "unknown".

        Stricter than `unknown_threshold`: of known episodes that are asked about after
        every touch, in all a share `error` is refused.
        """
        self._check_fitted()
        return self.unknown_scale_.refusal_threshold(n_touches, error)

    def unknown_threshold(self, n_touches: int, refused: float = 0.05) -> float:
        """Return the unknown score that a share `refused` of known episodes exceeds.

        Learnt from left-out training touches; between the lengths that were
        simulated it is interpolated, beyond them it stays.
        """
        self._check_fitted()
        return self.unknown_scale_.threshold(n_touches, refused)

    def save(self, path: str | Path) -> Path:
        """Write the recogniser to a `.palpate` file, all or nothing."""
        self._check_fitted()
        return write_model(
            path, self, {**KNOWN_CLASSES, type(self).__name__: type(self)}
        )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a recogniser from a `.palpate` file; nothing in it is executed.

        Raises
        ------
        ModelFileError
            If the file is missing, damaged, of another version, or no recogniser.
        """
        model = read_model(path, {**KNOWN_CLASSES, cls.__name__: cls})
        if not isinstance(model, cls):
            raise ModelFileError(f"{path} holds no object recogniser.")
        try:
            try_one_touch(model)
        except Exception as error:
            raise ModelFileError(f"{path} is damaged: {error}. Learn again.") from error
        return model

    def _check_parameters(self) -> Preset:
        check_option("label", self.label, ("object", "category"))
        check_option("prior", self.prior, ("uniform", "counts"))
        if self.floor is not None:
            check_number("floor", self.floor, low=0, high=0.5)
        return find_preset(self.preset)

    def _check_fitted(self) -> None:
        if not hasattr(self, "classes_"):
            raise ValueError("This recogniser has learnt nothing yet; call fit first.")

    def _learn(self, *, fresh: bool) -> None:
        """Fit the classifier to the kept features; not fresh keeps its choices."""
        fit = self.classifier_.fit
        if not fresh and hasattr(self.classifier_, "refit"):
            fit = self.classifier_.refit
        if hasattr(self.classifier_, "left_out_log_likelihood"):
            fit(self.features_, self.labels_, groups=self.blocks_)
        else:
            fit(self.features_, self.labels_)
        self.classes_ = np.unique(self.labels_)

    def _calibrate(self, preset: Preset) -> None:
        """Set floor, sequence calibration and unknown scale by left-out touches."""
        self.floor_ = preset.floor if self.floor is None else float(self.floor)
        self.uses_no_contact_ = not preset.skips_no_contact or consists_of_nothing(
            self.labels_, self.nothing_
        )
        log_likelihood = left_out_log_likelihood(
            self.classifier_, self.features_, self.labels_, self.blocks_
        )
        floored = with_floor(self._used(log_likelihood, self.nothing_), self.floor_)
        self.sequence_calibration_, self.unknown_scale_ = calibrate(
            floored,
            self.unexplained_,
            np.searchsorted(self.classes_, self.labels_),
            draw_all(self.objects_, self.blocks_, self.random_state),
            self.log_prior(),
            calibrates_sequence=preset.calibrates_sequence,
        )

    def _used(self, log_likelihood: Floats, nothing: NDArray) -> Floats:
        """Let touches without contact say nothing, unless a label consists of them."""
        if self.uses_no_contact_:
            return log_likelihood
        return np.where(nothing[:, np.newaxis], 0.0, log_likelihood)
