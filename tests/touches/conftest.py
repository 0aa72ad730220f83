"""Folders of drawn pictures, and whether two sets of touches are the same."""

import numpy as np
import pytest
from PIL import Image


def first_levels(touches):
    """Return the first level of each touch; `put` writes its number there."""
    return touches.images[:, 0, 0].tolist()


def assert_same(first, second):
    """Fail where two sets of touches are not the same to the bit."""
    assert first.images.dtype == second.images.dtype
    assert first.images.tobytes() == second.images.tobytes()
    for part in ("columns", "whole"):
        arrays, others = getattr(first, part), getattr(second, part)
        assert list(arrays) == list(others)
        for name, array in arrays.items():
            assert array.dtype == others[name].dtype
            assert array.shape == others[name].shape
            assert array.tobytes() == others[name].tobytes()


@pytest.fixture
def put(tmp_path):
    """Write pictures whose level is their number, by path within a folder."""
    root = tmp_path / "in"
    root.mkdir()

    def write(*names, size=(6, 4), dtype=np.uint8):
        for level, name in enumerate(names):
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            image = np.full(size[::-1], level, dtype=dtype)
            # Quality 100 keeps a flat picture exactly.
            Image.fromarray(image).save(path, quality=100)
        return root

    return write
