"""Episodes of the Corradi 2015 study: how touches are parted and answered; rows.

Everything that the study compares is a task that runs by itself. Answers and beliefs
become rows; so do timings.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from sklearn.decomposition import PCA

from ..._numbers import n_touches_of
from ..._types import Bools, Floats, Label, PresetName
from ...classifiers import KernelDensityBayes
from ...recognition import ObjectRecogniser
from ...touches import Touches
from .. import Codes, Row, coded, labels, mean_row, row, spread
from . import plan as stated
from . import recognisers as known_by
from .plan import LATER_TRAIN, PAPER_MS, Corradi2015Plan, Encoded, Objects
from .recognisers import BagOfTouches, ClusterBayes, Densities, Mixtures, Recogniser

MAIN: PresetName = "corradi2015"
DEFAULT: PresetName = "default"
FLOORED, CLUSTERS = "with a floor", "k-means"
IDLE = {name: f"idle, {name}" for name in (MAIN, DEFAULT)}
_CONTROLS: dict[str, Recogniser] = {
    name: known_by.Nuisance(name) for name in ("disc centre", "brightness")
}
LATER_TOUCHES = 20  # the most that the paper asks for
# Touches after which the confusion, and the belief about a stranger, are shown.
CONFUSED_AFTER = (5, 15)
UNSEEN_AFTER = (1, 5, 10, 30)
_FIGURES: dict[tuple[str, str], dict[int, float]] = {
    ("ten objects", MAIN): stated.PAPER,
    ("ten objects", CLUSTERS): stated.PAPER_CLUSTERS,
    ("all objects", MAIN): stated.LATER_OBJECTS,
    ("category", MAIN): stated.LATER_CATEGORY,
}


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
    label: Label | None = None

    def __call__(self) -> list[Answered]:
        alone = only_idle(self.partition, self.encoded.idle)
        answers = []
        for name, recogniser in self.compared.items():
            answers.append(self._answered(name, self.partition, recogniser))
            if name == MAIN and alone is not None:
                answers.append(self._answered(IDLE[MAIN], alone, recogniser))
        if self.label is not None:
            recogniser = ObjectRecogniser(DEFAULT, label=self.label)
            recogniser.fit(self.touches[self.partition.train])
            for name, part in {DEFAULT: self.partition, IDLE[DEFAULT]: alone}.items():
                if part is not None:
                    answers.append(self._answered(name, part, recogniser))
        return answers

    def _answered(
        self, name: str, partition: Partition, recogniser: Recogniser | ObjectRecogniser
    ) -> Answered:
        facts: dict[str, float] = {}
        if isinstance(recogniser, ObjectRecogniser):
            scores = preset_beliefs(recogniser, self.touches, partition.episodes)
        else:
            values = self.encoded.features[recogniser.features]
            train = values[partition.train], self.encoded.codes[partition.train]
            scores = recogniser.scores(*train, values[partition.episodes])
            if isinstance(recogniser, Mixtures):
                facts = recogniser.facts(*train)
        answers: Codes = scores.argmax(axis=-1)
        origin = (self.experiment, self.data, name)
        return Answered(*origin, answers, partition.truth, facts)


def learnt_tasks(plan: Corradi2015Plan, objects: Objects) -> Iterator[Compared]:
    """Recognise the ten objects in every partition."""
    encoded = stated.encode(objects.learnt)
    compared = partial(Compared, "ten objects", objects.data, objects.learnt, encoded)
    sizes = (plan.n_train, plan.n_test, plan.few_train)
    for number in range(plan.partitions):
        partition = draw_partition(encoded.codes, *sizes, (plan.seed, 0, number))
        yield compared(partition, recognisers(plan))
        if number < plan.default_partitions:
            yield compared(partition, _CONTROLS)
            yield compared(partition, {}, "object")


def later_tasks(plan: Corradi2015Plan, touches: Touches) -> Iterator[Compared]:
    """Recognise all objects, and the categories of objects that were not learnt."""
    encoded = stated.encode(touches, bags=False)
    sizes = (LATER_TRAIN, LATER_TOUCHES, LATER_TRAIN)
    partitions = [
        draw_partition(encoded.codes, *sizes, (plan.seed, 1, number))
        for number in range(plan.later_partitions)
    ]
    by_category, folds = category_folds(plan, touches, encoded)
    comparisons: list[tuple[str, Label, Any, Any]]
    comparisons = [("all objects", "object", encoded, p) for p in partitions]
    comparisons += [("category", "category", by_category, fold) for fold in folds]
    for experiment, label, features, partition in comparisons:
        part = partial(Compared, experiment, "bathtip", touches, features, partition)
        yield part({MAIN: Densities()})
        first = experiment == "category" or partition is partitions[0]
        if first and plan.default_partitions:
            yield part(_CONTROLS)
            yield part({}, label)


def recognisers(plan: Corradi2015Plan) -> dict[str, Recogniser]:
    mixtures = {f"mixtures of {n}": Mixtures(n, plan.seed) for n in plan.components}
    return {
        MAIN: Densities(),
        FLOORED: Densities(floor=1e-3),
        CLUSTERS: ClusterBayes(plan.clusters, plan.seed),
        **mixtures,
        "bag, Fourier": BagOfTouches(plan.clusters, plan.seed, "polar Fourier"),
        "bag, moments": BagOfTouches(plan.clusters, plan.seed, "moment-normalised"),
    }


def category_folds(
    plan: Corradi2015Plan, touches: Touches, encoded: Encoded
) -> tuple[Encoded, list[Partition]]:
    """Leave one object of every category out, in as many folds as they have objects."""
    categories, of_touch = np.unique(labels(touches, "category"), return_inverse=True)
    relabelled = Encoded(categories, of_touch, encoded.features, encoded.idle)
    category_of = of_touch[np.unique(encoded.codes, return_index=True)[1]]
    members = [np.flatnonzero(category_of == c) for c in range(len(categories))]
    folds = []
    for fold in range(min(len(numbers) for numbers in members)):
        left_out = [numbers[fold] for numbers in members]
        rows = np.flatnonzero(np.isin(encoded.codes, left_out))
        codes = np.unique(encoded.codes[rows], return_inverse=True)[1]
        seed = (plan.seed, 2, fold)
        orders, which = draw_orders(codes, LATER_TOUCHES, plan.orders, seed)
        train = np.setdiff1d(np.arange(len(of_touch)), rows)
        truth = category_of[np.unique(encoded.codes[rows])][which]
        folds.append(Partition(train, rows[orders], truth))
    return relabelled, folds


def unseen_beliefs(
    plan: Corradi2015Plan, objects: Objects, preset: PresetName
) -> dict[str, Floats]:
    """Return the mean posterior (n_touches, n_known) for each object never learnt."""
    recogniser = ObjectRecogniser(preset, random_state=plan.seed).fit(objects.learnt)
    codes = coded(objects.unseen)
    longest = min(plan.n_test, int(np.bincount(codes).min()))
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
    labels_drawn = range(codes.max() + 1)
    episodes = [
        rng.permutation(np.flatnonzero(codes == code))[:n_touches]
        for code in labels_drawn
        for _ in range(n_orders)
    ]
    return np.stack(episodes), np.repeat(np.arange(len(labels_drawn)), n_orders)


def only_idle(partition: Partition, idle: Bools | None) -> Partition | None:
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
    posteriors = []
    for episode in places.reshape(episodes.shape):
        belief = recogniser.start(strangers=0)
        after = []
        for touch in episode:
            belief.update_from_log_likelihood(log_likelihood[touch])
            posterior = belief.posterior
            after.append([posterior[name] for name in recogniser.classes_.tolist()])
        posteriors.append(after)
    return np.array(posteriors)


def experiment_rows(answered: Iterable[Answered], plan: Corradi2015Plan) -> list[Row]:
    """Return the rows of every experiment, data, recogniser and number of touches."""
    together: dict[tuple[str, str, str], list[Answered]] = {}
    for answer in answered:
        together.setdefault(answer[:3], []).append(answer)
    rows = []
    for (experiment, data, name), answers in together.items():
        origin = {"data": data, "table": experiment, "recogniser": name}
        names = answers[0].facts
        facts = {n: float(np.mean([a.facts[n] for a in answers])) for n in names}
        if name in IDLE.values():
            # Of all touches without contact, however they fell.
            right = np.concatenate([a.answers[:, 0] == a.truth for a in answers])
            curve = np.array([[right.mean()]])
        else:
            curve = accuracy(answers)
        for k in plan.touches:
            if k <= curve.shape[1]:
                paper = _FIGURES.get((experiment, name), {}).get(k)
                shown = after_touches(experiment, name, k)
                sizes = {**origin, "touches": k, "partitions": len(answers), **facts}
                rows.append(mean_row(shown, 100 * curve[:, k - 1], paper, **sizes))
    return rows


def after_touches(table: str, recogniser: str, k: int) -> str:
    return f"{table}, {recogniser}, {n_touches_of(k)}"


def accuracy(answered: Iterable[Answered]) -> Floats:
    """Return the share right, (n_partitions, n_touches)."""
    return np.array(
        [(a.answers == a.truth[:, np.newaxis]).mean(axis=0) for a in answered]
    )


def confusion(answered: Iterable[Answered], k: int, n_labels: int) -> Floats:
    """Return the share of each answer (columns) after k touches per label."""
    counts = np.zeros((n_labels, n_labels))
    for answer in answered:
        np.add.at(counts, (answer.truth, answer.answers[:, k - 1]), 1)
    return np.asarray(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1))


def confusions(
    answered: Iterable[Answered], objects: Objects, plan: Corradi2015Plan
) -> dict[str, Any]:
    """Return shares of answers (columns) per object (rows), and the worst pairs."""
    of_main = [a for a in answered if a[:3] == ("ten objects", objects.data, MAIN)]
    names = np.unique(labels(objects.learnt)).tolist()
    after = sorted({min(k, plan.n_test) for k in CONFUSED_AFTER})
    matrices = {str(k): confusion(of_main, k, len(names)) for k in after}
    return {
        "names": names,
        "after": {k: matrix.round(4).tolist() for k, matrix in matrices.items()},
        "pairs": {k: worst_pairs(matrix, names) for k, matrix in matrices.items()},
    }


def worst_pairs(confusion: Floats, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the three pairs most often taken for each other, worst first."""
    both = (confusion + confusion.T) / 2
    above = np.transpose(np.triu_indices(len(names), 1)).tolist()
    pairs = sorted(above, key=lambda pair: -both[*pair])[:3]
    return [
        {"objects": [names[i], names[j]], "share": float(100 * both[i, j])}
        for i, j in pairs
    ]


def unseen_rows(
    beliefs: Mapping[PresetName, dict[str, Floats]], objects: Objects
) -> list[Row]:
    """Return which known object each unseen one is taken for, after some touches."""
    names = np.unique(labels(objects.learnt)).tolist()
    curve_of = [(p, n, c) for p, curves in beliefs.items() for n, c in curves.items()]
    rows = []
    for (preset, name, curve), k in product(curve_of, UNSEEN_AFTER):
        if k > len(curve):
            continue
        belief = curve[k - 1]
        order = np.argsort(-belief, kind="stable")[:3].tolist()
        share = {names[i]: float(100 * belief[i]) for i in order}
        best = names[order[0]]
        shown = after_touches(f"{name} taken for {best}", preset, k)
        facts: Row = {"data": objects.data, "table": "unseen", "recogniser": preset}
        facts |= {"unseen": name, "touches": k, "beliefs": share}
        rows.append(row(shown, share[best], **facts))
    return rows


def timing_rows(touches: Touches, data: str, sizes: Sequence[int]) -> list[Row]:
    """Return CPU milliseconds, medians, one touch at a time."""
    timed = touches[: min(len(touches), max(sizes))]
    (crop, moments), images = stated.disc_and_moments(timed), timed.images
    discs = crop.transform(images)
    values = moments.fit(discs).transform(discs)

    def whole(i: int) -> object:
        return moments.transform(crop.transform(images[i : i + 1]))

    def alone(i: int) -> object:
        return moments.transform(discs[i : i + 1])

    disc, frame = (" x ".join(map(str, array.shape[1:])) for array in (discs, images))
    rows = [
        _timed(f"Zernike moments of a disc, {disc}", PAPER_MS["encode", 0], alone),
        _timed(f"rim, disc and moments of an image, {frame}", None, whole),
    ]
    for size in sizes:
        if len(values) >= size:
            rows += _learning(values[:size])
    return [{**row, "data": data, "table": "timings", "unit": "ms"} for row in rows]


def _learning(values: Floats) -> list[Row]:
    size = len(values)
    codes = np.arange(size) % stated.N_KNOWN

    def learn(_: int) -> tuple[PCA, KernelDensityBayes]:
        principal = known_by.principal_components(values)
        model = KernelDensityBayes().fit(principal.transform(values), codes)
        return principal, model

    principal, model = learn(0)

    def recognise(i: int) -> None:
        model.log_likelihood(principal.transform(values[i : i + 1]))

    learning, recognising = (PAPER_MS.get((w, size)) for w in ("learn", "recognise"))
    return [
        _timed(f"learn {size} touches", learning, learn, times=15),
        _timed(f"recognise a touch among {size}", recognising, recognise),
    ]


def _timed(
    name: str, paper: float | None, work: Callable[[int], object], times: int = 60
) -> Row:
    spent = []
    work(0)
    for i in range(times):
        start = time.process_time()
        work(i)
        spent.append(1e3 * (time.process_time() - start))
    return row(f"{name}, ms", np.median(spent), spread(np.array(spent)), paper)
