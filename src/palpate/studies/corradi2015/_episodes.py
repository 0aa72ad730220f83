"""Episodes of the Corradi 2015 study: how touches are parted, and what is answered.

Everything that the study compares is a task that runs by itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._types import Floats
from ...recognition import ObjectRecogniser
from ...touches import Touches
from .._touches import Codes, coded, labels
from ._plan import LATER_TRAIN, Corradi2015Plan
from ._recognisers import (
    BagOfTouches,
    ClusterBayes,
    Densities,
    Mixtures,
    Nuisance,
    Recogniser,
)
from ._touches import Encoded, Encoder, Objects

MAIN, DEFAULT = "corradi2015", "default"
FLOORED, CLUSTERS = "with a floor", "k-means"
IDLE = {name: f"idle, {name}" for name in (MAIN, DEFAULT)}
LATER_TOUCHES = 20


@dataclass(frozen=True, eq=False)
class Partition:
    """Rows to learn from, episodes (n_episodes, n_touches) of rows, their labels."""

    train: Codes
    episodes: Codes
    truth: Codes


class Answered(NamedTuple):
    """The label after each touch, (n_episodes, n_touches), and the right ones."""

    experiment: str
    data: str
    recogniser: str
    answers: Codes
    truth: Codes
    facts: dict[str, float]


@dataclass(frozen=True)
class Compared:
    """A partition to be answered by recognisers and, given a `label`, by `default`."""

    experiment: str
    data: str
    touches: Touches
    encoded: Encoded
    partition: Partition
    compared: dict[str, Recogniser]
    label: str | None = None

    def __call__(self) -> list[Answered]:
        """Return the answers of each recogniser."""
        alone = only_idle(self.partition, self.encoded.idle)
        found = []
        for name, one in self.compared.items():
            found.append(self._answered(name, self.partition, one))
            if name == MAIN and alone is not None:
                found.append(self._answered(IDLE[MAIN], alone, one))
        if self.label is not None:
            recogniser = ObjectRecogniser(DEFAULT, label=self.label)
            recogniser.fit(self.touches[self.partition.train])
            for name, part in {DEFAULT: self.partition, IDLE[DEFAULT]: alone}.items():
                if part is not None:
                    found.append(self._answered(name, part, recogniser))
        return found

    def _answered(
        self, name: str, partition: Partition, one: Recogniser | ObjectRecogniser
    ) -> Answered:
        facts: dict[str, float] = {}
        if isinstance(one, ObjectRecogniser):
            scores = preset_beliefs(one, self.touches, partition.episodes)
        else:
            values = self.encoded.features[one.features]
            train = values[partition.train], self.encoded.codes[partition.train]
            scores = one.scores(*train, values[partition.episodes])
            facts = one.facts(*train) if isinstance(one, Mixtures) else facts
        answers: Codes = scores.argmax(axis=-1)
        known = (self.experiment, self.data, name)
        return Answered(*known, answers, partition.truth, facts)


def known_tasks(plan: Corradi2015Plan, objects: Objects) -> Iterator[Compared]:
    """Recognise the ten objects in every partition."""
    encoded = Encoder(objects.known)(objects.known)
    made = partial(Compared, "ten objects", objects.data, objects.known, encoded)
    sizes = (plan.n_train, plan.n_test, plan.few_train)
    for number in range(plan.partitions):
        seed = (plan.seed, 0, number)
        partition = draw_partition(encoded.codes, *sizes, seed)
        yield made(partition, recognisers(plan))
        if number < plan.default_partitions:
            yield made(partition, controls())
            yield made(partition, {}, "object")


def later_tasks(plan: Corradi2015Plan, touches: Touches) -> Iterator[Compared]:
    """Recognise all objects, and the categories of objects that were not learnt."""
    encoded = Encoder(touches, bags=False)(touches)
    sizes = (LATER_TRAIN, LATER_TOUCHES, LATER_TRAIN)
    partitions = [
        draw_partition(encoded.codes, *sizes, (plan.seed, 1, number))
        for number in range(plan.later_partitions)
    ]
    by_category, folds = category_folds(plan, touches, encoded)
    asked = [("all objects", "object", encoded, one) for one in partitions]
    asked += [("category", "category", by_category, fold) for fold in folds]
    for experiment, label, features, partition in asked:
        made = partial(Compared, experiment, "bathtip", touches, features, partition)
        yield made({MAIN: Densities()})
        first = experiment == "category" or partition is partitions[0]
        if first and plan.default_partitions:
            yield made(controls())
            yield made({}, label)


def recognisers(plan: Corradi2015Plan) -> dict[str, Recogniser]:
    """Return what is compared, by name."""
    mixtures = {f"mixtures of {n}": Mixtures(n, plan.seed) for n in plan.components}
    return {
        MAIN: Densities(),
        FLOORED: Densities(floor=1e-3),
        CLUSTERS: ClusterBayes(plan.clusters, plan.seed),
        **mixtures,
        "bag, Fourier": BagOfTouches("polar Fourier", plan.clusters, plan.seed),
        "bag, moments": BagOfTouches("moment-normalised", plan.clusters, plan.seed),
    }


def controls() -> dict[str, Recogniser]:
    """Return the nuisance controls, by name."""
    return {name: Nuisance(name) for name in ("disc centre", "brightness")}


def category_folds(
    plan: Corradi2015Plan, touches: Touches, encoded: Encoded
) -> tuple[Encoded, list[Partition]]:
    """Leave one object of every category out, in as many folds as they have objects."""
    categories, of_touch = np.unique(labels(touches, "category"), return_inverse=True)
    relabelled = Encoded(categories, of_touch, encoded.features, encoded.idle)
    category_of = of_touch[np.unique(encoded.codes, return_index=True)[1]]
    members = [np.flatnonzero(category_of == c) for c in range(len(categories))]
    folds = []
    for fold in range(min(len(some) for some in members)):
        left_out = [some[fold] for some in members]
        rows = np.flatnonzero(np.isin(encoded.codes, left_out))
        codes = np.unique(encoded.codes[rows], return_inverse=True)[1]
        seed = (plan.seed, 2, fold)
        orders, which = draw_orders(codes, LATER_TOUCHES, plan.orders, seed)
        train = np.setdiff1d(np.arange(len(of_touch)), rows)
        truth = category_of[np.unique(encoded.codes[rows])][which]
        folds.append(Partition(train, rows[orders], truth))
    return relabelled, folds


def unseen_beliefs(
    plan: Corradi2015Plan, objects: Objects, preset: str, n_touches: int
) -> dict[str, Floats]:
    """Return the mean posterior (n_touches, n_known) for each object never learnt."""
    recogniser = ObjectRecogniser(preset, random_state=plan.seed).fit(objects.known)
    codes = coded(objects.unseen)
    longest = min(n_touches, int(np.bincount(codes).min()))
    episodes, which = draw_orders(codes, longest, plan.orders, (plan.seed, 3))
    beliefs = preset_beliefs(recogniser, objects.unseen, episodes)
    return {
        str(name): beliefs[which == code].mean(axis=0)
        for code, name in enumerate(np.unique(labels(objects.unseen)))
    }


def draw_partition(
    codes: Codes, n_train: int, n_test: int, few_train: int, seed: Sequence[int]
) -> Partition:
    """Draw touches to learn (`few_train` where too few) and to test, by object."""
    rng = np.random.default_rng(seed)
    train, episodes = [], []
    for code in range(codes.max() + 1):
        rows = rng.permutation(np.flatnonzero(codes == code))
        enough = len(rows) >= n_train + n_test
        n_learnt = n_train if enough else min(few_train, len(rows) - n_test)
        train.append(rows[:n_learnt])
        episodes.append(rows[n_learnt : n_learnt + n_test])
    held = np.stack(episodes)
    return Partition(np.sort(np.concatenate(train)), held, np.arange(len(held)))


def draw_orders(
    codes: Codes, n_touches: int, n_orders: int, seed: Sequence[int]
) -> tuple[Codes, Codes]:
    """Draw orders of the touches of every object: rows of episodes, their codes."""
    rng = np.random.default_rng(seed)
    known = range(codes.max() + 1)
    episodes = [
        rng.permutation(np.flatnonzero(codes == code))[:n_touches]
        for code in known
        for _ in range(n_orders)
    ]
    return np.stack(episodes), np.repeat(np.arange(len(known)), n_orders)


def only_idle(partition: Partition, idle: NDArray[np.bool_] | None) -> Partition | None:
    """Return the test touches without contact, each an episode; None without any."""
    if idle is None or not idle[partition.episodes].any():
        return None
    held = idle[partition.episodes]
    truth = np.broadcast_to(partition.truth[:, np.newaxis], held.shape)[held]
    rows = partition.episodes[held][:, np.newaxis]
    return Partition(partition.train, rows, truth)


def preset_beliefs(
    recogniser: ObjectRecogniser, touches: Touches, episodes: Codes
) -> Floats:
    """Return the posterior after each touch, (n_episodes, n_touches, n_labels)."""
    rows, places = np.unique(episodes, return_inverse=True)
    log_likelihood = recogniser.log_likelihood(touches[rows])
    found = []
    for episode in places.reshape(episodes.shape):
        belief = recogniser.start()
        after = []
        for row in episode:
            belief.update_from_log_likelihood(log_likelihood[row])
            posterior = belief.posterior
            after.append([posterior[name] for name in recogniser.classes_.tolist()])
        found.append(after)
    return np.array(found)
