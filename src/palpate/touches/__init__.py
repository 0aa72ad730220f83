"""Touches, the one currency: images with all that is known of each, and their files.

`Touches` holds them, `Touches.load` and `Touches.save` read and write touch archives
(`.npz`) and read folders of pictures. Nothing here needs scikit-learn; OpenCV and
Pillow are imported when the first picture is decoded.
"""

from ._columns import TouchesError
from ._containers import frame_reader as frame_reader
from ._folder import PictureCheck as PictureCheck
from ._layout import levels_pattern as levels_pattern
from ._parquet import url_of as url_of
from ._parquet import write_parquet as write_parquet
from ._pictures import decode_bytes
from ._pictures import png_bytes as png_bytes
from ._sources import ParquetTouches as ParquetTouches
from ._sources import TouchSource, read_parquet
from ._tables import in_order as in_order
from ._tables import taxel_names as taxel_names
from ._touches import Labelled as Labelled
from ._touches import Touches

__all__ = [
    "TouchSource",
    "Touches",
    "TouchesError",
    "decode_bytes",
    "read_parquet",
]
