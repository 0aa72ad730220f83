"""What a recogniser is compared with: values that are not touch, simple recognisers.

One that beats no nuisance control has learnt the recording, not the objects. Each
control learns and tests on the same touches as the recogniser, with the same
classifier, from nothing but its own values.

Simple recognisers are exactly as anyone would write them with scikit-learn or torch.
For them NaN counts as 0; of colour pictures every fifth pixel counts, the three
channels side by side, but for the CNN.
"""

from collections.abc import Callable, Iterator
from typing import Any, Self

import cv2
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from sklearn.utils import gen_batches

from .._extras import needed
from .._numbers import correlation, n_touches_of
from .._types import Array, Bools, Floats
from ..classifiers import KernelRidgeClassifier
from ..images import fill_dead_taxels, find_rims
from ..recognition import find_geometry
from ..touches import Touches
from ._splits import split_touches

_EVERY_NTH = 5
_HOG_SIDE, _HOG_CELL = 32, 8
_CNN_SIDE, _CNN_FILTERS, _CNN_EPOCHS, _CNN_BATCH = 64, (16, 32, 64), 30, 32
NO_CONTACT_CORRELATION, _QUIET = 0.98, 0.25
LEAST_TO_SPLIT = 4
N_QUANTILES = 64
BLOCK = 256


def disc_centres(touches: Touches) -> Floats | None:
    """Return (row, column) of each image's rim in pixels; None without a dome."""
    if find_geometry(touches) != "dome":
        return None
    images, frame = _grey(fill_dead_taxels(touches.images)), touches.no_contact
    idle = None if frame is None else _grey(fill_dead_taxels(frame[np.newaxis]))[0]
    rims = find_rims(images, no_contact=idle)
    return np.stack([rims.row, rims.col], axis=1)


def brightness(touches: Touches) -> Floats:
    """Return mean and standard deviation of each image, (n_touches, 2)."""
    blocks = _blocks(touches.images)
    rows = [[np.nanmean(b, axis=1), np.nanstd(b, axis=1)] for b in blocks]
    return np.concatenate(rows, axis=1).T


def sorted_pixels(touches: Touches) -> Floats:
    """Return quantiles of each image's pixels divided by its total.

    All taxels in order of size where there are at most 64 of them, else 64
    quantiles (of every n-th row and column, where a side is above 64): what is
    known without any geometry. Shape (n_touches, n_values).
    """
    step = -(-max(touches.images.shape[1:3]) // N_QUANTILES)
    images = touches.images[:, ::step, ::step]
    n_pixels = images[0].size
    levels = np.linspace(0, 1, min(N_QUANTILES, n_pixels))
    rows = []
    for block in _blocks(images):
        values = np.nanquantile(block, levels, axis=1).T
        total = np.nansum(np.abs(block), axis=1, keepdims=True)
        rows.append(values / np.where(total > 0, total, 1) * n_pixels)
    return np.concatenate(rows)


def without_contact(touches: Touches) -> Bools | None:
    """Return which touches look like the no-contact frame; None without one.

    Those whose correlation with it is above 0.98, and lacks less than a quarter of
    what that of a middling touch lacks: behind a gel all touches are like the frame.
    """
    frame = touches.no_contact
    if frame is None:
        return None
    idle = np.nan_to_num(np.asarray(frame, dtype=np.float64))
    parts = []
    for block in map(np.nan_to_num, _blocks(touches.images)):
        # Nothing correlates with an even frame, not even that frame.
        other = (block != idle.ravel()).any(axis=1)
        parts.append(np.where(other, 1 - correlation(block, idle), 0.0))
    unlike = np.concatenate(parts)
    limit = min(1 - NO_CONTACT_CORRELATION, _QUIET * float(np.median(unlike)))
    return np.asarray(unlike < limit)


CONTROLS: dict[str, Callable[[Touches], Floats | None]] = {
    "disc centre": disc_centres,
    "brightness": brightness,
    "sorted pixels": sorted_pixels,
}


def control_log_likelihood(
    train: Floats, labels: Array, groups: Array | None, test: Floats
) -> Floats:
    """Learn labels from nuisance values; return log-likelihoods of test touches."""
    scale = StandardScaler().fit(train)
    classifier = KernelRidgeClassifier(widths=(0.5, 2.0, 8.0))
    classifier.fit(scale.transform(train), labels, groups=groups)
    return classifier.log_likelihood(scale.transform(test))


def named_alone(touches: Touches) -> dict[str, dict[str, float]]:
    """Return what each nuisance value alone names right, and what chance does.

    The last quarter of each object's touches is asked, the others teach; objects of
    fewer than four touches are left out. Nothing where two objects are not left.
    """
    if touches.object is None:
        return {}
    names, counts = np.unique(touches.object, return_counts=True)
    kept = names[counts >= LEAST_TO_SPLIT]
    if len(kept) < 2:
        return {}
    (fold,) = split_touches(touches[np.isin(touches.object, kept)], "last")
    shares = {}
    for name, measure in CONTROLS.items():
        of_train, of_test = measure(fold.train), measure(fold.test)
        if of_train is None or of_test is None:
            continue
        labels = np.asarray(fold.train.object)
        scores = control_log_likelihood(of_train, labels, None, of_test)
        right = kept[scores.argmax(axis=1)] == fold.test.object
        shares[name] = {"right": float(right.mean()), "chance": 1 / len(kept)}
    return shares


def _grey(images: Floats) -> Floats:
    """Return images as the mean over their channels, if they have any."""
    return images if images.ndim == 3 else np.asarray(images.mean(axis=3))


def _blocks(images: Array) -> Iterator[Floats]:
    """Yield some images at a time, (n_touches, n_taxels)."""
    for rows in gen_batches(len(images), BLOCK):
        yield images[rows].reshape(len(images[rows]), -1).astype(np.float64)


def telling(figures: dict[str, Any]) -> str:
    """Return after how many touches touch and controls are to be compared.

    After the most, unless both get all right there, which tells nothing.
    """
    right: dict[str, float] = figures["accuracy"]
    controls: dict[str, dict[str, float] | None] = figures["controls"]
    curves = [c for name, c in controls.items() if c and name != "no contact"]
    some_wrong = [
        k for k in right if right[k] < 1 or all(c.get(k, 0) < 1 for c in curves)
    ]
    return [*right, *some_wrong][-1]


def as_good_alone(figures: dict[str, Any]) -> list[str]:
    """Return a sentence for each nuisance control that does as well as touch.

    Where touch gets all right, a control that was behind before only follows it.
    """
    sentences, right = [], figures["accuracy"]
    for name, curve in figures["controls"].items():
        as_good = [k for k in right if (curve or {}).get(k, -1) >= right[k]]
        if len(as_good) < len(right):
            as_good = [k for k in as_good if right[k] < 1]
        if as_good and name != "no contact":
            after = n_touches_of(", ".join(as_good))
            sentences.append(
                f"{name} alone does as well after {after}: the recogniser may have "
                "learnt the recording, not the objects."
            )
    return sentences


def _pictures(images: Array) -> Floats:
    """Return touches as pictures of one channel, (n_touches, n_rows, n_cols).

    Channels lie side by side; of colour pictures, whose sides are all of 40 pixels or
    more, every fifth pixel is kept.
    """
    if images.ndim == 4:
        step = _EVERY_NTH if min(images.shape[1:3]) >= _EVERY_NTH * _HOG_CELL else 1
        thinned = images[:, ::step, ::step]
        images = np.concatenate(np.moveaxis(thinned, -1, 0), axis=2)
    return np.nan_to_num(images.astype(np.float64))


def taxels(images: Array) -> Floats:
    """Return all taxels of each touch, (n_touches, n_taxels)."""
    return _pictures(images).reshape(len(images), -1)


def _roots(images: Array) -> Floats:
    """Return the signed square root of all taxels, (n_touches, n_taxels)."""
    values = taxels(images)
    return np.copysign(np.sqrt(np.abs(values)), values)


def _hog(images: Array) -> Floats:
    """Return histograms of oriented gradients: 9 orientations, blocks of 2 x 2 cells.

    Each picture is divided by its maximum and enlarged until its shorter side has 32
    pixels; it must have 8.
    """
    feature = needed("skimage.feature", "bench", "HOG SVM")
    transform = needed("skimage.transform", "bench", "HOG SVM")
    shown = _pictures(images)
    shorter = min(shown.shape[1:])
    if shorter < _HOG_CELL:
        raise ValueError(
            f"pictures must have at least {_HOG_CELL} taxels on a side for HOG SVM, "
            f"got {shorter}. Leave it out."
        )
    larger = max(1, _HOG_SIDE / shorter)
    shape = [round(side * larger) for side in shown.shape[1:]]
    cells = {"pixels_per_cell": (_HOG_CELL, _HOG_CELL), "cells_per_block": (2, 2)}
    rows = []
    for picture in shown:
        scaled = picture / (top if (top := picture.max()) > 0 else 1)
        if larger > 1:
            scaled = transform.resize(scaled, shape)
        rows.append(feature.hog(scaled, orientations=9, **cells))
    return np.stack(rows)


def _rbf_by_scale(X: Floats, learnt: Floats) -> Floats:
    """Return the RBF kernel with `gamma="scale"` of the learnt touches.

    `SVC` takes it for its own kernel, many times faster where touches have thousands
    of taxels.
    """
    learnt = np.asarray(learnt)  # where scikit-learn was told to give data frames
    variance = learnt.var()
    gamma = 1 / (learnt.shape[1] * variance) if variance else 1.0
    return np.asarray(rbf_kernel(X, learnt, gamma=gamma))


def _planes(images: Array) -> Array:
    """Return touches as float32 pictures, (n_touches, n_channels, n_rows, n_cols).

    They are enlarged or averaged until their longer side has 64 pixels.
    """
    shape = images.shape[1:3]
    n_rows, n_cols = (max(1, round(n * _CNN_SIDE / max(shape))) for n in shape)
    how = cv2.INTER_AREA if max(shape) > _CNN_SIDE else cv2.INTER_LINEAR
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
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(0)
                self.net_ = _net(torch.nn, X.shape[1], len(self.classes_))
                self._learn(torch, self._standardised(X), codes)
        finally:
            torch.set_num_threads(n_threads)
        return self

    def predict(self, X: Array) -> Array:
        """Return the most probable label of each picture."""
        torch = needed("torch", "cnn", "The small CNN")
        with torch.inference_mode():
            cuts = range(_CNN_BATCH, len(X), _CNN_BATCH)
            parts = np.array_split(self._standardised(X), cuts)
            rows = [self.net_(torch.from_numpy(part)).argmax(1) for part in parts]
        return np.asarray(self.classes_[np.concatenate(rows)])

    def _standardised(self, X: Array) -> Array:
        return np.asarray((X - self.mean_) / self.sd_, np.float32)

    def _learn(self, torch: Any, X: Array, codes: Array) -> None:
        pictures, labels = torch.from_numpy(X), torch.from_numpy(codes)
        steps = torch.optim.Adam(self.net_.parameters(), lr=1e-3)
        for _ in range(_CNN_EPOCHS):
            for rows in torch.randperm(len(X)).split(_CNN_BATCH):
                steps.zero_grad()
                scores = self.net_(pictures[rows])
                torch.nn.functional.cross_entropy(scores, labels[rows]).backward()
                steps.step()
        self.net_.eval()


def _net(nn: Any, n_channels: int, n_labels: int) -> Any:
    layers: list[Any] = []
    for n_filters in _CNN_FILTERS:
        convolution = nn.Conv2d(n_channels, n_filters, 3, padding=1)
        pool = nn.MaxPool2d(2, ceil_mode=True)
        layers += [convolution, nn.BatchNorm2d(n_filters), nn.ReLU(), pool]
        n_channels = n_filters
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten()]
    return nn.Sequential(*layers, nn.Linear(n_channels, n_labels))


_SVM = SVC(C=10, kernel=_rbf_by_scale)
_NEAREST = KNeighborsClassifier(3)
SIMPLE: dict[str, tuple[Callable[[Array], Floats], ClassifierMixin]] = {
    "taxels SVM": (taxels, make_pipeline(StandardScaler(), _SVM)),
    "roots SVM": (_roots, _SVM),
    "HOG SVM": (_hog, _SVM),
    "3-NN": (taxels, _NEAREST),
    "small CNN": (_planes, SmallCNN()),
}
# Of values that are not touch, in any unit.
STANDARDISED = (SIMPLE["taxels SVM"][1], make_pipeline(StandardScaler(), _NEAREST))
