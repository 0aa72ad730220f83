"""Folders of drawn pictures."""

import numpy as np
import pytest
from PIL import Image


def first_levels(touches):
    """Return the first level of each touch: of those that `put` wrote, its number."""
    return touches.images[:, 0, 0].tolist()


def assert_same(one, other):
    """Fail where two sets of touches are not the same to the bit."""
    assert one.images.dtype == other.images.dtype
    assert one.images.tobytes() == other.images.tobytes()
    for here, there in ((one.columns, other.columns), (one.whole, other.whole)):
        assert list(here) == list(there)
        for name, array in here.items():
            assert array.dtype == there[name].dtype
            assert array.shape == there[name].shape
            assert array.tobytes() == there[name].tobytes()


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
