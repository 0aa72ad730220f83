"""The belief over objects by pictures, places and misses, and how the object stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from .._checks import check_option
from .._extras import needed
from .._numbers import log_softmax
from .._types import Array, Floats
from ..recognition import Evidence
from ..touches import Touches
from ._place_filter import advice, out_of_frames
from ._record import History, TouchRecord, as_touches
from ._surface import AZIMUTHS, HEIGHTS, contacts_of, directions
from ._touch_map import BeliefOfPlaces

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..simulation import SensorPose
    from ._surface_map import SurfaceMap

# Touches whose contact is known although no frame was taken.
_CONTACTS = "touched", "no frame"
_FAR_AWAY = 3.0
# So many contacts from sides so far apart (cosine), all this near the middle (mm), are
# no thing that can be touched.
_FEW_CONTACTS, _LEAST_MM, _OTHER_SIDE = 3, 0.5, 0.5
_DOWN = np.array([0.0, 0.0, -1.0])
# Of the table's nodes around, so many apart are drawn.
_POINT_STEP = 3
# Half of the things, and of the faces, that were never learnt may have the shape of one
# that was (a mug that lies may well be met where a pot is). Where such a face may also
# be the object's own body turned, each of the three is as likely.
_LOG_HALF, _LOG_THIRD = -np.log(2), -np.log(3)


@dataclass(frozen=True)
class StandingPose:
    """How the most probable object stands, each with a standard deviation.

    `turn_rad` is about the vertical, modulo 2 pi over `symmetry` (72: round, so that
    no turn can be told); `offset_mm` from the assumed middle, (x, y, z).
    """

    object: str
    face: int
    probability: float
    turn_rad: float
    turn_sd_rad: float
    symmetry: int
    offset_mm: tuple[float, float, float]
    offset_sd_mm: tuple[float, float, float]

    def __str__(self) -> str:
        turn = "a turn that cannot be told"
        if self.symmetry < len(AZIMUTHS):
            degrees = np.degrees([self.turn_rad, self.turn_sd_rad])
            turn = f"turned by {degrees[0]:.0f} +- {degrees[1]:.0f} degrees"
        x, y, _ = self.offset_mm
        aside = np.hypot(*self.offset_sd_mm[:2])
        return (
            f"{self.object} on face {self.face}, {turn}, ({x:.0f}, {y:.0f}) "
            f"+- {aside:.0f} mm aside"
        )


class PlaceBelief(BeliefOfPlaces):
    """A posterior over objects by pictures, contacts and misses.

    Made by `SurfaceMap.start`, and used as a `Belief` is. On which face the object
    stands, how it is turned and how far it is aside are believed along with what it is.

    Attributes
    ----------
    filter : PlaceFilter
        The hypotheses, `n_turns` a state in order.
    log_place : ndarray of shape (n_hypotheses,)
        Their log evidence by places (nats).
    log_joint : ndarray of shape (n_hypotheses,)
        Their log probabilities, were it a known object.
    """

    def __init__(
        self,
        surface_map: SurfaceMap,
        centre_mm: ArrayLike,
        prior: Mapping[str, float] | None,
        strangers: float,
    ) -> None:
        super().__init__(surface_map.recogniser, prior, strangers)
        self.map = surface_map
        self.centre_mm = np.asarray(centre_mm, dtype=np.float64)
        self.filter, self._faces, self._stranger = surface_map.filters_before()
        self._tips_mm, self._ways = np.zeros((0, 3)), np.zeros((0, 3))
        shape = len(surface_map.states_), surface_map.n_turns
        self._pictures = np.zeros(shape)
        self.log_place: Floats = np.zeros(self._pictures.size)
        # How probable it is of each hypothesis that its surface is a body turned.
        self._turned = np.zeros(shape)
        self._known_nats = 0.0
        self._weigh()

    def update(
        self,
        touch: Touches | Array | Evidence | TouchRecord,
        evidence: Evidence | None = None,
    ) -> Self:
        """Take in touches, in order, or an attempt, and return this belief.

        Parameters
        ----------
        touch : Touches or TouchRecord
            Touches with the columns `direction` and `position_mm`, in the frame of the
            arm, and perhaps `force_n`. A row of NaN in `position_mm` is a touch whose
            contact is not known: it counts by its picture from that direction; a row
            of NaN in `direction` counts by its picture alone. A record is taken in by
            `update_from_record`.
        evidence : Evidence, optional
            What `ObjectRecogniser.evidence` returns for the touches, where it is known.

        Raises
        ------
        ValueError
            The touches have no places, these are far from the object or in another
            unit, or the recogniser cannot take the images; the belief is then
            unchanged.
        TypeError
            They are no `Touches`.
        """
        if isinstance(touch, TouchRecord):
            return self.update_from_record(touch)
        tips, ways, middles = self._contacts(touch)
        if evidence is None:
            assert isinstance(touch, Touches)
            evidence = self._evidence_of(touch)
        pictures = np.zeros((len(tips), *self._pictures.shape))
        if self.map.use_pictures:
            log_pictures = log_softmax(evidence.log_likelihood, axis=1)
            pictures = self.map.picture_evidence(log_pictures, evidence.features, -ways)
            pictures[~evidence.log_likelihood.any(axis=1)] = 0.0
        # One after another: how low an episode came hangs on their order.
        is_placed = np.asarray(np.isfinite(middles).all(axis=1))
        for row, placed in enumerate(is_placed):
            self._pictures = self._pictures + pictures[row]
            if placed:
                self._met(tips[row], ways[row], middles[row])
            n_told = self._n_informative
            super().update(evidence.of_touch(row))
            if placed and self._n_informative == n_told:
                self._weigh()  # its picture says nothing, its contact does
        return self

    def update_from_record(self, record: TouchRecord) -> Self:
        """Take in an attempt of the arm: a touch, a contact without frame, a miss.

        ValueError where it passes far from the object; the belief is then unchanged.
        """
        if record.touched:
            return self.update(as_touches([record]))
        tip, way = np.asarray(record.position_mm) - self.centre_mm, record.direction
        if record.outcome in _CONTACTS:
            forces = np.array([record.force_n])
            middles = self.map.middles(tip[None], way[None], forces)
            self._refuse_far(np.linalg.norm(middles, axis=1))
            self._met(tip, way, middles[0])
        elif record.outcome == "nothing":
            end = tip - self.map.tip_radius_mm * way
            reach = min(record.travel_mm, 2 * float(self.map.table_.mean_mm.max()))
            start = end - reach * way
            along = np.clip(-end @ way, -reach, 0.0)
            self._refuse_far(np.linalg.norm([end + along * way], axis=1))
            self._missed(start, end)
        self._weigh()
        return self

    def _contacts(self, touch: object) -> tuple[Floats, Floats, Floats]:
        """Return tips, ways and the ball's middles about the centre, NaN if unknown."""
        if not isinstance(touch, Touches):
            raise TypeError(
                f"touch must be Touches, got {type(touch).__name__}. Write "
                "Touches(images, direction=..., position_mm=...)."
            )
        lost, filled = np.zeros((2, len(touch)), bool), touch
        columns = {"position_mm": self.centre_mm, "direction": _DOWN}
        for number, (name, stand_in) in enumerate(columns.items()):
            column = np.asarray(touch.columns.get(name, np.nan), dtype=np.float64)
            if column.ndim == 2 and not np.isfinite(column).all():
                lost[number] = ~np.isfinite(column).all(axis=1)
                values = np.where(lost[number][:, None], stand_in, column)
                filled = filled.with_columns(**{name: values})
        tips, ways = contacts_of(filled)
        tips = tips - self.centre_mm
        forces = np.full(len(touch), np.nan)
        if "force_n" in touch.columns:
            forces = np.asarray(touch.columns["force_n"], dtype=np.float64)
        middles = self.map.middles(tips, ways, forces)
        placed = ~lost.any(axis=0)
        self._refuse_far(np.linalg.norm(middles[placed], axis=1))
        self._refuse_near(tips[placed], ways[placed])
        middles[~placed], ways[lost[1]] = np.nan, np.nan
        return tips, ways, middles

    def _refuse_near(self, tips_mm: Floats, ways: Floats) -> None:
        """Refuse contacts from several sides that are all in the middle."""
        tips = np.concatenate([self._tips_mm, tips_mm])
        sides = np.concatenate([self._ways, ways])
        reach = float(np.linalg.norm(tips, axis=1).max(initial=0.0))
        if len(tips) < _FEW_CONTACTS or reach >= _LEAST_MM:
            return
        if (sides @ sides.T).min() < _OTHER_SIDE:
            raise ValueError(
                f"position_mm must be millimetres, got {len(tips)} contacts that reach "
                f"{reach:.3g} mm from the assumed middle {self.centre_mm.tolist()}. Is "
                "it metres?"
            )

    def _refuse_far(self, reach_mm: Floats) -> None:
        most = float(self.map.table_.mean_mm.max())
        far = np.flatnonzero(reach_mm > _FAR_AWAY * most)
        if len(far):
            raise ValueError(
                f"position_mm must be within {_FAR_AWAY * most:.0f} mm of the assumed "
                f"middle {self.centre_mm.tolist()}, got {reach_mm[far[0]]:.4g} mm. Is "
                "it another unit or frame, or another centre_mm?"
            )

    def _met(self, tip_mm: Floats, way: Floats, middle_mm: Floats) -> None:
        """Take in a contact; how probable it is for known objects is added up.

        Nothing is weighed before the whole touch is in: half of one would count for
        how low the episode came.
        """
        self._tips_mm = np.concatenate([self._tips_mm, tip_mm[None]])
        self._ways = np.concatenate([self._ways, way[None]])
        before = self.log_place
        self.filter = self.filter.met(middle_mm)
        self._faces = self._faces.met(middle_mm)
        self._stranger = self._stranger.met(middle_mm)
        self.log_place = self._by_place()
        self._known_nats += float(logsumexp(self.log_joint + self.log_place - before))

    def _missed(self, from_mm: Floats, to_mm: Floats) -> None:
        """Take in that nothing was met between two points."""
        before = self.filter.log_evidence
        self.filter = self.filter.met_nothing(from_mm, to_mm)
        change = (self.filter.log_evidence - before).reshape(self._pictures.shape)
        self._faces = self._faces.weighed(change[self.map.is_other_].mean(axis=1))
        self.log_place = self._by_place()

    def _by_place(self) -> Floats:
        """Return the log evidence of hypotheses, with faces that were never learnt."""
        evidence = self.filter.log_evidence.reshape(self._pictures.shape).copy()
        other = self.map.is_other_
        if other.any():
            by_state = logsumexp(evidence[~other], axis=1) - np.log(self.map.n_turns)
            alike = logsumexp(self.map.log_alike_ + by_state, axis=1)
            either = np.logaddexp(alike, self._faces.log_evidence)[:, None]
            if not self.map.turns_bodies_:
                evidence[other] = either + _LOG_HALF
                return evidence.ravel()
            turned = evidence[other]
            evidence[other] = np.logaddexp(either, turned) + _LOG_THIRD
            self._turned = np.zeros(evidence.shape)
            self._turned[other] = np.exp(turned + _LOG_THIRD - evidence[other])
        return evidence.ravel()

    @property
    def unknown_evidence(self) -> float:
        """What pictures and places say for a stranger (nats); see `Belief`.

        Where contacts lie on a learnt body turned, half of the pictures are like
        anything, so that these tell it from a stranger by a factor of two at most.
        """
        unlike = float(self._stranger.log_evidence[0]) - self._known_nats
        half = np.clip(np.exp(self.log_joint) @ self._turned.ravel(), 1e-9, 1.0) / 2
        pictures = super().unknown_evidence
        like_any = np.logaddexp(np.log1p(-half), np.log(half) + pictures)
        return float(pictures - like_any + np.logaddexp(0.0, unlike) + _LOG_HALF)

    @property
    def n_contacts(self) -> int:
        """Number of contacts that were taken in."""
        return len(self._tips_mm)

    @property
    def log_posterior(self) -> Floats:
        """Log probability of each object, were it one of them (nats), (n_objects,)."""
        return self._log_objects.copy()

    def _joined(self) -> Floats:
        prior = log_softmax(self._prior_and_senses())[self.map.object_of_state_]
        prior = prior + self.map.log_share_of_state
        calibration = self.map.pictures_.sequence_calibration
        pictures = self._pictures * calibration.weight(self._n_informative)
        joint = (pictures + prior[:, None]).ravel() + self.log_place
        self.log_joint: Floats = joint - logsumexp(joint)
        by_state = logsumexp(self.log_joint.reshape(self._pictures.shape), axis=1)
        self._log_objects = np.full(len(self._model.classes), -np.inf)
        np.logaddexp.at(self._log_objects, self.map.object_of_state_, by_state)
        return self._log_objects

    def pose(self, name: str | None = None) -> StandingPose:
        """Return how the most probable object stands, or the one of that name.

        On the most probable face that was learnt; `probability` is of that.
        """
        shares = np.exp(self.log_joint).reshape(self._pictures.shape)
        names = self._model.classes.tolist()
        code = names.index(check_option("name", name or self.best, names))
        is_it = (self.map.object_of_state_ == code) & ~self.map.is_other_
        rows = np.flatnonzero(is_it)
        state = int(rows[shares[rows].sum(axis=1).argmax()])
        share, order = shares[state], int(self.map.table_.symmetry[state])
        mean = self.filter.mean.reshape(*shares.shape, -1)[state]
        covariance = self.filter.covariance.reshape(*shares.shape, 4, 4)[state]
        weight, turn, turn_sd = _turn_of(share, order, mean[:, 0], covariance[:, 0, 0])
        offset = weight @ mean[:, 1:]
        spread = weight @ (mean[:, 1:] - offset) ** 2
        inside = np.diagonal(covariance, axis1=1, axis2=2)[:, 1:]
        x, y, z = map(float, offset)
        sx, sy, sz = map(float, np.sqrt(spread + weight @ inside))
        return StandingPose(
            *self.map.states_[state],
            float(share.sum()),
            turn,
            turn_sd,
            order,
            (x, y, z),
            (sx, sy, sz),
        )

    def surface(self) -> tuple[Floats, Floats]:
        """Return where the tip would meet the most probable object.

        Returns points (n, 3) in the frame of the arm (mm) and their covariances
        (n, 3, 3): of the surface, of the turn and of the offset.
        """
        pose = self.pose()
        state = self.map.states_.index((pose.object, pose.face))
        upper = HEIGHTS >= 0
        outs = directions()[upper][:, ::_POINT_STEP].reshape(-1, 3)
        radius = self.map.table_.mean_mm[state][upper][:, ::_POINT_STEP].ravel()
        local = outs * np.maximum(radius - self.map.tip_radius_mm, 0)[:, None]
        standing = np.array([pose.turn_rad, *pose.offset_mm])
        points = out_of_frames(local, standing)
        level = points - standing[1:]
        turning = np.stack([-level[:, 1], level[:, 0], 0 * level[:, 0]], axis=1)
        outward = out_of_frames(outs, np.array([pose.turn_rad, 0, 0, 0]))
        states = np.full(len(outs), state)
        _, variance = self.map.table_.look_up(states, outs * radius[:, None])
        covariances = variance[:, None, None] * outward[:, :, None] * outward[:, None]
        covariances = covariances + np.diag(np.square(pose.offset_sd_mm))
        turned = pose.turn_sd_rad * turning
        covariances = covariances + turned[:, :, None] * turned[:, None]
        return points + self.centre_mm, covariances

    def plot_surface(
        self,
        history: History = (),
        ax: Axes | None = None,
        start: SensorPose | None = None,
    ) -> Axes:
        """Draw from above where the surface is expected, and what was touched.

        Points with an ellipse of one standard deviation, in the frame of the arm;
        attempts of `history`: dots where something was met, crosses where the tip went
        without. `start`, where the next touch begins, is an arrow with the sentence of
        `advice`. Returns matplotlib's axes (extra `plot`), `ax` or new ones.
        """
        pyplot = needed("matplotlib.pyplot", "plot", "A picture of a surface")
        patches = needed("matplotlib.patches", "plot", "A picture of a surface")
        axes = pyplot.subplots(figsize=(5, 5))[1] if ax is None else ax
        points, covariances = self.surface()
        for point, covariance in zip(points, covariances, strict=True):
            lengths, ways = np.linalg.eigh(covariance[:2, :2])
            width, height = 2 * np.sqrt(np.maximum(lengths, 0))
            angle = np.degrees(np.arctan2(ways[1, 0], ways[0, 0]))
            shape = patches.Ellipse(point[:2], width, height, angle=angle)
            shape.set(facecolor="#4c78a8", alpha=0.12)
            axes.add_patch(shape)
        x, y, _ = points.T
        axes.scatter(x, y, s=4, color="#4c78a8", label="expected")
        for label, marker in (("met", "o"), ("nothing", "x")):
            tips = [
                record.position_mm[:2]
                for record in history
                if (record.outcome in _CONTACTS) == (label == "met")
                and (record.outcome in _CONTACTS or record.outcome == "nothing")
            ]
            if tips:
                x, y = np.transpose(tips)
                axes.scatter(x, y, marker=marker, color="#c43c39", label=label)
        title = str(self.pose())
        if start is not None:
            title = "\n".join([title, *wrap(advice(self, start), len(title))])
            middle, out = self.centre_mm[:2], -np.asarray(start.direction)[:2]
            out = out / max(float(np.hypot(*out)), 0.5)
            reach = np.linalg.norm(points[:, :2] - middle, axis=1).max()
            ends = middle + 1.1 * reach * out, middle + 1.6 * reach * out
            style = {"arrowstyle": "->", "color": "#c43c39"}
            axes.annotate("", *ends, arrowprops=style, annotation_clip=False)
            axes.update_datalim(ends)
            axes.autoscale_view()
        axes.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
        axes.set_title(title, fontsize="small")
        axes.legend(loc="upper right", fontsize="small")
        return axes


def _turn_of(
    share: Floats, order: int, turns: Floats, variances: Floats
) -> tuple[Floats, float, float]:
    """Return the weights of turns (n_turns,) near the best one, it, and its deviation.

    The best turn with what is near it, modulo the symmetry.
    """
    waves = np.exp(1j * order * turns)
    smooth = share + 0.5 * (np.roll(share, 1) + np.roll(share, -1))
    near = (waves * waves[smooth.argmax()].conj()).real > np.cos(np.pi / 3)
    weight = share * near if (share * near).sum() else np.ones(len(share))
    weight = weight / weight.sum()
    turn = float(np.angle(weight @ waves) / order % (2 * np.pi / order))
    length = min(abs((share / max(share.sum(), 1e-300)) @ waves), 1 - 1e-9)
    variance = -2 * np.log(max(length, 1e-9)) / order**2 + weight @ variances
    # No turn at all is known: even over one of them.
    most = np.pi / order / np.sqrt(3)
    return weight, turn, float(min(np.sqrt(variance), most))
