"""The scans of a JPEG, counted: each takes time over every pixel, whatever it says.

Cameras write one scan, programs that write progressive JPEGs at most some twenty. A
scan of nothing has a dozen bytes, so that a small file can keep a decoder busy for
minutes.
"""

import re

import numpy as np

MOST_SCANS = 100  # progressive files of cameras have about ten
# A scan has ten bytes at least and takes at most some 0.4 ns a pixel: where bytes times
# pixels are fewer, as of a camera's 640 x 480, no picture takes longer than a second.
_FEW = 5 * 2**32
_SCAN_CODE, _END_CODE, _HEAD = 0xDA, 0xD9, 2
_SCAN = np.frombuffer(b"\xff\xda", np.uint16)[0]
_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")


def has_many_scans(data: bytes, n_pixels: int) -> bool:
    """Whether a JPEG of so many pixels has more than 100 scans and may take long."""
    if len(data) * n_pixels <= _FEW:
        return False
    pairs = (np.frombuffer(data, np.uint16, (len(data) - n) // 2, n) for n in (0, 1))
    if sum(np.count_nonzero(pair == _SCAN) for pair in pairs) <= MOST_SCANS:
        return False
    # Some may lie in a preview, or behind the end: follow the segments.
    n_scans, place = 0, _HEAD
    while n_scans <= MOST_SCANS and (marker := _MARKER.search(data, place)):
        code = marker[1][0]
        if code == _END_CODE:
            return False
        n_scans += code == _SCAN_CODE
        size = int.from_bytes(data[marker.end() : marker.end() + 2], "big")
        place = marker.end() + max(size, 1)
    return n_scans > MOST_SCANS
