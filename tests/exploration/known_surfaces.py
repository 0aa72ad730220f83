"""A surface whose radii are known on paper, for tests of maps and filters."""

from dataclasses import replace

import numpy as np

from palpate.exploration._surface import AZIMUTHS, HEIGHTS, RadialSurface


def standing_ellipse(a_mm, b_mm):
    """Return a standing cylinder that is an ellipse seen from above."""
    flat = 1 / np.hypot(np.cos(AZIMUTHS) / a_mm, np.sin(AZIMUTHS) / b_mm)
    radii = np.repeat(flat[None], len(HEIGHTS), axis=0)
    return RadialSurface(radii, np.full(radii.shape, 0.25), 1.0)


def with_head(surface, radius_mm, above_rad):
    """Return a surface of another radius, the same all round, above some height."""
    upper = (above_rad < HEIGHTS)[:, None]
    return replace(surface, mean_mm=np.where(upper, radius_mm, surface.mean_mm))
