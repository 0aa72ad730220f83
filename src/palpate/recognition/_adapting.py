"""A learnt recogniser on another device: a few touches tell what has changed.

Another camera sees the dome elsewhere and larger or smaller, which can be found and
undone; another membrane dents otherwise, which must be learnt.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..images import DomeCrop
from ..touches import Touches
from ._belief import as_touches
from ._contact import ContactCheck
from ._presets import find_preset
from ._recogniser import ObjectRecogniser
from ._source import encoded
from ._training import named_labels


def adapt(recogniser: ObjectRecogniser, touches: Touches) -> ObjectRecogniser:
    """Return a recogniser for another device of the same kind.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        Has learnt the objects on one device; it stays as it is.
    touches : Touches
        Labelled touches of some of its objects on the other device; two of each of
        ten objects do. With a frame of no contact the rim is found in that.

    Returns
    -------
    ObjectRecogniser
        Knows the same objects; takes the images of the other device.

    Raises
    ------
    ValueError
        `touches` are without labels, or of an object that is not known.

    Notes
    -----
    1. The disc of a dome camera is found in the new images, and cut as large in
       proportion to the rim as it was.
    2. The new touches join those that were learnt, and everything after the encoding
       is learnt again; widths and ridge stay.

    Moving the features of the training touches by their mean difference from the new
    ones, with or without scaling them, was tried in simulation and was worse on other
    membranes than not doing so (docs/exploration.md).
    """
    new = as_touches(touches)
    labels = named_labels(new, recogniser.label)
    objects = labels if new.object is None else new.object
    _refuse_unknown(labels, recogniser)
    result = deepcopy(recogniser)
    _find_disc(result.encoder_, new)
    result.contact_ = ContactCheck().fit(new, result.encoder_)
    evidence, left, nothing = encoded(result.encoder_, result.contact_, new)
    group = np.full(len(new), result.blocks_.max() + 1)
    result.features_ = np.vstack([result.features_, evidence])
    result.nothing_ = np.concatenate([result.nothing_, nothing])
    result.unexplained_ = np.concatenate([result.unexplained_, left])
    result.labels_ = np.concatenate([result.labels_, labels])
    result.objects_ = np.concatenate([result.objects_, objects])
    result.blocks_ = np.concatenate([result.blocks_, group])
    result._learn(fresh=False)
    result._calibrate(find_preset(result.preset))
    return result


def _refuse_unknown(labels: NDArray[Any], recogniser: ObjectRecogniser) -> None:
    strange = np.setdiff1d(labels, recogniser.classes_)
    if len(strange):
        raise ValueError(
            f"touches must be of known objects, got {str(strange[0])!r}, which was not "
            "learnt. Adapt first, then add it with add_object."
        )


def _find_disc(encoder: Any, touches: Touches) -> None:
    """Find the rim in the images of another camera; keep the disc's share of it."""
    encoder.image_shape_ = touches.images.shape[1:]
    before = encoder.clean_up_
    if not isinstance(before, DomeCrop):
        return
    after = deepcopy(before).fit(touches.images, no_contact=touches.no_contact)
    if after.has_rim_ and before.has_rim_:
        share = before.disc_radius_ / before.rim_radius_
        after.disc_radius_ = share * after.rim_radius_
    after.size_ = before.size_
    encoder.clean_up_ = after
