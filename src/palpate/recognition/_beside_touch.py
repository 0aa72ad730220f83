"""What a recogniser can tell or take in beside touches: poses, other senses."""

from typing import TYPE_CHECKING, Any, Self

from numpy.typing import ArrayLike

from ..images import Poses, PressPose
from ..touches import Touches
from ._modality import Modality
from ._training import training_labels


class BesideTouch:
    """The part of `ObjectRecogniser` that is not about which object was touched."""

    pose_: PressPose | None
    modalities_: dict[str, Modality]

    if TYPE_CHECKING:
        label: str
        random_state: int

        def _check_fitted(self) -> None: ...

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
            Examples that resemble each other are left out together to find how far
            they may be trusted.
        classifier : classifier with `predict_proba`, optional
            See `Modality`.
        """
        self._check_fitted()
        if not isinstance(name, str) or not name:
            raise ValueError(f"name must be a text that is not empty, got {name!r}.")
        modality = Modality(classifier, random_state=self.random_state)
        self.modalities_[name] = modality.fit(X, y, groups)
        return self
