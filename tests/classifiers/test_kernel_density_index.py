"""An index of densities against the exact sums that it replaces."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.classifiers import KernelDensityBayes, KernelDensityIndex

pytest.importorskip("faiss")


@pytest.fixture(scope="module")
def stored():
    """Six objects, each a handful of places with 300 touches about them."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(6, 5, 8))
    labels = np.repeat(np.arange(6), 1500)
    which = rng.integers(0, 5, len(labels))
    touches = places[labels, which] + 0.3 * rng.normal(size=(len(labels), 8))
    new = places[labels[::100], which[::100]] + 0.3 * rng.normal(size=(90, 8))
    return touches, labels, new


@pytest.fixture(scope="module")
def model(stored):
    return KernelDensityBayes(scale=0.5).fit(*stored[:2])


@pytest.mark.parametrize("bandwidth", ["pooled", "per-object", "full"])
def test_likely_objects_are_exact(stored, bandwidth):
    touches, labels, new = stored
    model = KernelDensityBayes(bandwidth, scale=0.5).fit(touches, labels)
    index = KernelDensityIndex(model, n_exact=2, n_near=1000)
    exact, rough = model.log_likelihood(new), index.log_likelihood(new)
    kept = np.argsort(-rough, axis=1)[:, :1]
    # float32 products: the model's own promise is 1e-3 nats.
    assert_allclose(
        np.take_along_axis(rough, kept, 1),
        np.take_along_axis(exact, kept, 1),
        atol=1e-3,
    )
    assert index.quality(new).equal_decisions >= 0.99


def test_an_index_with_all_objects_exact_is_the_model(stored, model):
    new = stored[2]
    index = KernelDensityIndex(model, n_exact=100, n_near=1000)
    assert index.n_exact == 6
    far = np.vstack([new, new[:2] * 1000])
    assert_allclose(index.log_likelihood(far), model.log_likelihood(far), atol=2e-3)
    quality = index.quality(new)
    assert quality.error_nats < 2e-3
    assert quality.n_touches == 90


def test_pairs_that_float32_cannot_tell_are_summed_exactly(stored):
    """A narrow kernel: exponents of millions, of which float32 keeps seven digits."""
    touches, labels, new = (part[::10] for part in stored)
    model = KernelDensityBayes(scale=0.001).fit(touches, labels)
    index = KernelDensityIndex(model, n_exact=6, n_near=1000)
    assert_allclose(index.log_likelihood(new), model.log_likelihood(new), rtol=1e-12)


def test_cells_of_one_touch_are_exact(stored):
    """A cell of one touch has no spread: its normal density is the kernel itself."""
    touches, labels, new = stored
    few = slice(None, None, 100)
    model = KernelDensityBayes(precision="double").fit(touches[few], labels[few])
    index = KernelDensityIndex(model, n_exact=1, n_cells=15)
    # float32 products of some tens of nats.
    assert_allclose(index.log_likelihood(new), model.log_likelihood(new), atol=1e-3)


def test_one_cell_per_object_is_a_normal_density():
    """Touches that are normal, kernels as narrow as can be: the density is known."""
    rng = np.random.default_rng(1)
    touches = np.vstack([rng.normal(size=(4000, 2)), rng.normal(3, 1, (4000, 2))])
    labels = np.repeat([0, 1], 4000)
    model = KernelDensityBayes("per-object", scale=0.05).fit(touches, labels)
    index = KernelDensityIndex(model, n_exact=1, n_cells=1)
    rough = index.log_likelihood([[3.0, 3.0]])[0, 0]
    expected = -(3**2 + 3**2) / 2 - np.log(2 * np.pi)
    # Means and variances of 4,000 touches are off by 2 %, which shows in 9 nats.
    assert abs(rough - expected) < 0.4


def test_near_cells_are_nearly_all(stored, model):
    """A few cells by touch and the rest in closed form: off by hundredths of a nat."""
    rough = KernelDensityIndex(model, n_exact=2, n_near=1).quality(stored[2])
    better = KernelDensityIndex(model, n_exact=2).quality(stored[2])
    assert better.error_of_best_nats <= rough.error_of_best_nats
    assert better.error_of_best_nats < 0.05
    assert better.equal_decisions == 1


def test_the_same_seed_gives_the_same_index(stored, model):
    new = stored[2]
    first, second = (KernelDensityIndex(model, n_exact=1) for _ in range(2))
    np.testing.assert_array_equal(first.weights_, second.weights_)
    np.testing.assert_array_equal(first.log_likelihood(new), second.log_likelihood(new))
    stated = KernelDensityIndex(model, n_exact=1, random_state=0)
    np.testing.assert_array_equal(first.weights_, stated.weights_)
    other_seed = KernelDensityIndex(model, n_exact=1, random_state=1)
    assert not np.array_equal(first.weights_, other_seed.weights_)
    with pytest.raises(TypeError, match="random_state must be an integer, got None"):
        KernelDensityIndex(model, random_state=None)


def test_without_faiss_the_extra_is_named(model, monkeypatch):
    monkeypatch.setitem(sys.modules, "faiss", None)
    with pytest.raises(ImportError, match=r"palpate\[index\]"):
        KernelDensityIndex(model)
    with pytest.raises(ValueError, match="n_exact must be at least 1"):
        KernelDensityIndex(model, n_exact=0)
