"""What a network of the user's own brings `default`, for docs/howto/encoder.md.

Run as `python benchmarks/network_encoding.py FOLDER OUT.json [--draws 3]`, with the
folder of recorded touches. Half of the objects (drawn) teach a small convolutional
network to tell them; its last layer but one then encodes touches of the other half,
which the network never met: the first three quarters of each recording are learnt, or
the first sessions, and the rest is recognised. Needs torch and onnxscript.
"""

import argparse
import json
import logging
import time
import warnings
from pathlib import Path

import cv2
import numpy as np
import torch
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from palpate import ObjectRecogniser, Touches
from palpate._durable import write_text
from palpate.encodings import OnnxEncoding, PrincipalShare
from palpate.evaluation import split_touches
from palpate.evaluation._splits import draw_touches
from palpate.images import ChannelMean, DomeCrop
from palpate.recognition import find_geometry

SIDE, EPOCHS, BATCH = 64, 40, 64
N_TRAIN, LENGTHS, ORDERS = 40, (1, 5), 20
SETS = {
    "dome": ("bathtip/bathtip50.npz", "last"),
    "DIGIT": ("sessions/digit_survey.npz", "last"),
    "hand": ("sessions/sdh2_september.npz", "last"),
}


def main() -> None:
    """Measure all sets and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--draws", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    logging.disable(logging.WARNING)
    result = {}
    for name, (file, split) in SETS.items():
        touches = with_parts(Touches.load(options.folder / file))
        rows = [compared(touches, split, seed) for seed in range(options.draws)]
        result[name] = rows
        for method in rows[0]:
            mean = np.mean([row[method] for row in rows], axis=0)
            spread = np.std([row[method] for row in rows], axis=0)
            print(
                f"{name:6} {method:22} {mean.round(1)} ({spread.round(1)})", flush=True
            )
        write_text(options.out, json.dumps(result, indent=1) + "\n")


def with_parts(touches: Touches) -> Touches:
    """Return touches whose objects are their parts, where there are few objects."""
    if "part" not in touches.columns:
        return touches
    both = np.char.add(touches.object, touches.columns["part"].astype(str))
    return touches.with_columns(object=both)


def compared(touches: Touches, split: str, seed: int) -> dict[str, list[float]]:
    """Return per cent right after 1 and 5 touches, and learning's CPU seconds."""
    names = np.random.default_rng(seed).permutation(np.unique(touches.object))
    others = np.isin(touches.object, names[: len(names) // 2])
    network = taught_network(touches[others], seed)
    unseen = touches[~others]
    few = names[len(names) // 2 :][:10]
    unseen = unseen[np.isin(unseen.object, few)]
    (fold, *_) = split_touches(unseen, split)
    train = draw_touches(fold.train, N_TRAIN, seed)
    encoding = {"network": [OnnxEncoding(network), PrincipalShare(0.99)]}
    recognisers = {
        "default": ObjectRecogniser(),
        "default and network": ObjectRecogniser(encodings=encoding),
        "network alone": ObjectRecogniser(None, encodings=encoding),
        "pixels, LDA": ObjectRecogniser(
            None,
            encodings={"pixels": [Small(), PrincipalShare(0.9)]},
            classifier=LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"),
        ),
    }
    return {
        method: figures(recogniser, train, fold.test, seed)
        for method, recogniser in recognisers.items()
    }


class Small(TransformerMixin, BaseEstimator):
    """Pixels of a small grey copy, as the network gets them."""

    def fit(self, X: object, y: object = None) -> "Small":
        """Learn nothing."""
        return self

    def transform(self, X: object) -> np.ndarray:
        """Return the small copies as vectors."""
        vectors = small(np.asarray(X)).reshape(len(np.asarray(X)), -1)
        return vectors - vectors.mean(axis=1, keepdims=True)


def figures(
    recogniser: ObjectRecogniser, train: Touches, test: Touches, seed: int
) -> list[float]:
    """Return per cent right after 1 and 5 touches, and CPU seconds of learning."""
    begun = time.process_time()
    recogniser.fit(train)
    seconds = time.process_time() - begun
    rng, right = np.random.default_rng(seed), {k: [] for k in LENGTHS}
    evidence = recogniser.evidence(test)
    for name in np.unique(test.object):
        rows = np.flatnonzero(test.object == name)
        for _ in range(ORDERS):
            belief = recogniser.start(strangers=0)
            for k, row in enumerate(rng.permutation(rows)[: max(LENGTHS)]):
                belief.update(evidence.of_touch(int(row)))
                if k + 1 in LENGTHS:
                    right[k + 1].append(belief.best == name)
    return [*(100 * float(np.mean(right[k])) for k in LENGTHS), seconds]


def small(images: np.ndarray) -> np.ndarray:
    """Return grey images in one size, float32; dead taxels are 0."""
    levels = np.nan_to_num(np.asarray(images, np.float32))
    levels = ChannelMean().transform_checked(levels)
    return np.stack([cv2.resize(image, (SIDE, SIDE)) for image in levels])


def taught_network(touches: Touches, seed: int) -> np.ndarray:
    """Return a network that tells objects, but for its last layer, as ONNX bytes."""
    torch.manual_seed(seed)
    # Encodings get the disc about the rim of a dome.
    clean = touches.images
    if find_geometry(touches) == "dome":
        grey = ChannelMean().transform_checked(clean)
        clean = DomeCrop().fit_transform(grey, no_contact=touches.no_contact)
    levels = small(clean)
    X = torch.tensor((levels - levels.mean()) / levels.std())[:, None]
    names, codes = np.unique(touches.object, return_inverse=True)
    y = torch.tensor(codes)

    def block(n_in: int, n_out: int) -> list[torch.nn.Module]:
        layers = torch.nn.Conv2d(n_in, n_out, 3, padding=1), torch.nn.BatchNorm2d(n_out)
        return [*layers, torch.nn.ReLU(), torch.nn.MaxPool2d(2)]

    body = torch.nn.Sequential(
        *block(1, 16), *block(16, 32), *block(32, 64),
        torch.nn.AdaptiveAvgPool2d(4), torch.nn.Flatten(),
        torch.nn.Linear(1024, 64), torch.nn.ReLU(),
    )  # fmt: skip
    network = torch.nn.Sequential(
        body, torch.nn.Dropout(0.3), torch.nn.Linear(64, len(names))
    )
    optimiser = torch.optim.AdamW(network.parameters(), 1e-3, weight_decay=1e-2)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(X)).split(BATCH):
            if len(rows) < 2:
                continue
            shift = tuple(torch.randint(-3, 4, (2,)).tolist())
            batch = torch.roll(X[rows], shift, (2, 3)) * (0.8 + 0.4 * torch.rand(1))
            optimiser.zero_grad()
            loss = torch.nn.functional.cross_entropy(network(batch), y[rows])
            loss.backward()
            optimiser.step()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            body.eval(), (X[:2],), dynamic_shapes=({0: "n"},), verbose=False
        )
    return np.frombuffer(program.model_proto.SerializeToString(), dtype=np.uint8)


if __name__ == "__main__":
    main()
