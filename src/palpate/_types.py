"""Names of types that signatures in every subpackage share."""

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
