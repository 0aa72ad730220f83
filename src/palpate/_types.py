"""Names of types, and of settled values, that signatures in every subpackage share."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Array = NDArray[Any]
Singles = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
PLAIN_KINDS = "biufcSUMm"  # of types that files hold as they are, by `dtype.kind`
# Values of arguments that several subpackages, and options of the command line, take.
Label = Literal["object", "category"]
PresetName = Literal["default", "corradi2015", "liu2014"]
Presentation = Literal["auto", "any", "turned", "shifted", "fixed"]
Split = Literal["between", "last", "unseen-objects", "session", "subject"]
GEOMETRIES = ("dome", "array", "plane", "none")  # how taxels lie
RGB = ("r", "g", "b")  # channels of a picture in colour
PICTURES = (".jpg", ".jpeg", ".png")  # endings of what is decoded as a picture
FILMS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")  # endings of films
# How the last axis of images, and the arrays within one picture, are described.
LAYOUT = ("channels", "pads", "pad_names")
# Names that archives had before these were settled.
FORMER = {f"set_{name}": name for name in LAYOUT}
