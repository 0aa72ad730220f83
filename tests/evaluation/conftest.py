"""Touches drawn so that what is right of them is known."""

import numpy as np

from palpate import Touches


def drawn(seed, names, n_each=16, noise=0.7):
    """Vectors of 3 x 24 electrodes; each object has its own pattern."""
    rng = np.random.default_rng(seed)
    codes = [sum(map(ord, name)) for name in names]
    patterns = [np.random.default_rng(code).normal(size=(3, 24)) for code in codes]
    images = np.repeat(patterns, n_each, axis=0)
    images += noise * rng.normal(size=images.shape)
    labels = np.repeat(names, n_each)
    category = [name.split("_")[0] for name in labels]
    return Touches(images, object=labels, category=category, geometry="none")
