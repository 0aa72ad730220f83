"""Model files of format 3, written by palpate 0.1, brought to today's shape.

What was kept of the training touches lay on the recogniser itself, and some classes
and attributes had other names. Works on the JSON document alone; arrays stay where
they are. What decides is learnt anew from the touches that were kept.
"""

from typing import Any

Node = dict[str, Any]

_ATTRIBUTES = {
    "trust_": "sequence_calibration_",
    "hears_nothing_": "uses_no_contact_",
}
_KEPT = {
    "features_": "features",
    "labels_": "labels",
    "objects_": "objects",
    "stretches_": "blocks",
    "nothing_": "nothing",
    "touch_ids_": "touch_ids",
    "sensor_": "sensor",
}


def from_format_3(node: Any) -> Any:
    """Return a packed value of format 3 as one of format 4."""
    if isinstance(node, list):
        return [from_format_3(item) for item in node]
    if not isinstance(node, dict):
        return node
    renewed = {key: from_format_3(item) for key, item in node.items()}
    if "class" not in renewed:
        return renewed
    if renewed["class"] == "Trust":
        renewed["class"] = "SequenceCalibration"
    learnt = renewed["learnt"]
    renewed["learnt"] = {_ATTRIBUTES.get(k, k): v for k, v in learnt.items()}
    return _recogniser(renewed) if "stretches_" in learnt else renewed


def _recogniser(node: Node) -> Node:
    """Gather what is kept of the training touches into a `Memory`."""
    learnt = node["learnt"]
    kept = {new: learnt.pop(old) for old, new in _KEPT.items() if old in learnt}
    for gone in ("taught_", "unexplained_", "unknown_scale_"):
        learnt.pop(gone, None)
    shape = kept["labels"]["shape"]
    unknown = {"text": [""] * shape[0], "shape": shape}
    if kept.get("touch_ids", unknown)["shape"] != shape:
        kept["touch_ids"] = unknown
    told = dict.fromkeys(("touch_ids", "sessions", "categories"), unknown)
    params = {"sensor": None, **told, **kept}
    learnt["memory_"] = {"class": "Memory", "params": params, "learnt": {}}
    encoder = learnt["encoder_"]
    n_features = kept["features"]["shape"][not kept["features"].get("turned")]
    for where, old in (("params", "steps"), ("learnt", "steps_")):
        steps = encoder[where].pop(old)
        encoder[where][old.replace("steps", "encodings")] = {"dict": [["", steps]]}
    encoder["learnt"] |= {
        "parts_": {"dict": [["", n_features]]},
        "scales_": {"dict": [["", {"float": "1.0"}]]},
        "pads_": None,
        "channels_": None,
    }
    machine = learnt["classifier_"]
    if machine["class"] == "KernelDensityBayes":
        machine["learnt"]["groups_"] = kept["blocks"]
    elif machine["class"] == "MKLSVC":
        learnt["classifier_"] = _from_probabilities(machine, kept)
    return node


def _from_probabilities(machine: Node, kept: Node) -> Node:
    fresh = {"class": machine["class"], "params": machine["params"], "learnt": {}}
    learnt = {
        "classifier_": machine,
        "classes_": machine["learnt"]["classes_"],
        "touches_": kept["features"],
        "labels_": kept["labels"],
        "groups_": kept["blocks"],
        "n_features_in_": machine["learnt"]["n_features_in_"],
    }
    return {
        "class": "FromProbabilities",
        "params": {"classifier": fresh},
        "learnt": learnt,
    }
