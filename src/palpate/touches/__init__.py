"""Touches, the one currency: images with all that is known of each, and their files.

`Touches` holds them, `Touches.load` and `Touches.save` read and write touch archives
(`.npz`) and read folders of pictures. Nothing here needs scikit-learn; OpenCV is
imported when the first picture is decoded.
"""

from ._archive import read_archive, write_archive
from ._columns import GEOMETRIES
from ._decode import decode_bytes
from ._errors import TouchesError
from ._folder import read_folder
from ._source import TouchSource
from ._touches import Episode, Touches

__all__ = [
    "GEOMETRIES",
    "Episode",
    "TouchSource",
    "Touches",
    "TouchesError",
    "decode_bytes",
    "read_archive",
    "read_folder",
    "write_archive",
]
