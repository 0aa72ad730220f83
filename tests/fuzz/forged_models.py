"""Model files that are changed, with a checksum that fits the change."""

import hashlib
import json
import random
from functools import cache

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from palpate import ObjectRecogniser, Touches

NUMBERS = [0, -1, 1, 2, 7, 255, 4097, 12_000, 2**31, 2**63, 10**30, -(2**40), 0.5, 1e9]
FLOATS = ["nan", "inf", "-inf", "1e308", "-1e308", "5e-324", "0.0", "-1.0", "1e9", "x"]
TEXTS = ["", "x" * 50_000, "\u0000", "PCA", "ObjectRecogniser", "é", "median", "nan"]
VALUES = [None, True, [], {}, "text", 1e400, {"float": 1e400}, {"list": []}, [[]]]


@cache
def models():
    """Return the bytes of small models, of every preset and several geometries."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:40, :40] / 40 - 0.5
    sides = (0.1, 0.2), (0.2, 0.1)
    wide, high = (100 * np.exp(-((x / a) ** 2) - (y / b) ** 2) for a, b in sides)
    presses = np.repeat([wide, high], 8, axis=0) + rng.normal(0, 1, (16, 40, 40))
    small, fine = presses[:, ::4, ::4], presses[:, ::2, ::2]
    taught = [
        ("default", small[:, :3], "none", None),
        ("default", small, "array", None),
        ("default", np.stack([small] * 3, axis=-1), "plane", ["r", "g", "b"]),
        ("default", fine, "dome", None),
        ("corradi2015", fine, "dome", None),
        ("liu2014", small, "array", None),
    ]
    labels = ["pen"] * 8 + ["mug"] * 8
    hand = Touches(small[:, :4], object=labels, pads=[[0, 0, 4, 4], [0, 5, 4, 5]])
    return [
        ObjectRecogniser(preset).fit(
            Touches(images, object=labels, geometry=geometry, channels=channels)
        )
        for preset, images, geometry, channels in taught
    ] + [ObjectRecogniser(presentation="shifted").fit(hand)]


def opened(path):
    """Return the JSON document and the arrays of a model file."""
    with safe_open(str(path), framework="numpy") as file:
        document = json.loads(file.metadata()["palpate"])
        return document, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def forged(path, document, tensors):
    """Write a document and arrays with their right checksum."""
    text = document if isinstance(document, str) else json.dumps(document)
    kept = {name: array for name, array in tensors.items() if name != "empty"}
    digest = hashlib.sha256(text.encode())
    for name, array in sorted(kept.items()):
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(array.tobytes())
    metadata = {"palpate": text, "sha256": digest.hexdigest()}
    save_file(tensors or {"empty": np.zeros(1)}, path, metadata=metadata)
    return path


def mutated(document, tensors, seed):
    """Return a copy of a model with one to three changes."""
    chance = random.Random(seed)
    document, tensors = json.loads(json.dumps(document)), dict(tensors)
    for _ in range(chance.choice([1, 1, 1, 2, 3])):
        if tensors and chance.random() < 0.35:
            _change_array(tensors, chance)
        else:
            _change_document(document, chance)
    return document, tensors


@np.errstate(all="ignore")
def _change_array(tensors, chance):
    name = chance.choice(sorted(tensors))
    array = tensors[name].copy()
    kind = chance.randrange(6)
    if kind == 0 and array.size:
        value = chance.choice([np.nan, np.inf, -1, 0, 1e308, 2**27, 2**62])
        array.flat[chance.randrange(array.size)] = np.array(value).astype(array.dtype)
    elif kind == 1:
        array = array.astype(chance.choice([np.float32, np.int64, np.uint8, np.bool_]))
    elif kind == 2:
        array = array.reshape(chance.choice([(-1,), (-1, 1), (1, -1), (-1, 1, 1)]))
    elif kind == 3:
        array = array[:0] if array.ndim else np.zeros(0)
    elif kind == 4:
        array = np.concatenate([np.atleast_1d(array)] * chance.choice([2, 100]))
    else:
        array = np.full_like(array, chance.choice([0, 1, 3, 2**27]))
    tensors[name] = np.ascontiguousarray(array)


def _change_document(document, chance):
    places = list(_places(document["model"]))
    holder, key = chance.choice(places)
    value = holder[key]
    kind = chance.randrange(8)
    if kind == 0:
        holder[key] = chance.choice(VALUES)
    elif kind == 1 and isinstance(holder, dict):
        del holder[key]
    elif kind == 2 and isinstance(value, list) and value:
        holder[key] = value * chance.choice([2, 1000])
    elif kind == 3:
        other, other_key = chance.choice(places)
        holder[key] = json.loads(json.dumps(other[other_key]))
    elif key == "float":
        holder[key] = chance.choice(FLOATS)
    elif isinstance(value, str):
        holder[key] = chance.choice(TEXTS)
    elif isinstance(value, int | float):
        holder[key] = chance.choice(NUMBERS)
    else:
        holder[key] = chance.choice(NUMBERS + VALUES)


def _places(node):
    keys = node if isinstance(node, dict) else range(len(node))
    for key in keys:
        yield node, key
        if isinstance(node[key], dict | list):
            yield from _places(node[key])
