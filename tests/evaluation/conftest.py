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


def often_idle(seed, name):
    """Touches of an array: of one object five of 16 show no contact, of a pen none."""
    frame = np.random.default_rng(2).normal(size=(12, 14)) + 20
    marks = np.random.default_rng(seed).normal(10, 0.5, (32, 12, 14))
    marks[:16, :6] -= 9
    marks[16:, :, :7] -= 9
    marks[:5] = 0
    about = {"no_contact": frame, "geometry": "array"}
    return Touches(frame + marks, object=np.repeat([name, "pen"], 16), **about)
