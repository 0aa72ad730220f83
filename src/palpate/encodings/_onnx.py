"""A network trained anywhere, as an encoding: its file in the ONNX format.

A network is data that a fixed set of operators is applied to. What else an ONNX file
may ask for is refused before anything runs: operators of other makers, weights in other
files (which the runtime would open), control flow, functions. What runs is what was
checked, written anew, on one thread of the CPU with bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from functools import cache, lru_cache
from pathlib import Path
from threading import Timer
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from .._checks import check_option
from .._extras import needed
from .._image_estimator import ImageEstimator
from .._types import Array, Floats, Singles

MB = 2**20  # bytes
# Larger files are refused, and more memory is not given to all networks together.
MAX_NETWORK_MB, MAX_MEMORY_GB = 500, 4
MAX_OPERATORS, MAX_SIDE, MAX_WIDTH = 20_000, 2048, 16_384
# Versions of the standard operators that are read, and who names them.
OPSETS = range(7, 27)
_STANDARD = ("", "ai.onnx")
# Each image another answer: what a touch is taken for must not be drawn by lot.
_RANDOM = ("Bernoulli", "Multinomial", "Random")
# Images that pass through a network at once, and how long the first may take.
AT_ONCE, MOST_SECONDS = 32, 20.0
# Rounding differs between one image and several; more than this is no rounding.
_ROUNDING = 1e-3


class OnnxEncoding(ImageEstimator, by_channel=False):
    """Encode images by a network in an ONNX file (extra `onnx`).

    Images are brought to mean 0 and variance 1, resized to what the network takes (its
    own size, if that is open), and to its channels: grey is repeated for a network of
    three, colour is averaged for a network of one.

    Parameters
    ----------
    network : path, or ndarray of uint8
        The file, `.onnx`, or its bytes. It takes images (n, 1 or 3, n_rows, n_cols) of
        float32 with any n, and gives a float tensor of n rows. A network of at most 500
        MB of the standard operators, version 7 to 26, with its weights in the file.
    output : str, optional
        Which output is the vector; needed where the network has several.
    mean, std : float or array-like of shape (n_channels,), optional
        What is taken off the levels of images, and what they are then divided by; by
        default mean and standard deviation of the images seen by `fit`.

    Attributes
    ----------
    network_ : ndarray of uint8, shape (n_bytes,)
        The network, as it is kept in model files.
    mean_, std_ : ndarray of shape (1,) or (n_channels,)
        As above.
    width_ : int
        Length of the vectors.

    Notes
    -----
    Nothing is learnt of the touches but `mean_` and `std_`. A network of several
    hundred numbers a touch is best followed by principal components:
    `[OnnxEncoding("net.onnx"), PrincipalShare(0.99)]`.
    """

    def __init__(
        self,
        network: str | Path | Array,
        *,
        output: str | None = None,
        mean: ArrayLike | None = None,
        std: ArrayLike | None = None,
    ) -> None:
        self.network = network
        self.output = output
        self.mean = mean
        self.std = std

    def _learn(self, images: Array) -> None:
        network = checked_network(_bytes_of(self.network))
        self.network_ = np.frombuffer(network, dtype=np.uint8)
        self.__dict__.pop("_session", None)
        n_channels = images.shape[3] if images.ndim == 4 else 1
        # numpy sums squares of half precision in half precision.
        levels = images.astype(np.float32) if images.dtype == np.float16 else images
        spread = float(np.std(levels)) or 1.0
        self.mean_ = _levels("mean", self.mean, float(np.mean(levels)), n_channels)
        self.std_ = _levels("std", self.std, spread, n_channels)
        if not (self.std_ > 0).all():
            raise ValueError(f"std must be positive, got {self.std!r}.")
        self.width_ = self._checked_width(images)

    def transform_checked(self, images: Array) -> Floats:
        """Return what the network makes of images, shape (n_touches, width_)."""
        parts = [
            self._vectors(images[start : start + AT_ONCE])
            for start in range(0, len(images), AT_ONCE)
        ]
        vectors = np.concatenate(parts) if parts else np.empty((0, self.width_))
        if vectors.shape[1] != self.width_:
            raise ValueError(
                f"The network must give {self.width_} numbers for each image, as when "
                f"it was learnt, got {vectors.shape[1]}. Export it for images of one "
                "size."
            )
        return vectors

    def _checked_width(self, images: Array) -> int:
        """Return the length of the vectors, if the network encodes each image alone."""
        pair = images[:2] if len(images) > 1 else np.concatenate([images, images])
        together = self._vectors(pair, most_seconds=MOST_SECONDS)
        alone = np.concatenate([self._vectors(image[np.newaxis]) for image in pair])
        if together.shape[1] > MAX_WIDTH:
            raise ValueError(
                f"The network must give at most {MAX_WIDTH} numbers for each image, "
                f"got {together.shape[1]}. Name a later layer as its output."
            )
        difference = np.abs(together - alone).max()
        if difference > _ROUNDING * max(1.0, float(np.abs(together).max())):
            raise ValueError(
                "network must give an image the same features whatever else is in the "
                "batch, got different ones. Export it in evaluation mode "
                "(torch: network.eval())."
            )
        return int(together.shape[1])

    def _vectors(self, images: Array, most_seconds: float | None = None) -> Floats:
        """Return what the network makes of some images, (n_images, n_numbers)."""
        session = self._ready()
        (taken,) = session.get_inputs()
        prepared, output = self._prepared(images, taken.shape), self._output(session)
        options = needed("onnxruntime", "onnx", "OnnxEncoding").RunOptions()
        watch = Timer(most_seconds or 0, lambda: setattr(options, "terminate", True))
        watch.daemon = True
        if most_seconds:
            watch.start()
        try:
            (vectors,) = session.run([output], {taken.name: prepared}, options)
        except Exception as error:
            raise ValueError(
                f"The network cannot encode images of {prepared.shape[2]} x "
                f"{prepared.shape[3]}: {_first_line(error)}. Export it anew for "
                "images of this size, or of any."
            ) from error
        finally:
            watch.cancel()
        return _rows(vectors, len(images))

    def _prepared(self, images: Array, shape: Sequence[Any]) -> Singles:
        """Return images as the network takes them, (n_images, channels, rows, cols)."""
        scaled = images if images.ndim == 4 else images[..., np.newaxis]
        scaled = ((scaled - self.mean_) / self.std_).astype(np.float32)
        n_channels, n_rows, n_cols = shape[1:]
        if scaled.shape[3] != n_channels:
            if n_channels == 3 and scaled.shape[3] != 1:
                raise ValueError(
                    "The network takes 3 channels, got images of "
                    f"{scaled.shape[3]}. Use a network of 1 channel, which gets their "
                    "mean."
                )
            grey = scaled.mean(axis=3, keepdims=True)
            scaled = np.repeat(grey, n_channels, axis=3)
        size = [
            side if isinstance(side, int) else side_now
            for side, side_now in zip((n_rows, n_cols), scaled.shape[1:3], strict=True)
        ]
        if tuple(size) != scaled.shape[1:3]:
            scaled = np.stack([_resized(image, size) for image in scaled])
        return np.ascontiguousarray(np.moveaxis(scaled, 3, 1))

    def _output(self, session: Any) -> str:
        names = [node.name for node in session.get_outputs()]
        name = names[0] if self.output is None and len(names) == 1 else self.output
        return str(check_option("output", name, names))

    def _ready(self) -> Any:
        """Return the network, ready to run."""
        if "_session" not in self.__dict__:
            check_is_fitted(self, "network_")
            self._session = _session(self.network_.tobytes())
        return self._session

    def __getstate__(self) -> dict[str, Any]:
        state: dict[str, Any] = dict(super().__getstate__())
        state.pop("_session", None)  # it belongs to a process
        return state

    def stored(self) -> Self:
        """Return this as a model file keeps it: with the network, without a path."""
        other = copy(self)
        if hasattr(self, "network_"):
            other.network = self.network_
        elif not isinstance(self.network, np.ndarray):
            other.network = Path(self.network).name
        return other


def checked_network(content: bytes) -> bytes:
    """Return an ONNX network that is no more than that, written anew, or explain."""
    onnx = needed("onnx", "onnx", "OnnxEncoding")
    _check_size(len(content))
    try:
        model = onnx.load_model_from_string(content)
        if not model.graph.node:
            raise ValueError("network is no ONNX file, or damaged: no operators.")
        _check_operators(model, onnx)
        # What this reader does not know is not left for the runtime to find.
        model.DiscardUnknownFields()
        del model.metadata_props[:]
        return bytes(model.SerializeToString())
    except Exception as error:
        if type(error) is ValueError:
            raise
        raise ValueError(f"network is no ONNX file, or damaged: {error}.") from error


def _check_operators(model: Any, onnx: Any) -> None:
    """Refuse operators of other makers, other files, control flow and chance."""
    opsets = {opset.domain: opset.version for opset in model.opset_import}
    domains = {*opsets, *(node.domain for node in model.graph.node)}
    if odd := sorted(domains.difference(_STANDARD)):
        raise ValueError(
            f"network must use the standard operators of ONNX alone, got {odd[0]!r}. "
            "Export it without custom operators."
        )
    if model.functions:
        raise ValueError(
            "network must hold no functions of its own, got "
            f"{model.functions[0].name!r}. Export it with its functions inlined "
            "(onnx.inliner.inline_local_functions)."
        )
    version = max(opsets.values(), default=0)
    if version not in OPSETS:
        raise ValueError(
            f"network must use operators of version {OPSETS[0]} to {OPSETS[-1]}, got "
            f"{version}. Export it with opset_version=17."
        )
    if len(model.graph.node) > MAX_OPERATORS:
        raise ValueError(
            f"network must have at most {MAX_OPERATORS} operators, got "
            f"{len(model.graph.node)}."
        )
    for message in _messages(model.graph):
        if isinstance(message, onnx.TensorProto) and (
            message.external_data or message.data_location == onnx.TensorProto.EXTERNAL
        ):
            raise ValueError(
                f"network must hold all its weights, got {message.name!r} in another "
                "file. Export it as one file (torch: external_data=False)."
            )
        if isinstance(message, onnx.AttributeProto) and (message.HasField("g")):
            raise ValueError(
                f"network must be without control flow, got {message.name!r}. Export "
                "it by tracing, without If, Loop and Scan."
            )
    for node in model.graph.node:
        if node.op_type.startswith(_RANDOM):
            raise ValueError(
                f"network must not use random operators, got {node.op_type!r}. Export "
                "it in evaluation mode (torch: network.eval())."
            )


def _messages(message: Any) -> Iterator[Any]:
    """Yield a protobuf message and all that are in it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            parts = [value] if hasattr(value, "ListFields") else value
            for part in parts:
                yield from _messages(part)


@lru_cache(maxsize=4)
def _session(content: bytes) -> Any:
    """Return a network, checked and ready to run on one thread of the CPU."""
    network = checked_network(content)
    runtime = needed("onnxruntime", "onnx", "OnnxEncoding")
    _bound_memory()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.use_env_allocators", "1")
    try:
        session = runtime.InferenceSession(
            network, options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:
        raise ValueError(f"network cannot be run: {_first_line(error)}.") from error
    _check_input(session.get_inputs())
    return session


@cache
def _bound_memory() -> None:
    """Give all networks of this process together a bounded memory."""
    runtime = needed("onnxruntime", "onnx", "OnnxEncoding")
    cpu = runtime.OrtMemoryInfo(
        "Cpu",
        runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR,
        0,
        runtime.OrtMemType.DEFAULT,
    )
    most = runtime.OrtArenaCfg(MAX_MEMORY_GB * 2**30, 0, -1, -1)
    runtime.create_and_register_allocator(cpu, most)


def _check_input(inputs: Sequence[Any]) -> None:
    """Refuse a network that takes no images, or one image at a time."""
    shapes = [(node.type, node.shape) for node in inputs]
    kind, shape = shapes[0] if len(shapes) == 1 else ("", [])
    if kind != "tensor(float)" or len(shape) != 4 or shape[1] not in (1, 3):
        got = ", ".join(f"{kind} {shape}" for kind, shape in shapes) or "no input"
        raise ValueError(
            "network must take float images (n, 1 or 3 channels, n_rows, n_cols), got "
            f"{got}."
        )
    if isinstance(shape[0], int):
        raise ValueError(
            f"network must take any number of images at once, got {shape[0]}. Export "
            "it with a dynamic first axis (torch: dynamic_axes={'images': {0: 'n'}})."
        )
    sides = [side for side in shape[2:] if isinstance(side, int)]
    if any(not 0 < side <= MAX_SIDE for side in sides):
        raise ValueError(
            f"network must take images of 1 to {MAX_SIDE} pixels a side, got "
            f"{' x '.join(map(str, shape[2:]))}."
        )


def _rows(output: Any, n_images: int) -> Floats:
    """Return an output as vectors, one a row, or explain."""
    if not isinstance(output, np.ndarray) or output.dtype.kind != "f":
        got = output.dtype if isinstance(output, np.ndarray) else type(output).__name__
        raise ValueError(f"The network must give floats, got {got}.")
    if output.ndim < 2 or len(output) != n_images or not output.size:
        raise ValueError(
            f"The network must give one vector for each of {n_images} images, got "
            f"shape {output.shape}."
        )
    vectors = output.reshape(n_images, -1).astype(np.float64)
    if not np.isfinite(vectors).all():
        raise ValueError(
            "The network gave NaN or infinity. Give mean and std that its training "
            "images had, or train it with weight decay."
        )
    return vectors


def _resized(image: Singles, size: Sequence[int]) -> Singles:
    """Return an image (n_rows, n_cols, n_channels) of another size."""
    rows, cols = size
    smaller = rows * cols < image.shape[0] * image.shape[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    resized: Any = cv2.resize(image, (cols, rows), interpolation=way)
    return np.asarray(resized, dtype=np.float32).reshape(rows, cols, image.shape[2])


def _levels(
    name: str, parameter: ArrayLike | None, learnt: float, n_channels: int
) -> Floats:
    """Return what a parameter says for all channels or for each, or what was learnt."""
    if parameter is None:
        return np.array([learnt])
    values = np.atleast_1d(np.asarray(parameter, dtype=np.float64))
    if values.shape not in ((1,), (n_channels,)) or not np.isfinite(values).all():
        raise ValueError(
            f"{name} must be one number, or one for each of {n_channels} channels, got "
            f"{parameter!r}."
        )
    return values


def _bytes_of(network: str | Path | Array) -> bytes:
    """Return the bytes of a network, read from its file if need be."""
    if isinstance(network, np.ndarray):
        if network.dtype != np.uint8 or network.ndim != 1:
            raise TypeError(
                "network must be a path or bytes as an array of uint8, got "
                f"{network.dtype} of shape {network.shape}."
            )
        return network.tobytes()
    if not isinstance(network, str | Path):
        raise TypeError(
            f"network must be a path or an array of uint8, got {type(network).__name__}"
            ". Write np.frombuffer(content, np.uint8) for bytes."
        )
    path = Path(network)
    if not path.is_file():
        raise ValueError(f"There is no network file {path}. Check the path.")
    _check_size(path.stat().st_size, f"{path} with ")
    return path.read_bytes()


def _check_size(n_bytes: int, name: str = "") -> None:
    if n_bytes > MAX_NETWORK_MB * MB:
        raise ValueError(
            f"network must be at most {MAX_NETWORK_MB} MB, got {name}"
            f"{n_bytes / MB:.0f} MB. Use a smaller network, or 16-bit weights."
        )


def _first_line(error: Exception) -> str:
    """Return what the runtime says, in one line of bearable length."""
    return " ".join(str(error).split())[:200].rstrip(".")
