"""Principal components: by a kernel, against scikit-learn's; by share of variance."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.decomposition import PCA
from sklearn.decomposition import KernelPCA as SklearnKernelPCA
from sklearn.utils.estimator_checks import parametrize_with_checks

from palpate.encodings import KernelPCA, PrincipalShare


@parametrize_with_checks([KernelPCA(), KernelPCA(0.9, scaling="paper")])
def test_common_checks(estimator, check):
    check(estimator)


@pytest.fixture
def features(rng):
    return rng.normal(size=(60, 12)) * np.geomspace(1, 0.1, 12)


@pytest.fixture
def new(rng):
    return rng.normal(size=(20, 12))


def up_to_sign(scores, expected):
    return scores * np.sign((scores * expected).sum(axis=0))


@pytest.mark.parametrize("sigma", [0.8, 3.0, 30.0])
def test_agrees_with_scikit_learn(sigma, features, new):
    ours = KernelPCA(8, sigma=sigma).fit(features)
    theirs = SklearnKernelPCA(
        8, kernel="rbf", gamma=1 / (2 * sigma**2), eigen_solver="dense"
    ).fit(features)
    expected = theirs.transform(new)
    size = np.abs(expected).max()
    assert_allclose(
        up_to_sign(ours.transform(new), expected) / size, expected / size, atol=1e-9
    )
    assert_allclose(ours.eigenvalues_, theirs.eigenvalues_, rtol=1e-9)


def test_scores_of_the_training_touches_are_their_transform(features):
    encoder = KernelPCA(6)
    assert_array_equal(encoder.fit_transform(features), encoder.transform(features))


def test_paper_scaling_is_larger_by_the_root_of_the_number(features, new):
    unit = KernelPCA(6, scaling="unit").fit(features)
    paper = KernelPCA(6, scaling="paper").fit(features)
    assert_allclose(paper.transform(new), np.sqrt(60) * unit.transform(new))
    # Eq. 5: the weights' squared norm is 1 / lambda, the kernel's eigenvalue over M.
    squared = (paper.coefficients_**2).sum(axis=0)
    assert_allclose(squared, 60 / paper.eigenvalues_)


def test_wide_kernels_are_ordinary_pca(features, new):
    sigma = 1e6
    wide = KernelPCA(4, sigma=sigma).fit(features)
    linear = PCA(4).fit(features)
    expected = linear.transform(new)
    # exp(-d / 2 s^2) - 1 = -d / 2 s^2 up to terms of order 1 / s^4.
    assert_allclose(
        up_to_sign(wide.transform(new) * sigma, expected), expected, atol=1e-8
    )


def test_signs_do_not_depend_on_the_order_of_the_touches(features, new, rng):
    order = rng.permutation(len(features))
    straight = KernelPCA(6).fit(features).transform(new)
    shuffled = KernelPCA(6).fit(features[order]).transform(new)
    assert_allclose(shuffled, straight, atol=1e-10)


def test_a_share_of_variance_keeps_as_few_as_hold_it(features):
    ratios = KernelPCA().fit(features).explained_variance_ratio_
    assert ratios.sum() == pytest.approx(1)
    for share in (0.3, 0.8, 0.99):
        encoder = KernelPCA(share).fit(features)
        assert encoder.n_components_ == np.searchsorted(np.cumsum(ratios), share) + 1
    assert KernelPCA(1.0).fit(features).n_components_ == len(ratios)


def test_components_without_variance_do_not_exist():
    three = np.repeat([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]], 7, axis=0)
    encoder = KernelPCA(10).fit(three)
    assert encoder.n_components_ == 2
    assert np.isfinite(encoder.transform(three)).all()


def test_default_width_is_the_median_distance():
    points = np.array([[0.0], [1.0], [3.0]])
    assert KernelPCA().fit(points).sigma_ == 2.0


@pytest.mark.parametrize(
    ("params", "error", "message"),
    [
        ({"n_components": 0}, ValueError, "at least 1"),
        ({"n_components": 0.0}, ValueError, "count or a share"),
        ({"n_components": 1.5}, ValueError, "between 0 and 1"),
        ({"n_components": "all"}, TypeError, "n_components must be a number"),
        ({"sigma": -1.0}, ValueError, "sigma must be positive"),
        ({"sigma": 1e200}, ValueError, r"between 1e-150 .*got 1e\+200"),
        ({"sigma": 1e-200}, ValueError, "between 1e-150 .*got 1e-200"),
        ({"scaling": "none"}, ValueError, "scaling must be one of 'unit', 'paper'"),
    ],
)
def test_bad_parameters_are_refused(params, error, message, features):
    with pytest.raises(error, match=message):
        KernelPCA(**params).fit(features)


def test_touches_that_are_all_alike_are_refused(features):
    with pytest.raises(ValueError, match="touches that differ"):
        KernelPCA().fit(np.ones((5, 3)))
    with pytest.raises(ValueError, match="tells apart"):
        KernelPCA(sigma=1.0).fit(np.ones((5, 3)))
    with pytest.raises(ValueError, match=r"alike at sigma = 1e\+150"):
        KernelPCA(2, sigma=1e150).fit(1e-100 * features)


@pytest.mark.parametrize("sigma", [1e-150, 1e-100, 1e-3])
def test_kernels_narrower_than_any_distance_see_touches_equally_apart(sigma, features):
    # The centred kernel is I - 1/n: every eigenvalue is 1, and there are n - 1.
    fitted = KernelPCA(sigma=sigma).fit(features)
    assert_allclose(fitted.eigenvalues_, np.ones(59))
    assert_allclose(KernelPCA(2, sigma=sigma).fit(features).eigenvalues_, [1, 1])


def test_the_widest_kernel_tells_touches_apart(features):
    wide = KernelPCA(2, sigma=1e150).fit_transform(features)
    assert (wide.std(axis=0) > 0).all()


def test_features_whose_squares_leave_the_range_are_refused(features):
    with pytest.raises(ValueError, match=r"X must be at most 1e\+150 .*got .*e\+200"):
        KernelPCA().fit(1e200 * features)
    with pytest.raises(ValueError, match=r"X must be at most 1e\+150"):
        KernelPCA().fit(features).transform(1e200 * features)


@pytest.mark.parametrize("encoder", [KernelPCA(2), PrincipalShare()], ids=repr)
def test_a_model_file_keeps_scores_and_their_names(encoder, features, reread):
    scores = encoder.fit_transform(features)
    again = reread(encoder)
    assert_array_equal(again.transform(features), scores)
    names = encoder.get_feature_names_out().tolist()
    assert again.get_feature_names_out().tolist() == names
    assert len(names) == scores.shape[1]


def test_kept_components_hold_the_share_and_no_fewer(features):
    kept = PrincipalShare(0.9).fit(features)
    total = features.var(axis=0).sum()
    held = kept.transform(features).var(axis=0).sum()
    assert held >= 0.9 * total
    without_last = kept.transform(features)[:, :-1].var(axis=0).sum()
    assert without_last < 0.9 * total


def test_what_is_unexplained_is_the_distance_to_the_kept_plane(features, rng):
    kept = PrincipalShare(0.8).fit(features)
    new = rng.normal(size=(5, 12))
    scores = kept.transform(new)
    back = scores @ kept.components_ + kept.mean_
    variance = features.var(axis=0).sum()
    assert_allclose(
        kept.unexplained(new, scores), ((new - back) ** 2).sum(axis=1) / variance
    )


def test_touches_explain_themselves_better_than_when_left_out(rng):
    # Ten touches span at most ten of 40 directions: none is explained by the others.
    few = rng.normal(size=(10, 40))
    kept = PrincipalShare(0.99).fit(few)
    inside = kept.unexplained(few, kept.transform(few))
    left_out = kept.left_out_unexplained(few, np.arange(10))
    assert inside.mean() < 0.05
    assert left_out.mean() > 0.5


def test_groups_are_left_out_whole(rng):
    direction = np.eye(8)
    groups = np.repeat(np.arange(5), 6)
    # Every group has a direction of its own, which the others cannot know.
    features = direction[groups] * rng.choice([-1, 1], size=(30, 1))
    features = features + 0.01 * rng.normal(size=(30, 8))
    kept = PrincipalShare(0.95).fit(features)
    assert kept.unexplained(features, kept.transform(features)).mean() < 0.05
    assert kept.left_out_unexplained(features, groups).min() > 0.7


def test_one_group_alone_is_not_unexplained(features):
    kept = PrincipalShare().fit(features)
    assert_allclose(kept.left_out_unexplained(features, np.zeros(60, int)), 0)


def test_touches_all_alike_have_one_feature_that_is_zero():
    same = np.ones((4, 3))
    kept = PrincipalShare().fit(same)
    assert_allclose(kept.transform(same), np.zeros((4, 1)))
    assert_allclose(kept.unexplained(same, kept.transform(same)), 0)


@pytest.mark.parametrize("share", [0.0, 1.0, 1.5])
def test_a_share_outside_0_to_1_is_refused(features, share):
    with pytest.raises(ValueError, match="share"):
        PrincipalShare(share).fit(features)


@pytest.mark.parametrize("size", [2.0**-600, 2.0**500])
@pytest.mark.parametrize("n_touches", [6, 48])
def test_directions_do_not_depend_on_the_size_of_features(n_touches, size):
    features = np.random.default_rng(0).normal(size=(n_touches, 20))
    whole = PrincipalShare(0.9).fit(features).components_
    assert np.array_equal(PrincipalShare(0.9).fit(size * features).components_, whole)
