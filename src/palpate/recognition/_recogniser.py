"""Touches -> object: the recogniser that learns touch by touch."""

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator

from .._checks import check_number, check_option
from ..images import Poses, PressPose
from ..touches import Touches
from ._belief import Belief, as_touches
from ._calibration import (
    LENGTHS,
    REFUSED,
    draw_episodes,
    fit_trust,
    left_out_log_likelihood,
    touch_log_likelihood,
    unknown_limits,
)
from ._known import KNOWN_CLASSES
from ._model_file import ModelFileError, read_model, write_model
from ._presets import Preset, find_preset
from ._sequence import Floats, Trust, with_floor
from ._source import TouchSource, encoded, fit_encoder
from ._training import stretches, training_groups, training_labels

MAX_PIXELS = 50_000_000


class ObjectRecogniser(BaseEstimator):
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
    features_, labels_, objects_, stretches_ : ndarray of n_touches rows
        What is kept of the training touches.
    trust_ : Trust
        How touches of one episode add up.
    floor_ : float
        The floor in use.
    chosen_ : dict
        What the preset chose for these touches, and why.
    pose_ : PressPose or None
        Where parts lie on a pressure array, after `fit_pose`.

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
    trust_: Trust
    floor_: float
    chosen_: dict[str, Any]
    pose_: PressPose | None

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
        group = training_groups(touches, labels, objects, self.label)
        encoder, self.chosen_, self.features_ = fit_encoder(
            preset, touches, labels, group, self.random_state
        )
        self.encoder_ = encoder
        self.labels_, self.objects_, self.stretches_ = labels, objects, group
        self.classifier_ = preset.classifier()
        self._learn(fresh=True)
        self._calibrate(preset)
        self.pose_ = None
        return self

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
            training_labels(touches, self.label)[0],
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
                "This recogniser has learnt no poses; call fit_pose, or learn with "
                "--pitch-mm."
            )
        return self.pose_.estimate(touches.images, labels)

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
        features = encoded(self.encoder_, touches)
        labels = np.full(len(touches), name)
        objects = labels if touches.object is None else touches.object
        group = stretches(labels, touches.order) + self.stretches_.max() + 1
        self.features_ = np.vstack([self.features_, features])
        self.labels_ = np.concatenate([self.labels_, labels])
        self.objects_ = np.concatenate([self.objects_, objects])
        self.stretches_ = np.concatenate([self.stretches_, group])
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
        for attribute in ("features_", "labels_", "objects_", "stretches_"):
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
        trust is in it yet.
        """
        self._check_fitted()
        features = self.encoder_.transform(as_touches(touches))
        return self.feature_log_likelihood(features)

    def feature_log_likelihood(self, features: Floats) -> Floats:
        """Return `log_likelihood` of touches that are encoded already."""
        return touch_log_likelihood(self.classifier_, features)

    def log_prior(self) -> Floats:
        """Return the log prior of the objects (nats), shape (n_objects,)."""
        self._check_fitted()
        if self.prior == "uniform":
            return np.full(len(self.classes_), -np.log(len(self.classes_)))
        counts = np.unique(self.labels_, return_counts=True)[1]
        log_shares: Floats = np.log(counts / counts.sum())
        return log_shares

    def start(self) -> Belief:
        """Return the belief before the first touch of an episode."""
        self._check_fitted()
        return Belief(self)

    def unknown_threshold(self, n_touches: int, refused: float = 0.05) -> float:
        """Return the unknown score that a share `refused` of known episodes exceeds.

        Learnt from left-out training touches; between the lengths that were
        simulated it is interpolated, beyond them it stays.
        """
        self._check_fitted()
        at_lengths = [np.interp(refused, REFUSED, row) for row in self.unknown_limits_]
        return float(np.interp(n_touches, self.unknown_lengths_, at_lengths))

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
            model._try_one_touch()
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
            fit(self.features_, self.labels_, groups=self.stretches_)
        else:
            fit(self.features_, self.labels_)
        self.classes_ = np.unique(self.labels_)

    def _calibrate(self, preset: Preset) -> None:
        """Set `floor_`, `trust_` and the unknown limits from left-out touches."""
        self.floor_ = preset.floor if self.floor is None else float(self.floor)
        log_likelihood = left_out_log_likelihood(
            self.classifier_, self.features_, self.labels_, self.stretches_
        )
        floored = with_floor(log_likelihood, self.floor_)
        rng = np.random.default_rng(self.random_state)
        drawn = {
            k: draw_episodes(self.objects_, self.stretches_, k, rng) for k in LENGTHS
        }
        episodes = {k: rows for k, rows in drawn.items() if len(rows)}
        codes = np.searchsorted(self.classes_, self.labels_)
        self.trust_ = Trust()
        if preset.fits_trust:
            self.trust_ = fit_trust(floored, codes, episodes, self.log_prior())
        self.unknown_lengths_ = np.array(list(episodes), dtype=float)
        self.unknown_limits_ = unknown_limits(
            floored, episodes, self.log_prior(), self.trust_
        )

    def _try_one_touch(self) -> None:
        """Recognise a blank touch, so that a model that cannot work is found now."""
        n_rows, n_cols = self.encoder_.image_shape_
        rows = {len(a) for a in (self.features_, self.labels_, self.objects_)}
        if not (0 < n_rows * n_cols <= MAX_PIXELS and rows == {len(self.stretches_)}):
            raise ValueError("its sizes do not agree")
        check_number("floor_", self.floor_, low=0, high=0.5)
        blank = Touches(np.zeros((1, *self.encoder_.image_shape_)))
        row = self.log_likelihood(blank)
        if row.shape != (1, len(self.classes_)) or not np.isfinite(row).all():
            raise ValueError("its parts do not fit together")
        belief = self.start().update_from_log_likelihood(row)
        if abs(sum(belief.posterior.values()) - 1) > 1e-6:
            raise ValueError("its belief does not sum to one")
        belief.decide()


def summary(recogniser: ObjectRecogniser) -> dict[str, Any]:
    """Return what was learnt, as plain values for people and for JSON."""
    return {
        "preset": recogniser.preset,
        "label": recogniser.label,
        "n_labels": len(recogniser.classes_),
        "n_train_touches": len(recogniser.labels_),
        "n_features": recogniser.features_.shape[1],
        "labels": [str(name) for name in recogniser.classes_],
        "chosen": recogniser.chosen_,
    }
