"""Rays are traced by embreex; without it the same distances come more slowly."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

pytest.importorskip("trimesh")

from palpate.simulation import PlacedObject, find_object


def distances(direction):
    placed = PlacedObject(find_object("mug"))
    side = np.linspace(-60, 60, 25)
    across = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    origins = placed.centre_mm + np.column_stack([across, np.zeros(len(across))])
    return placed.distance_mm(origins - 300 * np.array(direction), direction)


@pytest.mark.parametrize("direction", [(0, 0, -1), (0, 0.6, -0.8), (0.48, 0.64, -0.6)])
def test_distances_are_those_of_embreex(direction, monkeypatch):
    pytest.importorskip("embreex")
    traced = distances(direction)
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    plain = distances(direction)
    assert np.isfinite(plain).sum() > 20
    # Single precision at 300 mm; a ray along an edge of the mesh may pass it.
    assert np.count_nonzero(~np.isclose(plain, traced, atol=1e-3)) <= 2


def test_a_touch_is_simulated_without_embreex(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    box = PlacedObject(find_object("box"))
    top = box.bounds_mm[1, 2]
    origins = [[*box.centre_mm[:2], top + 10], [1000, 1000, top + 10]]
    distance_mm = box.distance_mm(origins, [0, 0, -1])
    assert_array_equal(np.isfinite(distance_mm), [True, False])
    assert distance_mm[0] == pytest.approx(10, abs=1e-4)
