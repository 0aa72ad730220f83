"""A learnt recogniser on another device: a few touches tell what has changed.

Another camera sees the dome elsewhere and larger or smaller, which can be found and
undone; another membrane dents otherwise, which must be learnt.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np

from .._types import Array
from ..touches import Touches
from ._contact import ContactCheck
from ._evidence import as_touches
from ._learning import encoded, memory_of
from ._memory import named_labels
from ._recogniser import ObjectRecogniser


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
    result.encoder_ = recogniser.encoder_.moved(new)
    result.contact_ = ContactCheck().fit(new, result.encoder_)
    for pose in ("blind_", "usual_"):
        setattr(result.contact_, pose, getattr(recogniser.contact_, pose))
    encoding = encoded(result.encoder_, result.contact_, new)
    one_group = np.zeros(len(new), dtype=np.intp)
    there = memory_of(new, encoding, labels, objects, one_group)
    return result._relearn(result.memory_.plus(there))


def _refuse_unknown(labels: Array, recogniser: ObjectRecogniser) -> None:
    unknown = np.setdiff1d(labels, recogniser.classes_)
    if len(unknown):
        raise ValueError(
            f"touches must be of known objects, got {str(unknown[0])!r}, which was not "
            "learnt. Adapt first, then add it with add_object."
        )
