"""Everything the Corradi 2015 study compares, as tasks that run by themselves."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..recognition import ObjectRecogniser
from ..touches import Touches
from ._corradi2015_encodings import Codes, Encoded, Encoder, Floats
from ._corradi2015_methods import (
    BagOfTouches,
    ClusterBayes,
    Densities,
    Mixtures,
    Nuisance,
    Recogniser,
)
from ._corradi2015_plan import LATER_TRAIN, Corradi2015Plan
from ._corradi2015_runs import (
    Answers,
    Partition,
    answer,
    draw_orders,
    draw_partition,
    only_idle,
    preset_answers,
    preset_beliefs,
)
from ._corradi2015_touches import Objects
from ._recorded import labels

MAIN, DEFAULT = "corradi2015", "default"
FLOORED, CLUSTERS = "with a floor", "k-means"
IDLE = {name: f"idle, {name}" for name in (MAIN, DEFAULT)}
LATER_TOUCHES = 20


@dataclass(frozen=True)
class Answered:
    """What recognisers answered to the episodes of one partition."""

    experiment: str
    data: str
    answers: dict[str, Answers]
    truth: dict[str, Codes]
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Compared:
    """One partition to be answered by recognisers of features, or by `default`.

    Parameters
    ----------
    compared : dict
        Recognisers by name; the paper's also answers for the test touches without
        contact.
    label : {"object", "category"}, optional
        What `default` learns, from the images on; without, it does not take part.
    """

    experiment: str
    data: str
    touches: Touches
    encoded: Encoded
    partition: Partition
    compared: dict[str, Recogniser]
    label: str | None = None

    def __call__(self) -> Answered:
        """Answer on one thread, so that sums round alike everywhere."""
        done = Answered(self.experiment, self.data, {}, {})
        with threadpool_limits(limits=1):
            for name, one in self.compared.items():
                self._features(done, name, one)
            if self.label is not None:
                self._default(done, self.label)
        return done

    def _features(self, done: Answered, name: str, one: Recogniser) -> None:
        encoded, partition = self.encoded, self.partition
        done.answers[name] = answer(one, encoded, partition)
        done.truth[name] = partition.truth
        if isinstance(one, Mixtures):
            train = encoded.features[one.features][partition.train]
            done.facts[name] = one.facts(train, encoded.codes[partition.train])
        alone = only_idle(partition, encoded.idle) if name == MAIN else None
        if alone is not None:
            done.answers[IDLE[MAIN]] = answer(one, encoded, alone)
            done.truth[IDLE[MAIN]] = alone.truth

    def _default(self, done: Answered, label: str) -> None:
        asked = {DEFAULT: self.partition}
        alone = only_idle(self.partition, self.encoded.idle)
        if alone is not None:
            asked[IDLE[DEFAULT]] = alone
        partitions = list(asked.values())
        answers = preset_answers(DEFAULT, self.touches, partitions, label)
        done.answers.update(zip(asked, answers, strict=True))
        done.truth.update({name: one.truth for name, one in asked.items()})


def recognisers(plan: Corradi2015Plan) -> dict[str, Recogniser]:
    """Return what is compared, by name.

    The paper's densities; the same with a floor of 0.001 under each touch; naive
    Bayes over k-means clusters; Gaussian mixtures of several components per object;
    bags of touches over polar Fourier and moment-normalised features.
    """
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
    return {
        "disc centre": Nuisance("disc centre"),
        "brightness": Nuisance("brightness"),
    }


def known_tasks(plan: Corradi2015Plan, objects: Objects) -> Iterator[Compared]:
    """Recognise the ten objects in every partition."""
    encoded = Encoder(objects.known)(objects.known)
    made = partial(Compared, "ten objects", objects.data, objects.known, encoded)
    for number in range(plan.partitions):
        partition = _partition(plan, encoded, number)
        yield made(partition, recognisers(plan))
        if number < plan.default_partitions:
            yield made(partition, controls())
            yield made(partition, {}, "object")


def later_tasks(plan: Corradi2015Plan, touches: Touches) -> Iterator[Compared]:
    """Recognise all objects, and the categories of objects that were not learnt."""
    encoded = Encoder(touches, bags=False)(touches)
    for number in range(plan.later_partitions):
        seed = (plan.seed, 1, number)
        partition = draw_partition(
            encoded.codes, LATER_TRAIN, LATER_TOUCHES, LATER_TRAIN, seed
        )
        yield from _later("all objects", touches, encoded, partition, plan, number)
    by_category, folds = category_folds(plan, touches, encoded)
    for fold in folds:
        yield from _later("category", touches, by_category, fold, plan, 0)


def category_folds(
    plan: Corradi2015Plan, touches: Touches, encoded: Encoded
) -> tuple[Encoded, list[Partition]]:
    """Leave one object of every category out, in as many folds as they have objects."""
    assert touches.category is not None
    categories, of_touch = np.unique(touches.category, return_inverse=True)
    relabelled = Encoded(categories, of_touch, encoded.features, encoded.idle)
    category_of = of_touch[np.unique(encoded.codes, return_index=True)[1]]
    members = [np.flatnonzero(category_of == c) for c in range(len(categories))]
    folds = []
    for fold in range(min(len(some) for some in members)):
        left_out = [some[fold] for some in members]
        rows = np.flatnonzero(np.isin(encoded.codes, left_out))
        codes = np.unique(encoded.codes[rows], return_inverse=True)[1]
        orders, which = draw_orders(
            codes, LATER_TOUCHES, plan.orders, (plan.seed, 2, fold)
        )
        train = np.setdiff1d(np.arange(len(of_touch)), rows)
        truth = category_of[np.unique(encoded.codes[rows])][which]
        folds.append(Partition(train, rows[orders], truth))
    return relabelled, folds


def unseen_beliefs(
    plan: Corradi2015Plan, objects: Objects, preset: str, n_touches: int
) -> dict[str, Floats]:
    """Return the mean posterior over the known objects after each touch.

    One array (n_touches, n_known) for each object that was not learnt; all touches
    of the known ones are.
    """
    recogniser = ObjectRecogniser(preset, random_state=plan.seed).fit(objects.known)
    names, codes = np.unique(labels(objects.unseen), return_inverse=True)
    longest = min(n_touches, int(np.bincount(codes).min()))
    episodes, which = draw_orders(codes, longest, plan.orders, (plan.seed, 3))
    beliefs = preset_beliefs(recogniser, objects.unseen, episodes)
    return {
        str(name): beliefs[which == code].mean(axis=0)
        for code, name in enumerate(names)
    }


def _later(
    experiment: str,
    touches: Touches,
    encoded: Encoded,
    partition: Partition,
    plan: Corradi2015Plan,
    number: int,
) -> Iterator[Compared]:
    made = partial(Compared, experiment, "bathtip", touches, encoded, partition)
    yield made({MAIN: Densities()})
    if number == 0 and plan.default_partitions:
        yield made(controls())
        yield made({}, "category" if experiment == "category" else "object")


def _partition(plan: Corradi2015Plan, encoded: Encoded, number: int) -> Partition:
    return draw_partition(
        encoded.codes,
        plan.n_train,
        plan.n_test,
        plan.few_train,
        (plan.seed, 0, number),
    )
