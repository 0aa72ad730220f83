"""Summaries of the frames of a press, one channel each."""

import numpy as np

from .._types import Array, Floats

SUMMARIES = ("peak", "hold", "loading")
_HELD = 0.8


def frame_summaries(frames: Array) -> Array:
    """Return the summaries of presses, side by side on the last axis.

    Parameters
    ----------
    frames : ndarray of shape (n_touches, n_frames, n_rows, n_cols[, n_channels])
        NaN stays NaN.

    Returns
    -------
    ndarray of shape (n_touches, n_rows, n_cols, 3 * n_channels)
        All channels of the first of `SUMMARIES`, then of the next. float32 holds 8- and
        16-bit frames; wider ones give float64.
    """
    n_touches, _, n_rows, n_cols = frames.shape[:4]
    summaries = [_summarised(press.astype(np.float64)) for press in frames]
    dtype = np.result_type(frames.dtype, np.float32)
    return np.array(summaries, dtype).reshape(n_touches, n_rows, n_cols, -1)


def _summarised(press: Floats) -> Floats:
    """Return (n_rows, n_cols, 3[, n_channels]) of one press."""
    loads = np.nansum(press, axis=tuple(range(1, press.ndim)))
    peak, gained = int(loads.argmax()), loads - loads[0]
    held = press[gained >= _HELD * gained[peak]].mean(axis=0)
    loading = (press[peak] - press[0]) / max(peak, 1)
    return np.stack([press[peak], held, loading], axis=2)
