"""Names for arrays that signatures in every room share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Array = NDArray[Any]
Singles = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
