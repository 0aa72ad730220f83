"""Simple recognisers, exactly as anyone would write them with scikit-learn or torch.

They are what a benchmark compares presets with. NaN counts as 0; of colour pictures
every fifth pixel counts, the three channels side by side, but for the CNN.
"""

from collections.abc import Callable
from typing import Any, Self

import cv2
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from .._extras import needed
from .._types import Array, Floats

EVERY = 5
HOG_SIDE, HOG_CELL = 32, 8
CNN_SIDE, CNN_FILTERS, CNN_EPOCHS, CNN_BATCH = 64, (16, 32, 64), 30, 32


def pictures(images: Array) -> Floats:
    """Return touches as pictures of one channel, (n_touches, n_rows, n_cols).

    Channels lie side by side; of colour pictures, whose sides are all of 40 pixels or
    more, every fifth pixel is kept.
    """
    if images.ndim == 4:
        step = EVERY if min(images.shape[1:3]) >= EVERY * HOG_CELL else 1
        thinned = images[:, ::step, ::step]
        images = np.concatenate(np.moveaxis(thinned, -1, 0), axis=2)
    return np.nan_to_num(images.astype(np.float64))


def taxels(images: Array) -> Floats:
    """Return all taxels of each touch, (n_touches, n_taxels)."""
    return pictures(images).reshape(len(images), -1)


def roots(images: Array) -> Floats:
    """Return the signed square root of all taxels, (n_touches, n_taxels)."""
    values = taxels(images)
    return np.copysign(np.sqrt(np.abs(values)), values)


def hog(images: Array) -> Floats:
    """Return histograms of oriented gradients: 9 orientations, blocks of 2 x 2 cells.

    Each picture is divided by its maximum and enlarged until its shorter side has 32
    pixels; it must have 8.
    """
    feature = needed("skimage.feature", "bench", "HOG SVM")
    transform = needed("skimage.transform", "bench", "HOG SVM")
    shown = pictures(images)
    shorter = min(shown.shape[1:])
    if shorter < HOG_CELL:
        raise ValueError(
            f"pictures must have at least {HOG_CELL} taxels on a side for HOG SVM, got "
            f"{shorter}. Leave it out."
        )
    larger = max(1, HOG_SIDE / shorter)
    shape = [round(side * larger) for side in shown.shape[1:]]
    cells = {"pixels_per_cell": (HOG_CELL, HOG_CELL), "cells_per_block": (2, 2)}
    rows = []
    for picture in shown:
        scaled = picture / (top if (top := picture.max()) > 0 else 1)
        if larger > 1:
            scaled = transform.resize(scaled, shape)
        rows.append(feature.hog(scaled, orientations=9, **cells))
    return np.stack(rows)


def rbf_by_scale(X: Floats, learnt: Floats) -> Floats:
    """Return the RBF kernel with `gamma="scale"` of the learnt touches.

    `SVC` takes it for its own kernel, many times faster where touches have thousands
    of taxels.
    """
    variance = learnt.var()
    gamma = 1 / (learnt.shape[1] * variance) if variance else 1.0
    return np.asarray(rbf_kernel(X, learnt, gamma=gamma))


def planes(images: Array) -> Array:
    """Return touches as float32 pictures, (n_touches, n_channels, n_rows, n_cols).

    They are enlarged or averaged until their longer side has 64 pixels.
    """
    shape = images.shape[1:3]
    n_rows, n_cols = (max(1, round(n * CNN_SIDE / max(shape))) for n in shape)
    how = cv2.INTER_AREA if max(shape) > CNN_SIDE else cv2.INTER_LINEAR
    channels = np.moveaxis(images.reshape(*images.shape[:3], -1), -1, 1)
    resized = np.empty((*channels.shape[:2], n_rows, n_cols), np.float32)
    for at in np.ndindex(resized.shape[:2]):
        plane = np.nan_to_num(channels[at].astype(np.float32))
        resized[at] = cv2.resize(plane, (n_cols, n_rows), interpolation=how)
    return resized


class SmallCNN(ClassifierMixin, BaseEstimator):
    """Three convolutions of 3 x 3, batch norm and pooling, and one linear layer.

    Each channel is standardised over the touches it learns from.
    """

    def fit(self, X: Array, y: Array) -> Self:
        """Learn pictures (n_touches, n_channels, n_rows, n_cols), always the same."""
        torch = needed("torch", "cnn", "The small CNN")
        self.classes_, codes = np.unique(y, return_inverse=True)
        self.mean_ = X.mean(axis=(0, 2, 3), keepdims=True)
        self.sd_ = X.std(axis=(0, 2, 3), keepdims=True)
        self.sd_[self.sd_ == 0] = 1
        n_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.net_ = _net(torch.nn, X.shape[1], len(self.classes_))
            self._learn(torch, self._standardised(X), codes)
        torch.set_num_threads(n_threads)
        return self

    def predict(self, X: Array) -> Array:
        """Return the most probable label of each picture."""
        torch = needed("torch", "cnn", "The small CNN")
        with torch.inference_mode():
            cuts = range(CNN_BATCH, len(X), CNN_BATCH)
            parts = np.array_split(self._standardised(X), cuts)
            rows = [self.net_(torch.from_numpy(part)).argmax(1) for part in parts]
        return np.asarray(self.classes_[np.concatenate(rows)])

    def _standardised(self, X: Array) -> Array:
        return np.asarray((X - self.mean_) / self.sd_, np.float32)

    def _learn(self, torch: Any, X: Array, codes: Array) -> None:
        pictures, labels = torch.from_numpy(X), torch.from_numpy(codes)
        steps = torch.optim.Adam(self.net_.parameters(), lr=1e-3)
        for _ in range(CNN_EPOCHS):
            for rows in torch.randperm(len(X)).split(CNN_BATCH):
                steps.zero_grad()
                scores = self.net_(pictures[rows])
                torch.nn.functional.cross_entropy(scores, labels[rows]).backward()
                steps.step()
        self.net_.eval()


def _net(nn: Any, n_channels: int, n_labels: int) -> Any:
    layers: list[Any] = []
    for n_filters in CNN_FILTERS:
        convolution = nn.Conv2d(n_channels, n_filters, 3, padding=1)
        pool = nn.MaxPool2d(2, ceil_mode=True)
        layers += [convolution, nn.BatchNorm2d(n_filters), nn.ReLU(), pool]
        n_channels = n_filters
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten()]
    return nn.Sequential(*layers, nn.Linear(n_channels, n_labels))


SVM = SVC(C=10, kernel=rbf_by_scale)
NEAREST = KNeighborsClassifier(3)
SIMPLE: dict[str, tuple[Callable[[Array], Floats], ClassifierMixin]] = {
    "taxels SVM": (taxels, make_pipeline(StandardScaler(), SVM)),
    "roots SVM": (roots, SVM),
    "HOG SVM": (hog, SVM),
    "3-NN": (taxels, NEAREST),
    "small CNN": (planes, SmallCNN()),
}
# Of values that are not touch, in any unit.
STANDARDISED = (SIMPLE["taxels SVM"][1], make_pipeline(StandardScaler(), NEAREST))
