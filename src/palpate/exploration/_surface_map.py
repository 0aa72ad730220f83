"""Where the surface of every known object is, and which touches are met where on it.

An object may stand on one of several faces (the column `face` of its touches, or the
resting poses of a mesh); each is a state with a surface (`_surface`) and pictures of
its own. The surface is learnt from the places of the object's own training touches:
no drawing of it is needed. A mesh may be given instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.special import logsumexp

from .._checks import STRANGERS, check_count, check_number, check_positive
from .._numbers import log_softmax
from .._types import Bools, Floats, Indices
from ..recognition import ObjectRecogniser
from ..simulation import DomeCamera, SimObject
from ..touches import Touches
from ._place_belief import PlaceBelief
from ._place_filter import Looseness, PlaceFilter, UnlearntSurfaces
from ._surface import (
    MEAN_SD_MM,
    Body,
    RadialSurface,
    SurfaceTable,
    aims_at_middles,
    contacts_of,
    faces_of,
    learnt_surface,
    mesh_surface,
    middle_of,
    one_aim,
    turned_surfaces,
)
from ._touch_map import TouchMap, check_learnt

if TYPE_CHECKING:
    from ._strategies import Hemisphere

_LEAST_TOUCHES = 6
# Things that are touched are larger than the first and smaller than the second.
_LEAST_MM, _MOST_MM = 3.0, 3000.0
_PLACEMENT_MM = 5.0
_OTHER_FACE_MM = 10.0
_LEAST_WEIGHT = 1e-3
# These and below: faces that were never learnt.
OTHER_FACE = -1
State = tuple[str, int]


class SurfaceMap:
    """Where every known object has its surface, and what touches there are like.

    Parameters
    ----------
    n_turns : int, default=36
        Turns about the vertical with a filter of their own.
    tip_radius_mm : float, default=20.0
        Radius of the sensor's round tip.
    stiffness_n_mm : float, default=0.3
        Of the sensor's soft end: by how much more force than in training it is pressed
        in deeper.
    looseness : Looseness, optional
        How far objects, arm and sensor may be from where they should be.
    other_faces : float, optional
        How often an object stands on a face that was never learnt. By default half of
        the time where one face was taught, else (k + 1) / (n + 1), at most a half, for
        an object with k faces that were met in one of its n recordings alone. It may
        be lower where things stand as they were taught.
    use_pictures : bool, default=True
        False leaves places and misses alone, whatever the pictures show.
    random_state : int, default=0
        Seed of the drawn episodes that weigh the pictures.

    Attributes
    ----------
    states_ : list of (str, int)
        Objects on their faces; -1 stands for a face that was never learnt.
    object_of_state_ : ndarray of shape (n_states,)
        Number of the object of each.
    table_ : SurfaceTable
        Their surfaces.
    choice_table_ : SurfaceTable
        The same for choosing the next touch, which takes a face that was never learnt
        for a surface anywhere, not for a body turned.
    pictures_ : TouchMap
        What their touches are like from every side, its "objects" being the states.
    other_share_ : ndarray of shape (n_objects,)
        How often each stands on a face that was never learnt; 0 by a mesh.
    turns_bodies_ : bool
        Whether a face that was never learnt may be the learnt body turned.
    force_n_ : float
        Middling force of the training touches.
    """

    def __init__(
        self,
        *,
        n_turns: int = 36,
        tip_radius_mm: float = 20.0,
        stiffness_n_mm: float = 0.3,
        looseness: Looseness | None = None,
        other_faces: float | None = None,
        use_pictures: bool = True,
        random_state: int = 0,
    ) -> None:
        self.n_turns = n_turns
        self.tip_radius_mm = tip_radius_mm
        self.stiffness_n_mm = stiffness_n_mm
        self.looseness = looseness
        self.other_faces = other_faces
        self.use_pictures = use_pictures
        self.random_state = random_state

    def fit(
        self,
        recogniser: ObjectRecogniser,
        touches: Touches,
        meshes: Mapping[str, SimObject] | None = None,
        camera: DomeCamera | None = None,
    ) -> Self:
        """Learn where the touches that `recogniser` learnt met something.

        Parameters
        ----------
        recogniser : ObjectRecogniser
            Fitted on these touches.
        touches : Touches
            The same, in the same order, with the columns `position_mm` (of the tip at
            the contact) and `direction` (unit vectors of the approach) in the frame of
            the object as it stands, z up; perhaps with `face` and `force_n`. Where z
            is counted from the ground, and the approaches of all objects aim at one
            height, faces that were never learnt may be learnt bodies turned.
        meshes : mapping of str to SimObject, optional
            Objects whose surface is taken from a mesh, on all its resting faces.
        camera : DomeCamera, optional
            The dome that is pressed on meshes.

        Raises
        ------
        ValueError
            A touch has no place, an object no map, or places are in another unit.
        """
        check_count("n_turns", self.n_turns, at_least=4)
        vars(self).pop("classes_", None)
        check_positive("tip_radius_mm", self.tip_radius_mm)
        check_positive("stiffness_n_mm", self.stiffness_n_mm)
        if self.other_faces is not None:
            check_number("other_faces", self.other_faces, low=0.0, high=0.9)
        self.recogniser = recogniser
        faces = faces_of(touches)
        pictures = FacedMap(n_turns=self.n_turns, random_state=self.random_state)
        self.pictures_ = pictures.fit_faces(recogniser, touches, faces)
        of_meshes = dict(meshes or {})
        surfaces, bodies = self._learnt(touches, faces, set(of_meshes))
        aim_mm = one_aim(bodies.values())
        dome = DomeCamera((64, 64), n_nodes=16) if camera is None else camera
        for name, thing in of_meshes.items():
            for face in range(len(thing.resting_rotations)):
                surfaces[name, face] = mesh_surface(thing, face, dome, aim_mm)
        self._refuse_unmapped(surfaces)
        self.other_share_ = self._other_share(_recordings(touches), faces)
        # A mesh has all faces that it can rest on.
        self.other_share_[np.isin(recogniser.classes_, list(of_meshes))] = 0.0
        at_middles = aims_at_middles(bodies.values(), self.tip_radius_mm)
        self.turns_bodies_ = at_middles or aim_mm is not None
        others = self._other_surfaces(surfaces, bodies, aim_mm)
        anywhere = {state: _any_face(surfaces, state[0]) for state in others}
        self.states_ = sorted(surfaces | others)
        self.table_, self.choice_table_ = (
            SurfaceTable([(surfaces | unlearnt)[state] for state in self.states_])
            for unlearnt in (others, anywhere)
        )
        names = [name for name, _ in self.states_]
        self.object_of_state_ = np.searchsorted(recogniser.classes_, names)
        number_of = {state: number for number, state in enumerate(pictures.states)}
        # Faces of a mesh that were never touched have no pictures of their own.
        self.picture_of_state_ = np.array([number_of.get(s, -1) for s in self.states_])
        forces = np.asarray(touches.columns.get("force_n", np.nan), dtype=np.float64)
        measured = forces[~np.isnan(forces)]
        self.force_n_ = float(np.median(measured)) if len(measured) else np.nan
        self.classes_ = recogniser.classes_  # from here on it is fitted
        return self

    def _learnt(
        self, touches: Touches, faces: Indices, skipped: set[str]
    ) -> tuple[dict[State, RadialSurface], dict[State, Body]]:
        """Return the surfaces of all objects but those that a mesh is given for.

        And the bodies of all.
        """
        tips, ways = contacts_of(touches)
        names, number = self.recogniser.memory_.labels, _recordings(touches)
        surfaces, bodies = {}, {}
        for name, face in sorted(set(zip(names.tolist(), faces.tolist(), strict=True))):
            rows = np.flatnonzero((names == name) & (faces == face))
            if len(rows) < _LEAST_TOUCHES:
                continue
            aim = middle_of(tips[rows], ways[rows])
            middles = tips[rows] - self.tip_radius_mm * ways[rows] - aim
            bodies[name, face] = float(aim[2]), middles
            if name in skipped:
                continue
            reach = float(np.linalg.norm(middles, axis=1).max()) - self.tip_radius_mm
            if not _LEAST_MM <= reach <= _MOST_MM:
                raise ValueError(
                    "position_mm must be millimetres in the frame of the object, got "
                    f"touches of {name!r} that reach {reach:.3g} mm from its middle. "
                    "Is it metres, or another frame?"
                )
            surfaces[name, face] = learnt_surface(middles, number[rows], _PLACEMENT_MM)
        return surfaces, bodies

    def _other_surfaces(
        self,
        surfaces: Mapping[State, RadialSurface],
        bodies: Mapping[State, Body],
        aim_mm: float | None,
    ) -> dict[State, RadialSurface]:
        """Return what each object's surface may be on faces that were never learnt."""
        others = {}
        for name, share in zip(
            self.recogniser.classes_.tolist(), self.other_share_, strict=True
        ):
            if share == 0:
                continue
            body = next((b for (owner, _), b in bodies.items() if owner == name), None)
            turned = []
            if self.turns_bodies_ and body is not None:
                turned = turned_surfaces(body, aim_mm, self.tip_radius_mm)
            for number, surface in enumerate(turned or [_any_face(surfaces, name)]):
                others[name, OTHER_FACE - number] = surface
        return others

    def _other_share(self, recording: Indices, faces: Indices) -> Floats:
        """Return how often each object stands on a face that was never learnt."""
        n_objects = len(self.recogniser.classes_)
        if self.other_faces is not None or len(np.unique(faces)) == 1:
            rare = 0.5 if self.other_faces is None else self.other_faces
            return np.full(n_objects, rare)
        # The rule of Good and Turing, of one recording more.
        shares = []
        for name in self.recogniser.classes_:
            rows = self.recogniser.memory_.labels == name
            visits = np.unique(np.stack([faces[rows], recording[rows]]), axis=1)
            n_once = (np.unique(visits[0], return_counts=True)[1] == 1).sum()
            shares.append(min((n_once + 1) / (visits.shape[1] + 1), 0.5))
        return np.array(shares)

    def _refuse_unmapped(self, surfaces: Mapping[tuple[str, int], object]) -> None:
        mapped = {name for name, _ in surfaces}
        classes = self.recogniser.classes_.tolist()
        for name in classes:
            if name not in mapped:
                raise ValueError(
                    f"Every object must have a map, got none for {name!r}: fewer than "
                    f"{_LEAST_TOUCHES} touches on any face, and no mesh. Touch it, or "
                    "give meshes={name: SimObject}."
                )
        for name in sorted(mapped - set(classes)):
            raise ValueError(
                f"meshes must be of learnt objects, got {name!r}. Learn touches of it "
                "first, simulated ones if need be (explore_to_learn)."
            )

    def start(
        self,
        prior: Mapping[str, float] | None = None,
        strangers: float = STRANGERS,
        *,
        centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> PlaceBelief:
        """Return the belief before the first touch of an episode.

        Parameters
        ----------
        prior, strangers : optional
            As in `ObjectRecogniser.start`.
        centre_mm : tuple of float, default=(0, 0, 0)
            Where the middle of the object is assumed, in the frame of the arm.
        """
        check_learnt(self)
        return PlaceBelief(self, centre_mm, prior, strangers)

    def start_before(
        self, hemisphere: Hemisphere, strangers: float = STRANGERS
    ) -> PlaceBelief:
        """Return `start` with the middle of a hemisphere."""
        return self.start(None, strangers, centre_mm=hemisphere.centre_mm)

    def filters_before(
        self,
    ) -> tuple[PlaceFilter, UnlearntSurfaces, UnlearntSurfaces]:
        """Return what is filtered: known faces, those never learnt, and a stranger."""
        looseness, unlearnt = self.looseness or Looseness(), UnlearntSurfaces.before
        learnt, other = self._sizes_mm
        return (
            PlaceFilter.before(self.table_, self.n_turns, looseness),
            unlearnt(other, _OTHER_FACE_MM, looseness),
            unlearnt(np.array([learnt.mean()]), MEAN_SD_MM, looseness),
        )

    @property
    def _sizes_mm(self) -> tuple[Floats, Floats]:
        """Return mean radii of learnt faces, and those that others would have.

        Those of what was learnt of their object.
        """
        other, of_state = self.is_other_, self.object_of_state_
        learnt = self.table_.mean_mm[~other].mean(axis=(1, 2))
        belongs = of_state[other][:, None] == of_state[~other]
        return learnt, belongs @ learnt / belongs.sum(axis=1)

    @property
    def is_other_(self) -> Bools:
        """Whether each state is a face that was never learnt, (n_states,)."""
        return np.array([face <= OTHER_FACE for _, face in self.states_])

    @property
    def log_alike_(self) -> Floats:
        """Log share of learnt states in the shape of a face that was never learnt.

        (n_other, n_learnt), were it the shape of one of them: one of its size.
        """
        learnt, other = self._sizes_mm
        off = (other[:, None] - learnt) / _OTHER_FACE_MM
        return log_softmax(-(off**2) / 2, axis=1)

    @property
    def log_share_of_state(self) -> Floats:
        """Log share of a turn of each state in its object, (n_states,)."""
        # Faces that were learnt are equally likely, and so are turns.
        never = self.is_other_
        of_state, size = self.object_of_state_, len(self.other_share_)
        counts = [
            np.bincount(of_state[rows], minlength=size) for rows in (~never, never)
        ]
        learnt, others = np.maximum(counts, 1)[:, of_state]
        other = self.other_share_[of_state]
        share = np.where(never, other / others, (1 - other) / learnt)
        return np.asarray(np.log(share / self.n_turns))

    def middles(self, tips_mm: Floats, ways: Floats, forces_n: Floats) -> Floats:
        """Return the middles of the tip's ball as of touches at the force of training.

        Of tips (n, 3) pushed along `ways` with forces (n,), NaN where unknown.
        """
        deeper = (forces_n - self.force_n_) / self.stiffness_n_mm
        deeper = np.clip(np.nan_to_num(deeper), -3.0, 3.0)
        return tips_mm - (self.tip_radius_mm + deeper)[:, None] * ways

    def picture_evidence(
        self, touch: Floats, features: Floats, places: Floats
    ) -> Floats:
        """Return what pictures say, (n_touches, n_states, n_turns), in nats.

        By `touch`, log p(f | o) (n_touches, n_objects), and by features and places, NaN
        where they are not known.
        """
        nowhere = np.isnan(places).any(axis=1)
        ratio = self.pictures_.placed_ratio(features, np.nan_to_num(places))
        ratio[nowhere] = 0.0
        ratio = self.of_states(ratio)
        return self.pictures_.weighed(self.by_state(touch), ratio)

    def by_state(self, touch: Floats) -> Floats:
        """Return log p(f | state), (n_touches, n_states), by that of objects.

        Half of what is met on a face that was never learnt is like anything.
        """
        learnt = touch[:, self.object_of_state_]
        anything = logsumexp(touch, axis=1, keepdims=True) - np.log(touch.shape[1])
        broad = np.logaddexp(learnt, anything) - np.log(2)
        return np.where(self.is_other_, broad, learnt)

    def of_states(self, ratio: Floats) -> Floats:
        """Return log r of states, (n, n_states, n_turns), by that of learnt faces.

        A picture of a face that was never learnt may be of any side of the object: r^p
        is its mean over turns, and faces, where p is the weight of r.
        """
        weight = max(self.pictures_.placed_weight_, _LEAST_WEIGHT)
        powers = logsumexp(weight * ratio, axis=2) - np.log(ratio.shape[2])
        of_object = self.pictures_.object_of_state
        anywhere = [
            logsumexp(powers[:, rows], axis=1) - np.log(len(rows))
            for rows in map(np.flatnonzero, of_object == np.unique(of_object)[:, None])
        ]
        powers_of_state = np.stack(anywhere, axis=1)[:, self.object_of_state_] / weight
        learnt = (self.picture_of_state_ >= 0)[:, None]
        placed = ratio[:, self.picture_of_state_]
        return np.where(learnt, placed, powers_of_state[..., None])


class FacedMap(TouchMap):
    """A `TouchMap` whose "objects" are objects on one of their faces."""

    def fit_faces(
        self, recogniser: ObjectRecogniser, touches: Touches, faces: Indices
    ) -> Self:
        """Learn as `fit` does; `faces` (n_touches,) numbers the face of each touch."""
        self._faces = faces
        return self.fit(recogniser, touches)

    def _choose(self) -> None:
        names = self.recogniser.classes_[self.codes_].tolist()
        state_of_touch = list(zip(names, self._faces.tolist(), strict=True))
        self.states = sorted(set(state_of_touch))
        self.object_of_state = np.searchsorted(
            self.recogniser.classes_, [name for name, _ in self.states]
        )
        number = {state: k for k, state in enumerate(self.states)}
        of_touch = np.array([number[state] for state in state_of_touch])
        self.rows_of_object = [np.flatnonzero(of_touch == k) for k in number.values()]
        self.left_out_by_object = self.left_out_
        self.left_out_ = self.left_out_[:, self.object_of_state]
        super()._choose()

    def _log_prior(self) -> Floats:
        faces = np.bincount(self.object_of_state)[self.object_of_state]
        return self.recogniser.log_prior()[self.object_of_state] - np.log(faces)

    def _summed(self, joint: Floats) -> Floats:
        shares = np.exp(log_softmax(joint)).reshape(len(joint), -1, self.n_turns)
        belongs = np.eye(len(self.recogniser.classes_))[self.object_of_state]
        of_objects = shares.sum(axis=2) @ belongs
        return np.asarray(np.log(np.maximum(of_objects, 1e-300)))


def _recordings(touches: Touches) -> Indices:
    """Return the number of each touch's recording, 0 where none are told apart."""
    if touches.session is None:
        return np.zeros(len(touches), int)
    return np.unique(touches.session, return_inverse=True)[1]


def _any_face(surfaces: Mapping[State, RadialSurface], name: str) -> RadialSurface:
    """Return what an object's surfaces tell of a face that was never learnt."""
    learnt = [part for (owner, _), part in surfaces.items() if owner == name]
    radii = np.stack([surface.mean_mm for surface in learnt])
    mean, variance = float(radii.mean()), float(radii.var()) + _OTHER_FACE_MM**2
    flat = np.ones(learnt[0].mean_mm.shape)
    return RadialSurface(mean * flat, variance * flat, learnt[0].noise_mm)
