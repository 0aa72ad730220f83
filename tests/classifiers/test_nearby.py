"""Densities of each label's own touches, for very many labels."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, logsumexp

from palpate.classifiers import EncodingPool

KernelRidgeClassifier, NearbyTouches, _ = EncodingPool.MACHINES


def drawn(n_labels=20, n_each=6, seed=0, noise=0.3):
    rng = np.random.default_rng(seed)
    faces = np.random.default_rng(99).normal(size=(n_labels, 2, 5))
    codes = np.repeat(np.arange(n_labels), n_each)
    X = faces[codes, rng.integers(2, size=len(codes))]
    X = X + noise * rng.normal(size=X.shape)
    order = rng.permutation(len(codes))
    groups = np.arange(len(codes)) // 2
    return X[order], np.array([f"part {c:03d}" for c in codes])[order], groups[order]


def slow_scores(machine, X, labels, new_touches, out):
    """Log densities as the docstring has them, in double precision."""
    squared = ((new_touches[:, None] - X) ** 2).sum(axis=2)
    exponent = np.where(out, -np.inf, -squared / 2 / machine.width_**2)
    with np.errstate(divide="ignore"):
        return np.stack(
            [
                logsumexp(exponent[:, labels == c], axis=1)
                - np.log(np.maximum((~out[:, labels == c]).sum(axis=1), 1))
                for c in machine.classes_
            ],
            axis=1,
        )


def test_densities_are_those_of_each_labels_own_touches():
    X, labels, groups = drawn()
    machine = NearbyTouches().fit(X, labels, groups=groups)
    new_touches = drawn(seed=1)[0]
    none = np.zeros((len(new_touches), len(X)), bool)
    slow = slow_scores(machine, X, labels, new_touches, none)
    centred = (new_touches - machine.mean_).astype(np.float32)
    assert_allclose(machine._densities(centred, machine.width_), slow, rtol=1e-4)
    # Touches are left out with their group.
    slow = slow_scores(machine, X, labels, X, groups[:, None] == groups)
    stored, group, _ = machine._stored(X, labels, groups)
    densities = machine._densities(stored, machine.width_, group)
    assert_allclose(densities, slow, rtol=1e-4)


def test_within_the_list_ridge_regression_decides():
    X, labels, groups = drawn()
    machine = NearbyTouches().fit(X, labels, groups=groups)
    touch = drawn(seed=1)[0][0]
    listed = np.array([1, 4, 7, 8])
    rows = np.isin(labels, machine.classes_[listed])
    squared = ((X[rows, None] - X[rows]) ** 2).sum(axis=2)
    kernel = np.exp(-machine.scale_ * squared) + machine.ridge_ * np.eye(rows.sum())
    similarities = np.exp(-machine.scale_ * ((X[rows] - touch) ** 2).sum(axis=1))
    targets = (labels[rows][:, None] == machine.classes_[listed]) - 1 / 4
    slow = similarities @ np.linalg.solve(kernel, targets) + 1 / 4
    centred = (touch - machine.mean_).astype(np.float32)
    assert_allclose(machine._scores(centred, listed), slow, atol=1e-4)


def test_the_list_keeps_its_probability_and_the_others_theirs():
    X, labels, groups = drawn(n_labels=40)
    machine = NearbyTouches().fit(X, labels, groups=groups)
    new_touches = drawn(n_labels=40, seed=1)[0]
    centred = (new_touches - machine.mean_).astype(np.float32)
    densities = machine._densities(centred, machine.width_)
    by_density = np.exp(machine._log_posterior(densities))
    posterior = np.exp(machine.log_likelihood(new_touches))
    assert_allclose(posterior.sum(axis=1), 1)
    lists = np.argsort(-densities, axis=1)[:, :20]
    outside = np.ones(posterior.shape, bool)
    np.put_along_axis(outside, lists, False, axis=1)
    assert_allclose(posterior[outside], by_density[outside], atol=1e-12)
    changed = np.abs(posterior - by_density) > 1e-9
    # Within the list the regression shares out anew what it has in all.
    assert (changed & ~outside).sum() > 0.5 * len(new_touches) * 20


def test_a_label_all_of_whose_touches_are_left_out_is_impossible():
    X, labels, _ = drawn()
    groups = np.where(labels == "part 003", 0, np.arange(1, len(labels) + 1))
    machine = NearbyTouches().fit(X, labels, groups=groups)
    left_out = machine.left_out_log_likelihood()
    of_label = labels == "part 003"
    assert (left_out[of_label, 3] == -np.inf).all()
    assert np.isfinite(left_out[~of_label]).all()
    assert np.isfinite(machine.temperature_)


def test_one_group_of_all_touches_leaves_nothing_to_tell_by():
    X, labels, _ = drawn(noise=0.1)
    machine = NearbyTouches().fit(X, labels, groups=np.zeros(len(X)))
    assert np.isneginf(machine.left_out_log_likelihood()).all()
    # What was learnt is told by all the same.
    assert np.isfinite(machine.log_likelihood(X)).all()
    assert machine.score(X, labels) > 0.9
    again = machine.refit(X, labels, groups=np.zeros(len(X)))
    assert again.score(X, labels) > 0.9


def test_the_width_has_the_least_loss():
    X, labels, groups = drawn(n_labels=40)
    machine = NearbyTouches().fit(X, labels, groups=groups)
    stored, group, codes = machine._stored(X, labels, groups)

    def least_loss(width):
        """The least over temperatures; no label is over log 40 + 3 nats below."""
        scores = machine._densities(stored, width, group)
        below = scores - scores.max(axis=1, keepdims=True)

        def loss(temperature):
            shaped = np.maximum(np.exp(temperature) * below, -np.log(40) - 3)
            return -log_softmax(shaped, axis=1)[np.arange(len(codes)), codes].mean()

        return minimize_scalar(loss, bounds=(-10, 3), method="bounded").fun

    best = least_loss(machine.width_)
    for factor in (2.0, 4.0, 8.0):
        assert best <= least_loss(factor * machine.width_) + 1e-9


def test_more_touches_are_stored_with_the_width_that_was_chosen():
    X, labels, groups = drawn()
    first = labels != "part 007"
    machine = NearbyTouches().fit(X[first], labels[first], groups=groups[first])
    width = machine.width_
    machine.refit(X, labels, groups=groups)
    assert machine.width_ == width
    assert "part 007" in machine.classes_
    new_touches, truth, _ = drawn(seed=2)
    assert machine.score(new_touches, truth) > 0.7


def test_many_touches_are_told_in_pieces(monkeypatch, lower):
    X, labels, _ = drawn()
    machine = NearbyTouches().fit(X, labels)
    whole = machine.log_likelihood(X)
    lower(monkeypatch, pairs_at_once=1000)
    assert_allclose(machine.log_likelihood(X), whole, atol=1e-5)
    left_out = machine.left_out_
    assert_allclose(machine.refit(X, labels).left_out_, left_out, atol=1e-4)


@pytest.mark.parametrize(
    ("n_labels", "most", "kind"),
    [
        (20, 10**9, KernelRidgeClassifier),
        (20, 2000, KernelRidgeClassifier),
        (501, 2000, NearbyTouches),
        (501, 10**9, KernelRidgeClassifier),
    ],
)
@pytest.mark.slow
def test_a_pool_takes_what_can_tell_so_many_labels(
    monkeypatch, lower, n_labels, most, kind
):
    lower(monkeypatch, targets=most)
    X, labels, groups = drawn(n_labels, 6 if n_labels < 100 else 2)
    pool = EncodingPool({"a": 3, "b": 2}).fit(X, labels, groups=groups)
    assert {type(machine) for machine in pool.machines_.values()} == {kind}
    again = pool.refit(X, labels, groups=groups)
    assert_array_equal(again.classes_, np.unique(labels))
