"""Images without symmetry, and images turned."""

import numpy as np
from scipy.ndimage import affine_transform


def blobs(rng, n=6, size=81):
    """Smooth images without symmetry, dark towards the frame."""
    axis = (np.arange(size) - (size - 1) / 2) / (size / 2)
    x, y = np.meshgrid(axis, axis)
    images = np.zeros((n, size, size))
    for image in images:
        for centre_x, centre_y in rng.uniform(-0.35, 0.35, (3, 2)):
            wide, strong = rng.uniform(0.01, 0.03), rng.uniform(0.3, 1)
            squared = (x - centre_x) ** 2 + (y - centre_y) ** 2
            image += strong * np.exp(-squared / wide)
    return images


def turned(image, angle_deg, centre=None):
    """Turn an image about its middle or another place, with cubic splines."""
    a = np.deg2rad(angle_deg)
    centre = (np.array(image.shape) - 1) / 2 if centre is None else centre
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return affine_transform(image.astype(float), turn, offset=centre - turn @ centre)
