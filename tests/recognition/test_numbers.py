"""Levels that are extreme or all alike: an answer or our own error, and no warning."""

import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import ObjectRecogniser, Touches

LABELS = ["pen"] * 6 + ["mug"] * 6
NOISE = np.random.default_rng(0).random((12, 12, 12))
PRESETS = ("default", "corradi2015", "liu2014")
GEOMETRIES = ("dome", "array", "none")


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("preset", PRESETS)
def test_levels_too_large_to_add_up_are_refused(preset, geometry):
    recogniser, sizes = ObjectRecogniser(preset), (1e300, 1e160, 1e38)
    for size in sizes:
        with pytest.raises(ValueError, match=r"at most 1e\+37"):
            recogniser.fit(Touches(size * NOISE, object=LABELS, geometry=geometry))
    levels = np.where(np.arange(12)[:, None, None] < 6, NOISE, NOISE**2)
    recogniser.fit(Touches(levels, object=LABELS, geometry=geometry))
    for size in sizes:
        with pytest.raises(ValueError, match=r"at most 1e\+37"):
            recogniser.predict(Touches(size * NOISE, geometry=geometry))


def test_half_precision_is_learnt_as_single_is_without_a_warning():
    half = Touches(NOISE.astype(np.float16), object=LABELS, geometry="array")
    single = Touches(half.images.astype(np.float32), object=LABELS, geometry="array")
    posteriors = [ObjectRecogniser().fit(t).predict_proba(t) for t in (half, single)]
    assert_allclose(*posteriors, atol=1e-3)


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("preset", ["default", "corradi2015"])
@pytest.mark.parametrize("level", [0.0, 7.0, 1e-300])
def test_touches_that_are_all_alike_are_learnt_without_a_warning(
    preset, geometry, level
):
    touches = Touches(np.full((12, 20, 20), level), object=LABELS, geometry=geometry)
    belief = ObjectRecogniser(preset).fit(touches).start().update(touches[:2])
    shares = dict.fromkeys(("pen", "mug"), (1 - belief.unknown) / 2)
    assert belief.posterior == pytest.approx(shares)


ONE_RUN = """
import sys
from pathlib import Path
import numpy as np
from palpate import ObjectRecogniser, Touches
images = np.random.default_rng(0).random((12, 12, 12))
images[:6] += np.eye(12)
touches = Touches(images, object=["pen"] * 6 + ["mug"] * 6)
ObjectRecogniser("liu2014").fit(touches).save(sys.argv[1])
"""


@pytest.mark.slow
def test_identical_runs_write_identical_model_files(tmp_path, monkeypatch):
    """One run has a process of its own, the other that of the tests."""
    paths = [tmp_path / f"{run}.palpate" for run in range(2)]
    command = [sys.executable, "-c", ONE_RUN, str(paths[0])]
    subprocess.run(command, check=True, timeout=120)
    monkeypatch.setattr(sys, "argv", ["", str(paths[1])])
    exec(ONE_RUN, {})
    digests = {sha256(path.read_bytes()).hexdigest() for path in paths}
    assert len(digests) == 1
