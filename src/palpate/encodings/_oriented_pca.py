"""Principal components of images that were turned to one direction."""

from ._principal import Components, PrincipalEncoder
from ._scaled_pixels import ScaledPixels


class OrientedPCA(PrincipalEncoder):
    """Encode images, turned along their long axis, by principal components.

    Parameters
    ----------
    n_components : int, float or None, default=0.95
        How many components: a count, the share of the training touches' variance
        that they hold, or None for all.
    side : int, default=32
        The turned image is averaged to at most so many rows and columns first:
        the shading of a dome is smooth, and what is finer is noise.
    min_anisotropy : float or None, default=0.02
        As in `ScaledPixels`.

    Attributes
    ----------
    first_ : ScaledPixels
        What turns and averages the images.
    components_ : ndarray of shape (n_components_, n_cells)
        The directions, by falling variance: images, row by row.
    mean_ : ndarray of shape (n_cells,)
        Mean of the training touches.
    explained_variance_ratio_ : ndarray of shape (n_components_,)
        Share of the variance along each direction.
    n_components_ : int
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    References
    ----------
    .. [1] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import OrientedPCA
    >>> touches = np.random.default_rng(0).normal(size=(5, 10, 10))
    >>> OrientedPCA(2).fit_transform(touches).shape
    (5, 2)
    """

    def __init__(
        self,
        n_components: Components = 0.95,
        *,
        side: int = 32,
        min_anisotropy: float | None = 0.02,
    ) -> None:
        self.n_components = n_components
        self.side = side
        self.min_anisotropy = min_anisotropy

    def _first(self) -> ScaledPixels:
        return ScaledPixels(self.side, min_anisotropy=self.min_anisotropy)
