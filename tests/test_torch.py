"""A dataset for PyTorch: labels without torch, batches by its own DataLoader."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.torch import TouchDataset


@pytest.fixture
def touches(rng):
    images = rng.integers(0, 999, (6, 3, 4)).astype(np.uint16)
    return Touches(images, object=["pen", "cup", "pen", "jar", "cup", "jar"])


def test_labels_are_numbers_of_classes(touches):
    dataset = TouchDataset(touches)
    assert dataset.classes == ["cup", "jar", "pen"]
    assert_array_equal(dataset.targets, [2, 0, 2, 1, 0, 1])
    ordered = TouchDataset(touches, classes=["pen", "jar", "cup", "mug"])
    assert_array_equal(ordered.targets, [0, 2, 0, 1, 2, 1])
    with pytest.raises(ValueError, match=r"classes must hold every object, .*'jar'"):
        TouchDataset(touches, classes=["pen", "cup"])
    with pytest.raises(ValueError, match="must have the label category"):
        TouchDataset(touches, "category")


def test_without_torch_the_refusal_names_the_extra(touches, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r'pip install "palpate\[cnn\]"'):
        TouchDataset(touches)[0]


@pytest.mark.parametrize("stored", [False, True], ids=["set", "library"])
def test_shuffled_batches_have_their_own_labels(touches, tmp_path, stored):
    torch = pytest.importorskip("torch")
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(touches)
        source = library.select() if stored else touches
        dataset = TouchDataset(source, transform=lambda image: image + 1)
        loader = torch.utils.data.DataLoader(dataset, batch_size=4, shuffle=True)
        whole = library.touches()
        number = 0
        for images, labels in loader:
            for image, label in zip(images, labels, strict=True):
                same = [(i + 1.0 == image[0].numpy()).all() for i in whole.images]
                assert str(whole.object[same.index(True)]) == dataset.classes[label]
                number += 1
        assert number == 6
        image, label = dataset[-1]
        assert image.shape == (1, 3, 4)
        assert label == dataset.targets[-1]
        with pytest.raises(IndexError, match="below 6"):
            dataset[6]
