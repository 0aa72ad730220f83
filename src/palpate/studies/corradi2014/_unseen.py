"""The category of objects never touched in training, for each encoding.

Each fold leaves one object of every category out. The best of several encodings is
chosen by inner folds of the same kind among the training objects alone, so the
objects that are reported have no say in it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import logsumexp

from ..._types import Floats
from ...classifiers import KernelDensityBayes, KernelRidgeClassifier
from ...encodings import RootScaler, encoder_named
from ...touches import Touches
from .._report import Row, mean_row
from .._touches import Codes, coded
from ._judge import Encoded, encode
from ._plan import CLASSIFIERS, Corradi2014Plan
from ._shapes import Images, rim_discs, variants

DATA = "bathtip50, unseen objects"
LENGTHS = (1, 10)
N_ORDERS = 50
FOUNDATION = "zernike-pca"
CHOSEN = "chosen on the training objects"
_KNOWN = {"data": DATA, "unit": "per cent"}
# Encodings by name: (encoding, options, variant) of each part.
Part = tuple[str, dict[str, Any], str]
CANDIDATES: dict[str, tuple[Part, ...]] = {
    "zernike": (("zernike", {}, "image"),),
    "zernike to order 20": (("zernike", {"order": 20}, "image"),),
    "zernike to order 30": (("zernike", {"order": 30}, "image"),),
    "zernike, image and derivative": (
        ("zernike", {}, "image"),
        ("zernike", {}, "derivative"),
    ),
    "polar gradients": (("polar-gradients", {}, "image"),),
    "polar gradients and zernike to order 30": (
        ("polar-gradients", {}, "image"),
        ("zernike", {"order": 30}, "image"),
    ),
}


@dataclass(frozen=True, eq=False)
class Recording:
    """Touches cut to discs; `codes` are categories, `fold` numbers their objects."""

    images: dict[str, Images]
    codes: Codes
    objects: Codes
    fold: Codes

    def only(self, *variants: str) -> "Recording":
        """Return the same touches with the images of these variants alone."""
        return replace(self, images={v: self.images[v] for v in variants})


def recording(touches: Touches) -> Recording:
    """Cut the touches to discs and number the objects of each category."""
    codes, objects = coded(touches, "category"), coded(touches)
    fold = np.zeros(len(codes), dtype=np.intp)
    for category in np.unique(codes):
        mine = codes == category
        fold[mine] = np.unique(objects[mine], return_inverse=True)[1]
    return Recording(variants(rim_discs(touches)), codes, objects, fold)


def judge_unseen(
    seen: Recording, variant: str, name: str, plan: Corradi2014Plan
) -> list[Row]:
    """Return one row per classifier: one touch names the category, per cent."""
    counts = plan.counts(name)[1::2]
    encoded = encode(name, seen.images[variant], None, counts)
    rows = []
    for kind in CLASSIFIERS:
        folds = range(plan.fold_limit)
        found = [_judge_fold(encoded, seen, kind, k, counts, plan) for k in folds]
        right = np.array([share for share, _ in found])
        one = {"table": "unseen", "encoding": name, "variant": variant}
        kept = {"classifier": kind, "n_components": [count for _, count in found]}
        shown = mean_row(f"{name}, {kind}, {variant}", right)
        rows.append({**shown, **_KNOWN, **one, **kept})
    return rows


def candidate_features(seen: Recording, name: str) -> list[Floats]:
    """Return the features of each part of a candidate.

    What polar gradients learn (a scale per channel) is undone by the scaling of
    each feature on the training touches, so all touches may teach it.
    """
    parts = CANDIDATES["zernike" if name == FOUNDATION else name]
    return [
        encoder_named(encoding, **options).fit_transform(seen.images[variant])
        for encoding, options, variant in parts
    ]


def compare_fold(
    seen: Recording, features: dict[str, list[Floats]], k: int, plan: Corradi2014Plan
) -> dict[str, Any]:
    """Choose among candidates without fold `k`'s objects, then test them all on it.

    Returns `chosen`, `inner` (per cent of inner folds) and `right`, after each number
    of touches, also of the foundation as its paper has it.
    """
    test, known = np.flatnonzero(seen.fold == k), np.flatnonzero(seen.fold != k)
    train = known[:: plan.thinning]
    inner, right = {}, {}
    for name, parts in features.items():
        inner[name] = _inner(seen, name, parts, known, plan)
        posterior = _log_posterior(seen, name, parts, train, test)
        right[name] = _right_after(seen, posterior, test)
    # The foundation's own classifier.
    old, new = _zernike_pca(features[FOUNDATION][0], train, test)
    scores = KernelDensityBayes().fit(old, seen.codes[train]).log_likelihood(new)
    density = scores - logsumexp(scores, axis=1, keepdims=True)
    right[f"{FOUNDATION}, kernel density"] = _right_after(seen, density, test)
    chosen = max(inner, key=lambda name: inner[name])
    return {"chosen": chosen, "inner": inner, "right": right}


def compared_rows(results: list[dict[str, Any]]) -> list[Row]:
    """Return rows of each candidate, of the chosen ones, and of their lead."""
    after = {
        name: np.array([result["right"][name] for result in results])
        for name in results[0]["right"]
    }
    after[CHOSEN] = np.array([r["right"][r["chosen"]] for r in results])
    after[f"{CHOSEN}, less {FOUNDATION}"] = after[CHOSEN] - after[FOUNDATION]
    rows = []
    chosen = [result["chosen"] for result in results]
    for name, right in after.items():
        for length, folds in zip(LENGTHS, right.T, strict=True):
            shown = mean_row(f"{name}, after {length}", folds)
            known = {**_KNOWN, "table": "best", "encoding": name, "after": length}
            what = {"folds_right": folds.tolist(), "chosen": chosen}
            rows.append({**shown, **known, **what})
    return rows


def _judge_fold(
    encoded: Encoded,
    seen: Recording,
    kind: str,
    k: int,
    counts: tuple[int, ...],
    plan: Corradi2014Plan,
) -> tuple[float, int]:
    """Return per cent right on fold `k` and the count its training objects chose."""
    known, test = np.flatnonzero(seen.fold != k), np.flatnonzero(seen.fold == k)
    # The network takes the machines' count: it would be chosen for minutes.
    chooser = "SVMs" if kind == "network" else kind
    left_out = seen.fold[known] == (k + 1) % (seen.fold.max() + 1)
    held = known[left_out][:: 2 * plan.thinning]
    rest = known[~left_out][:: 4 * plan.thinning]
    shares = encoded.right(chooser, seen.codes, rest, held, counts, plan.seed)
    chosen = counts[int(np.argmax(shares))]
    train = known[:: 2 * plan.thinning]
    (share,) = encoded.right(kind, seen.codes, train, test, (chosen,), plan.seed)
    return share, chosen


def _inner(
    seen: Recording,
    name: str,
    parts: list[Floats],
    known: Codes,
    plan: Corradi2014Plan,
) -> float:
    """Mean share right on left-out objects among the known ones, after one touch."""
    thin = known[:: 2 * plan.thinning]
    right = []
    for held in np.unique(seen.fold[known])[: plan.fold_limit]:
        train = thin[seen.fold[thin] != held]
        test = thin[seen.fold[thin] == held]
        log_posterior = _log_posterior(seen, name, parts, train, test)
        right.append(_right_after(seen, log_posterior, test)[0])
    return float(np.mean(right))


def _log_posterior(
    seen: Recording, name: str, parts: list[Floats], train: Codes, test: Codes
) -> Floats:
    """Kernel ridge on scaled features, told which touches are of one object."""
    if name == FOUNDATION:
        old, new = _zernike_pca(parts[0], train, test)
    else:
        scalers = [RootScaler().fit(part[train]) for part in parts]
        both = list(zip(scalers, parts, strict=True))
        old = np.hstack([scaler.transform(part[train]) for scaler, part in both])
        new = np.hstack([scaler.transform(part[test]) for scaler, part in both])
    model = KernelRidgeClassifier(max_choice_touches=800)
    model.fit(old, seen.codes[train], groups=seen.objects[train])
    log_posterior: Floats = model.predict_log_proba(new)
    return log_posterior


def _zernike_pca(moments: Floats, train: Codes, test: Codes) -> tuple[Floats, Floats]:
    """Components that hold 95 % of the training touches' variance."""
    encoded = Encoded({0: moments}, {0: moments}, principal=True)
    every = moments.shape[1]
    old, new = encoded.features(train, test, (every,))[every]
    share = np.cumsum(old.var(axis=0)) / old.var(axis=0).sum()
    kept = int(np.searchsorted(share, 0.95)) + 1
    return old[:, :kept], new[:, :kept]


def _right_after(seen: Recording, log_posterior: Floats, test: Codes) -> list[float]:
    """Per cent right after one touch, and after ten in random orders."""
    single = 100 * (log_posterior.argmax(axis=1) == seen.codes[test]).mean()
    rng = np.random.default_rng(0)
    right = []
    for one in np.unique(seen.objects[test]):
        rows = np.flatnonzero(seen.objects[test] == one)
        for _ in range(N_ORDERS):
            drawn = rng.permutation(rows)[: LENGTHS[1]]
            said = log_posterior[drawn].sum(axis=0).argmax()
            right.append(said == seen.codes[test[rows[0]]])
    return [float(single), float(100 * np.mean(right))]
