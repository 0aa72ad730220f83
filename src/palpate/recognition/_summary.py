"""What a recogniser has learnt, in plain values."""

from typing import Any

from ._recogniser import ObjectRecogniser


def summary(recogniser: ObjectRecogniser) -> dict[str, Any]:
    """Return what was learnt, as plain values for people and for JSON."""
    return {
        "preset": recogniser.preset,
        "label": recogniser.label,
        "n_labels": len(recogniser.classes_),
        "n_train_touches": len(recogniser.labels_),
        "n_features": recogniser.features_.shape[1],
        "labels": [str(name) for name in recogniser.classes_],
        "chosen": recogniser.chosen_,
    }
