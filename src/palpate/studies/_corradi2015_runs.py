"""Partitions of touches into training and test touches, and what becomes of them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recognition import ObjectRecogniser
from ..touches import Touches
from ._corradi2015_encodings import Codes, Encoded, Floats
from ._corradi2015_methods import Recogniser

Answers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Partition:
    """Rows to learn from, and episodes to recognise.

    `episodes` (n_episodes, n_touches) are rows of the touches in the order of the
    episode, `truth` (n_episodes,) the label of each. `tested` are the touches that
    episodes index, where they are others than the training touches.
    """

    train: Codes
    episodes: Codes
    truth: Codes


@dataclass
class Outcome:
    """Answers (n_episodes, n_touches) of each partition, and their truth."""

    answers: list[Answers] = field(default_factory=list)
    truth: list[Codes] = field(default_factory=list)
    facts: list[dict[str, Any]] = field(default_factory=list)

    def accuracy(self) -> Floats:
        """Return the share right, (n_partitions, n_touches)."""
        pairs = zip(self.answers, self.truth, strict=True)
        return np.array([(a == t[:, np.newaxis]).mean(axis=0) for a, t in pairs])

    def confusion(self, k: int, n_labels: int) -> Floats:
        """Return the share of each answer (columns) after k touches per label."""
        counts = np.zeros((n_labels, n_labels))
        for answers, truth in zip(self.answers, self.truth, strict=True):
            np.add.at(counts, (truth, answers[:, k - 1]), 1)
        return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)


def draw_partition(
    codes: Codes, n_train: int, n_test: int, few_train: int, seed: Sequence[int]
) -> Partition:
    """Draw the training and test touches of every object at random.

    Objects of fewer than `n_train` + `n_test` touches give `few_train`, or what is
    left beside the test touches.
    """
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


def answer(recogniser: Recogniser, encoded: Encoded, partition: Partition) -> Answers:
    """Return the answer after each touch of each episode."""
    values = encoded.features[recogniser.features]
    train, codes = values[partition.train], encoded.codes[partition.train]
    scores = recogniser.scores(train, codes, values[partition.episodes])
    return scores.argmax(axis=-1)


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


def preset_answers(
    preset: str, touches: Touches, partitions: Sequence[Partition], label: str
) -> list[Answers]:
    """Learn with a preset, everything from the images on; see `answer`.

    The partitions have the same training touches.
    """
    recogniser = ObjectRecogniser(preset, label=label)
    recogniser.fit(touches[partitions[0].train])
    return [
        preset_beliefs(recogniser, touches, one.episodes).argmax(axis=-1)
        for one in partitions
    ]
