"""Model files: arrays and plain values in one safetensors file, nothing else.

Reading one executes nothing: classes are looked up in a fixed table, their
attributes are set from arrays and plain values, and a checksum covers all of it.
A file is a safetensors container whose metadata hold one JSON document.

A file of format 4, written by palpate 0.2, is read too: what tells strangers is learnt
anew from the training touches that it keeps. Format 6 stores each of many texts once.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file
from sklearn.decomposition import PCA
from sklearn.preprocessing import StandardScaler

from .. import __version__, classifiers, encodings, images
from .._checks import nearest_path
from .._durable import check_folder_of, replacing
from .._types import Array
from ..classifiers import EncodingPool
from ._contact import ContactCheck
from ._encoder import TouchEncoder
from ._evidence import SequenceCalibration
from ._learnt import RemountedEncoder
from ._memory import Memory
from ._model_checks import MB, Budget
from ._strangers import Curve, StrangerModel
from ._user_parts import Modality, UserEncoding

FORMAT = 6
# Formats that are read, and from how many texts on they are stored once each.
READ, _MANY_TEXTS = (4, 5, FORMAT), 1000

Tensors = dict[str, Array]

_OWN = (
    *EncodingPool.MACHINES,
    ContactCheck,
    Curve,
    Memory,
    Modality,
    RemountedEncoder,
    SequenceCalibration,
    StrangerModel,
    TouchEncoder,
    UserEncoding,
)
_SUBPACKAGES = (classifiers, encodings, images)
_PUBLIC = {
    name: getattr(subpackage, name)
    for subpackage in _SUBPACKAGES
    for name in subpackage.__all__
}
# The classes that a model file may name: ours, and two of scikit-learn.
KNOWN_CLASSES: dict[str, type] = {
    **{n: c for n, c in _PUBLIC.items() if isinstance(c, type)},
    **{kind.__name__: kind for kind in (*_OWN, PCA, StandardScaler)},
}
# Made anew from a stored model; making one computes, which reading a file must not.
del KNOWN_CLASSES["TouchClassifier"]


class ModelFileError(ValueError):
    """A model file that cannot be read or written, and why."""


def write_model(
    path: str | Path, model: object, encodings: Mapping[str, UserEncoding]
) -> Path:
    """Write `model` to `path` (`.palpate`), all or nothing.

    Its parameters and learnt attributes must be arrays, plain values, or instances of
    the classes in `KNOWN_CLASSES`; of other steps of the user's own `encodings` only
    such parts are written, for `read_model` to be given the steps again.
    """
    target = check_model_path(path)
    tensors: Tensors = {}
    packed = _pack_object(model, tensors)
    document = json.dumps({"format": FORMAT, "model": packed})
    n_bytes = len(document) + sum(array.nbytes for array in tensors.values())
    classes = KNOWN_CLASSES | {type(model).__name__: type(model)}
    try:
        _unpack(packed, Budget(n_bytes, tensors, classes, encodings))
    except (TypeError, ValueError) as error:
        raise ModelFileError(f"This model could not be read again: {error}.") from error
    metadata = {"palpate": document, "sha256": _checksum(document, tensors)}
    with replacing(target) as file:
        _write(tensors or {"empty": np.zeros(1)}, file.name, metadata)
        _order_header(Path(file.name))
    return target


def _write(tensors: Tensors, name: str, metadata: dict[str, str]) -> None:
    """Write a file of safetensors, which before 0.6 hides what the disk said."""
    try:
        save_file(tensors, name, metadata=metadata)
    except SafetensorError as error:
        code = re.search(r"Os \{ code: (\d+)", str(error))
        if code is None:
            raise
        number = int(code[1])
        raise OSError(number, os.strerror(number), name) from error


def state_digest(model: object) -> str:
    """Return a SHA-256 of all that `model` is and has learnt, and of palpate's version.

    Two models with one digest answer alike.
    """
    tensors: Tensors = {}
    state = json.dumps([FORMAT, __version__, _pack(model, tensors)])
    return _checksum(state, tensors)


def check_model_path(path: str | Path) -> Path:
    """Return `path` if a model file can be written there, or explain."""
    target = Path(path)
    if target.suffix != ".palpate":
        raise ModelFileError(
            f"A model file must end in .palpate, got {target.name!r}; "
            f"write to {target.with_suffix('.palpate').name!r}."
        )
    check_folder_of(target, ModelFileError)
    return target


def read_model(
    path: str | Path, also: type, encodings: Mapping[str, UserEncoding]
) -> Any:
    """Return the model that `write_model` wrote, or say what is wrong with it.

    Of format 4 or newer, of at most PALPATE_MAX_MODEL_MB (2000); `also` is the
    class of the model itself, beside `KNOWN_CLASSES`, and `encodings` are those of its
    user, by name. Raises `ModelFileError`.
    """
    source = Path(path)
    if not source.is_file():
        raise ModelFileError(
            f"There is no model file {source}. "
            f"{nearest_path(source) or '`ObjectRecogniser.save` writes one.'}"
        )
    n_bytes = source.stat().st_size
    text = os.environ.get("PALPATE_MAX_MODEL_MB", "2000")
    try:
        most = float(text)
    except ValueError:
        most = np.nan
    if np.isnan(most):
        raise ModelFileError(
            f"`PALPATE_MAX_MODEL_MB` must be a number of MB, got {text!r}. Set it to "
            "2000, or leave it out."
        )
    if n_bytes > most * MB:
        raise ModelFileError(
            f"A model file must be at most {most:g} MB large, got {source} with "
            f"{n_bytes / MB:.0f} MB. Set `PALPATE_MAX_MODEL_MB` higher."
        )
    try:
        document, tensors = _open(source)
        classes = KNOWN_CLASSES | {also.__name__: also}
        budget = Budget(n_bytes, tensors, classes, encodings)
        budget.check_document(document)
        content = json.loads(document)
        version, model = content["format"], content["model"]
        if version not in READ:
            raise ModelFileError(
                f"{source} has model format {version!r}, this palpate reads 4 to "
                f"{FORMAT}. Learn again, or use the palpate that wrote it."
            )
        if isinstance(model, dict):
            if version == 4:
                model["learnt"].pop("limits_", None)
            _wrap_encoder(model["learnt"])
        return _unpack(model, budget)
    except ModelFileError:
        raise
    except Exception as error:
        raise ModelFileError(
            f"{source} is no palpate model, or damaged: {error}. Learn again."
        ) from error


def _wrap_encoder(learnt: dict[str, Any]) -> None:
    """Wrap an encoder that holds itself what is taken off, as older models had it."""
    encoder = learnt.get("encoder_", {})
    if encoder.get("class") != "TouchEncoder":
        return
    names = [f.name for f in fields(RemountedEncoder)[1:]]
    held = {name: encoder["learnt"].pop(f"{name}_", None) for name in names}
    taken = {k: v for k, v in held.items() if v not in (None, {"float": "1.0"})}
    if taken:
        params = {"encoder": encoder, **taken}
        wrapper = {"class": "RemountedEncoder", "params": params, "learnt": {}}
        learnt["encoder_"] = wrapper


def _order_header(path: Path) -> None:
    """Sort a safetensors header, whose metadata come in any order, by name."""
    with path.open("r+b") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
        file.seek(8)
        file.write(json.dumps(header, separators=(",", ":")).encode().ljust(length))


def _open(source: Path) -> tuple[str, Tensors]:
    """Return the JSON document and the arrays, checked against the checksum."""
    with safe_open(str(source), framework="numpy") as opened:
        metadata = opened.metadata() or {}
        if "palpate" not in metadata:
            raise ModelFileError(f"{source} is not a palpate model.")
        names = [name for name in opened.keys() if name != "empty"]  # noqa: SIM118
        tensors = {name: opened.get_tensor(name) for name in names}
    document = metadata["palpate"]
    if metadata.get("sha256") != _checksum(document, tensors):
        raise ModelFileError(f"{source} is damaged: its checksum does not match.")
    return document, tensors


def _checksum(document: str, tensors: Tensors) -> str:
    digest = hashlib.sha256(document.encode())
    for name in sorted(tensors):
        array = tensors[name]
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _pack(value: object, tensors: Tensors) -> Any:
    """Return `value` as JSON; arrays go to `tensors` under running numbers."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return {"float": repr(value)}
    if isinstance(value, np.ndarray):
        return _pack_array(value, tensors)
    if isinstance(value, list | tuple):
        items = [_pack(item, tensors) for item in value]
        return {"list" if isinstance(value, list) else "tuple": items}
    if isinstance(value, Mapping):
        pairs = [[str(k), _pack(v, tensors)] for k, v in value.items()]
        return {"dict": pairs}
    if not _is_known(value):
        raise ModelFileError(
            f"A model file cannot hold a {type(value).__name__}, for it holds no "
            "foreign code. Keep the touches and fit again, or use what it may hold: "
            f"{', '.join(sorted(KNOWN_CLASSES))}."
        )
    if isinstance(value, UserEncoding):
        return _pack_user_encoding(value.stored(), tensors)
    return _pack_object(value, tensors)


def _is_known(value: object) -> bool:
    return KNOWN_CLASSES.get(type(value).__name__) is type(value)


def _pack_user_encoding(value: UserEncoding, tensors: Tensors) -> dict[str, Any]:
    """Pack an encoding of the user's own, of foreign code only what it has learnt."""

    def packed(step: Any, number: int) -> Any:
        if _is_known(step):
            return _pack(step, tensors)
        learnt = {}
        for name, item in _state(step)[1].items():
            with suppress(ModelFileError):
                learnt[name] = _pack(item, tensors)
        foreign = [value.name, number, type(step).__name__]
        return {"foreign": foreign, "params": {}, "learnt": learnt}

    node: dict[str, Any] = {"class": type(value).__name__}
    for part, state in zip(("params", "learnt"), _state(value), strict=True):
        node[part] = {}
        for name in ("steps", "steps_"):
            if name in state:
                steps = enumerate(state.pop(name))
                node[part][name] = {"list": [packed(step, k) for k, step in steps]}
        node[part] |= {k: _pack(v, tensors) for k, v in state.items()}
    return node


def _pack_object(value: object, tensors: Tensors) -> dict[str, Any]:
    params, learnt = _state(value)
    return {
        "class": type(value).__name__,
        "params": {k: _pack(v, tensors) for k, v in params.items()},
        "learnt": {k: _pack(v, tensors) for k, v in learnt.items()},
    }


def _pack_array(array: Array, tensors: Tensors) -> dict[str, Any]:
    kind, shape = array.dtype.kind, list(array.shape)
    if kind == "U" or (kind == "O" and all(isinstance(x, str) for x in array.flat)):
        if array.size < _MANY_TEXTS:
            return {"text": array.ravel().tolist(), "shape": shape}
        names, codes = np.unique(array.astype(str), return_inverse=True)
        short = codes.ravel().astype(np.min_scalar_type(len(names)))
        numbers = _pack_array(short, tensors)
        return {"text": names.tolist(), "numbers": numbers, "shape": shape}
    if array.dtype.kind == "c":
        return {"complex": _pack_array(np.stack([array.real, array.imag]), tensors)}
    if array.dtype.kind not in "biuf":
        raise ModelFileError(f"A model file cannot hold an array of {array.dtype}.")
    # The order in memory decides how products round, so it is kept.
    turned = array.flags.f_contiguous and not array.flags.c_contiguous
    in_order = array.T if turned else array
    stored = np.ascontiguousarray(in_order)
    # A network, which its recipe holds too, is stored once.
    again = (n for n, t in tensors.items() if t is stored and t.dtype == np.uint8)
    name = next(again, f"t{len(tensors)}")
    tensors[name] = stored
    return {"array": name, "shape": list(in_order.shape), "turned": turned}


def _state(value: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    if isinstance(value, Memory):
        return value.stored(), {}
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value)}, {}
    # Less, or more, in a file than in memory; in foreign code the name says nothing.
    if _is_known(value) and hasattr(value, "stored"):
        value = value.stored()
    learnt = {
        name: item
        for name, item in getattr(value, "__dict__", {}).items()
        if name.endswith("_") and not name.startswith("_")
    }
    params = value.get_params(deep=False) if hasattr(value, "get_params") else {}
    return params, learnt


def _unpack(node: Any, budget: Budget) -> Any:
    if node is None or isinstance(node, bool | int | str):
        return node
    if not isinstance(node, dict):
        raise ModelFileError(f"unexpected {type(node).__name__}")
    if "float" in node:
        return float(node["float"])
    if "array" in node:
        stored = budget.array(node["array"], node["shape"])
        return stored.T if node.get("turned") else stored
    if "complex" in node:
        real, imaginary = _unpack(node["complex"], budget)
        return real + 1j * imaginary
    if "text" in node:
        numbers = _unpack(node["numbers"], budget) if "numbers" in node else None
        budget.check_texts(node["text"], 0 if numbers is None else len(numbers))
        texts = np.array(node["text"], dtype=str)
        return (texts if numbers is None else texts[numbers]).reshape(node["shape"])
    if "list" in node or "tuple" in node:
        kind = list if "list" in node else tuple
        items = node["list"] if kind is list else node["tuple"]
        return kind(_unpack(item, budget) for item in items)
    if "dict" in node:
        return {str(k): _unpack(v, budget) for k, v in node["dict"]}
    if "foreign" in node:
        return _unpack_foreign(node, budget)
    return _unpack_object(node, budget)


def _unpack_foreign(node: dict[str, Any], budget: Budget) -> Any:
    """Return a step of the user's own that was given again, with what it had learnt."""
    encoding, number, kind = node["foreign"]
    if encoding not in budget.foreign:
        raise ModelFileError(
            f"The model encodes touches by {encoding!r}, which is code of its user's "
            "own and not in the file. Give it again: ObjectRecogniser.load(path, "
            f"encodings={{{encoding!r}: {kind}(...)}})."
        )
    steps = budget.foreign[encoding].steps
    if not 0 <= number < len(steps) or type(steps[number]).__name__ != kind:
        got = ", ".join(type(step).__name__ for step in steps)
        raise ModelFileError(
            f"encodings[{encoding!r}] must have a {kind} as step {number + 1}, as when "
            f"the model was learnt, got {got}."
        )
    _, learnt = _unpack_state(node, budget)
    built = deepcopy(steps[number])
    for attribute, value in learnt.items():
        setattr(built, attribute, value)
    return built


def _unpack_object(node: dict[str, Any], budget: Budget) -> Any:
    name = node["class"]
    if name not in budget.classes:
        raise ModelFileError(
            f"The model names the class {name!r}, which this palpate does not know. "
            "Update palpate, or learn again."
        )
    params, learnt = _unpack_state(node, budget)
    built = budget.classes[name](**params)
    for attribute, value in learnt.items():
        setattr(built, attribute, value)
    return built


def _unpack_state(node: dict[str, Any], budget: Budget) -> tuple[Any, Any]:
    """Return parameters and learnt attributes of one object, both by name."""
    for attribute in node["learnt"]:
        is_learnt = attribute.isidentifier() and attribute.endswith("_")
        if not is_learnt or attribute.startswith("_"):
            raise ModelFileError(f"{attribute!r} is not a learnt attribute")
    params, learnt = (
        {k: _unpack(v, budget) for k, v in node[part].items()}
        for part in ("params", "learnt")
    )
    budget.check_object(params | learnt)
    return params, learnt
