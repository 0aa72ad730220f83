"""Image -> vector: one estimator per file, and what puts features on one scale."""

from ._root import RootScaler
from ._taxel_vector import TaxelVector

__all__ = ["RootScaler", "TaxelVector"]
