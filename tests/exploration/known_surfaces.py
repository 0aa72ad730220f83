"""A surface whose radii are known on paper, for tests of maps and filters."""

import numpy as np

from palpate.exploration._surface import AZIMUTHS, HEIGHTS, RadialSurface


def standing_ellipse(a_mm, b_mm):
    """Return a standing cylinder that is an ellipse seen from above."""
    flat = 1 / np.hypot(np.cos(AZIMUTHS) / a_mm, np.sin(AZIMUTHS) / b_mm)
    radii = np.repeat(flat[None], len(HEIGHTS), axis=0)
    return RadialSurface(radii, np.full(radii.shape, 0.25), 1.0)
