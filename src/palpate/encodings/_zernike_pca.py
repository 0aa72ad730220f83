"""Zernike-PCA: principal components of Zernike moments."""

from .._checks import check_option
from ._principal import Components, PrincipalEncoder
from ._zernike import ZernikeMoments

REAL_OUTPUTS = ("abs", "noll", "noll_abs")


class ZernikePCA(PrincipalEncoder):
    """Encode images by the principal components of their Zernike moments.

    Parameters
    ----------
    n_components : int, float or None, default=0.95
        How many components: a count, the share of the training touches' variance
        that they hold, or None for all.
    order : int, default=15
        Highest order of the moments.
    output, weight, drop_constant, repeat_negative
        As in `ZernikeMoments`; `output` must be a real one. What the weights are
        decides which moments vary most and so what is kept.

    Attributes
    ----------
    first_ : ZernikeMoments
        What encodes the images.
    components_ : ndarray of shape (n_components_, n_moments)
        The directions, by falling variance.
    mean_ : ndarray of shape (n_moments,)
        Mean of the training touches' moments.
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
    >>> from palpate.encodings import ZernikePCA
    >>> touches = np.random.default_rng(0).normal(size=(5, 10, 10))
    >>> ZernikePCA(2).fit_transform(touches).shape
    (5, 2)
    """

    def __init__(
        self,
        n_components: Components = 0.95,
        *,
        order: int = 15,
        output: str = "abs",
        weight: str = "n+1",
        drop_constant: bool = True,
        repeat_negative: bool = False,
    ) -> None:
        self.n_components = n_components
        self.order = order
        self.output = output
        self.weight = weight
        self.drop_constant = drop_constant
        self.repeat_negative = repeat_negative

    def _first(self) -> ZernikeMoments:
        check_option("output", self.output, REAL_OUTPUTS)
        return ZernikeMoments(
            self.order,
            output=self.output,
            weight=self.weight,
            drop_constant=self.drop_constant,
            repeat_negative=self.repeat_negative,
        )
