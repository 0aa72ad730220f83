"""Multiple kernel learning through landmarks: exact at the limit, linear in touches."""

import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal


def test_a_linear_kernel_needs_no_more_directions_than_features(draw, landmarks):
    X, y = draw(50)
    ranks = [
        feature_map.shape[1] for feature_map in landmarks(30).fit(X, y).feature_maps_
    ]
    # A polynomial of degree 2 in 6 features has 28 monomials.
    assert ranks[2:] == [28, 6]


@pytest.mark.parametrize("norm", [1, 2])
@pytest.mark.parametrize("normalize", ["trace", "variance", None])
def test_with_every_touch_a_landmark_the_machine_is_exact(
    norm, normalize, draw, exact, landmarks
):
    X, codes = draw(80)
    options = {"norm": norm, "normalize": normalize, "probability": False}
    options["C"] = 100 if normalize == "trace" else 1
    whole = exact(**options).fit(X, codes)
    through = landmarks(80, **options).fit(X, codes)
    assert through.gap_ <= 1e-6
    # Directions below 1e-10 of the largest are dropped.
    assert_allclose(through.kernel_scales_, whole.kernel_scales_, rtol=1e-6)
    # Either is within its gap of 1e-6.
    assert_allclose(through.objective_, whole.objective_, rtol=2e-6)
    # A gap g moves decisions by up to sqrt(2 g J k(x, x)), here 1e-2.
    assert_allclose(through.decision_function(X), whole.decision_function(X), atol=2e-2)


def test_j_rises_to_the_exact_one_from_above(draw, exact, landmarks):
    # Landmarks see less of a kernel, so each summed kernel is smaller and J larger.
    X, codes = draw(150)
    options = {"C": 100, "probability": False}
    machines = [landmarks(n, **options) for n in (5, 30)] + [exact(**options)]
    objectives = [machine.fit(X, codes).objective_[0] for machine in machines]
    assert objectives[0] > objectives[1] > objectives[2] * (1 - 1e-6)


def test_more_classes_votes_and_probabilities(draw, exact, landmarks):
    X, codes = draw(300, n_classes=4)
    whole = exact().fit(X, codes)
    through = landmarks(60).fit(X, codes)
    others, truth = draw(1000, n_classes=4, seed=1)
    assert through.dual_coef_.shape[0] == 6
    assert abs(through.score(others, truth) - whole.score(others, truth)) < 0.05
    chances = through.predict_proba(others)
    assert_allclose(chances.sum(axis=1), 1, rtol=1e-12)
    assert_array_equal(chances.argmax(axis=1), through.predict(others))


def test_the_seed_decides_the_landmarks(draw, landmarks):
    X, codes = draw(200)
    machine, same = landmarks(20).fit(X, codes), landmarks(20).fit(X, codes)
    assert_array_equal(machine.predict_proba(X), same.predict_proba(X))
    other = landmarks(20).set_params(random_state=1).fit(X, codes)
    assert np.abs(machine.touches_ - other.touches_).max() > 0


def test_more_landmarks_than_touches_are_all_touches(draw, landmarks):
    X, codes = draw(30)
    assert len(landmarks(200).fit(X, codes).touches_) == 30


_MEASURE = """
import json, sys, time
import numpy as np
from palpate.classifiers import MKLSVC, GaussianKernel
n = int(sys.argv[1])
rng = np.random.default_rng(0)
codes = rng.integers(2, size=n)
X = rng.normal(size=(n, 20)) + 0.5 * np.eye(2, 20)[codes]
kernels = [GaussianKernel(s) for s in (2.0, 4.0, 8.0, 16.0)]
machine = MKLSVC(C=n, kernels=kernels, probability=False, random_state=0).fit(X, codes)
peak = next(int(l.split()[1]) for l in open("/proc/self/status") if "VmHWM" in l)
print(json.dumps({"gib": peak / 2**20, "gap": machine.gap_[0]}))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak from /proc")
def test_a_hundred_thousand_touches_need_less_than_four_gib():
    command = [sys.executable, "-c", _MEASURE, "100000"]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    measured = json.loads(result.stdout)
    assert measured["gap"] <= 1e-6
    # Four kernel matrices alone would be 298 GiB.
    assert measured["gib"] < 4
