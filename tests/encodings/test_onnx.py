"""Networks in ONNX files: encoded by, or refused with a sentence before they run."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from palpate.encodings import OnnxEncoding

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
helper = onnx.helper

FLOAT = onnx.TensorProto.FLOAT


def node(kind, inputs, output, **attributes):
    return helper.make_node(kind, inputs, [output], **attributes)


def network(
    nodes=None, *, shape=("n", 1, "h", "w"), output="out", weights=(), opset=17, **more
):
    """A network in one file; by default the mean and the largest of each image."""
    if nodes is None:
        nodes = [
            node("GlobalAveragePool", ["x"], "mean"),
            node("GlobalMaxPool", ["x"], "most"),
            node("Concat", ["mean", "most"], "both", axis=1),
            node("Flatten", ["both"], "out"),
        ]
    outputs = [output] if isinstance(output, str) else output
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info("x", more.pop("kind", FLOAT), shape)],
        [helper.make_tensor_value_info(name, FLOAT, None) for name in outputs],
        list(weights),
    )
    imports = [helper.make_opsetid("", opset)]
    imports += [helper.make_opsetid(name, 1) for name in more.pop("domains", ())]
    model = helper.make_model(graph, opset_imports=imports, ir_version=8, **more)
    return np.frombuffer(model.SerializeToString(), dtype=np.uint8)


@pytest.fixture
def images(rng):
    return rng.random((5, 6, 8))


def scaled(images):
    return (images - images.mean()) / images.std()


def test_a_network_encodes_images_brought_to_mean_0_and_variance_1(images):
    vectors = OnnxEncoding(network()).fit_transform(images)
    flat = scaled(images).reshape(5, -1)
    expected = np.stack([flat.mean(axis=1), flat.max(axis=1)], axis=1)
    assert_allclose(vectors, expected, atol=1e-5)


def test_half_precision_is_encoded_as_single_is(images):
    # Squares of these sum up to 2.4 million; half precision ends at 65,504.
    half = (200 * images).astype(np.float16)
    single = OnnxEncoding(network()).fit_transform(half.astype(np.float32))
    assert_allclose(OnnxEncoding(network()).fit_transform(half), single, atol=1e-5)


def test_levels_may_be_given(images):
    encoding = OnnxEncoding(network(), mean=0.5, std=2.0).fit(images)
    expected = (images.reshape(5, -1).mean(axis=1) - 0.5) / 2
    assert_allclose(encoding.transform(images)[:, 0], expected, atol=1e-6)


def test_grey_is_repeated_and_colour_is_averaged(images, rng):
    repeated = OnnxEncoding(network(shape=("n", 3, "h", "w"))).fit(images)
    assert repeated.width_ == 6
    assert_allclose(*repeated.transform(images)[:, :2].T, atol=1e-6)
    colours = rng.random((5, 6, 8, 3))
    averaged = OnnxEncoding(network(), mean=0, std=1).fit(colours)
    grey = OnnxEncoding(network(), mean=0, std=1).fit(images)
    expected = grey.transform(colours.mean(axis=3))
    assert_allclose(averaged.transform(colours), expected, atol=1e-6)


def test_images_are_resized_to_what_the_network_takes(images):
    fixed = OnnxEncoding(network(shape=("n", 1, 12, 12))).fit(images)
    assert fixed.transform(images).shape == (5, 2)


def test_one_of_several_outputs_is_named(images):
    nodes = [
        node("GlobalAveragePool", ["x"], "mean"),
        node("GlobalMaxPool", ["x"], "most"),
    ]
    both = network(nodes, output=["mean", "most"])
    most = OnnxEncoding(both, output="most").fit_transform(images)
    assert_allclose(most[:, 0], scaled(images).max(axis=(1, 2)), atol=1e-5)
    for output in (None, "least"):
        with pytest.raises(ValueError, match=r"output must be one of.*'mean', 'most'"):
            OnnxEncoding(both, output=output).fit(images)


def test_a_file_is_read_once_and_kept(images, tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(network().tobytes())
    encoding = OnnxEncoding(path).fit(images)
    path.unlink()
    assert encoding.transform(images).shape == (5, 2)
    assert_array_equal(encoding.stored().network, encoding.network_)
    assert clone(encoding).network == path


def external(name="w"):
    tensor = helper.make_tensor(name, FLOAT, [1], [1.0])
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    return tensor


def inside(kind, **attributes):
    return [node(kind, ["x"], "out", **attributes)]


def with_branch():
    branch = helper.make_graph([], "b", [], [])
    return [node("If", ["x"], "out", then_branch=branch, else_branch=branch)]


REFUSED = {
    "another maker's operators": (
        lambda: network([node("Gelu", ["x"], "out", domain="com.microsoft")]),
        "standard operators of ONNX alone, got 'com.microsoft'",
    ),
    "another maker's name alone": (
        lambda: network(domains=["ai.onnx.ml"]),
        "standard operators of ONNX alone, got 'ai.onnx.ml'",
    ),
    "weights in another file": (
        lambda: network(weights=[external()]),
        "hold all its weights, got 'w' in another file",
    ),
    "weights of a constant in another file": (
        lambda: network(
            [node("Constant", [], "c", value=external()), *inside("Identity")]
        ),
        "hold all its weights",
    ),
    "control flow": (lambda: network(with_branch()), "without control flow"),
    "chance": (
        lambda: network(inside("RandomNormalLike")),
        "must not use random operators, got 'RandomNormalLike'",
    ),
    "a function": (
        lambda: network(functions=[helper.make_function("", "F", [], [], [], [], [])]),
        "no functions of its own, got 'F'",
    ),
    "an old version": (lambda: network(opset=6), "version 7 to 26, got 6"),
    "too many operators": (
        lambda: network(inside("Identity") * 20_001),
        "at most 20000 operators",
    ),
    "nothing": (lambda: np.empty(0, np.uint8), "no ONNX file, or damaged"),
    "text": (lambda: np.frombuffer(b"a picture", np.uint8), "no ONNX file"),
    "two channels": (
        lambda: network(shape=("n", 2, "h", "w")),
        "1 or 3 channels.* got .*2",
    ),
    "vectors": (lambda: network(shape=("n", 5)), "must take float images"),
    "one image at a time": (
        lambda: network(shape=(1, 1, "h", "w")),
        "any number of images at once, got 1",
    ),
    "immense images": (
        lambda: network(shape=("n", 1, 9000, 9000)),
        "1 to 2048 pixels a side, got 9000 x 9000",
    ),
    "integers": (
        lambda: network(inside("Cast", to=FLOAT), kind=onnx.TensorProto.INT64),
        "must take float images",
    ),
    "images out": (
        lambda: network(inside("ReduceMean", keepdims=0)),
        "one vector for each of",
    ),
    "infinity": (lambda: network(inside("Log")), "gave NaN or infinity"),
    "a shape": (lambda: network(inside("Shape")), "cannot be run|must give floats"),
    "neighbours in the batch": (
        lambda: network(
            [
                node("ReduceMean", ["x"], "mean", axes=[0], keepdims=1),
                node("Sub", ["x", "mean"], "left"),
                node("Flatten", ["left"], "out"),
            ]
        ),
        "whatever else is in the batch",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_network_of_images_does_not_need_is_refused(case, images):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        OnnxEncoding(make()).fit(images)


def test_every_damaged_byte_is_refused_or_harmless(images, rng):
    content = network()
    for place in rng.choice(len(content), 60, replace=False):
        damaged = content.copy()
        damaged[place] ^= 1 << rng.integers(8)
        try:
            vectors = OnnxEncoding(damaged).fit_transform(images)
        except ValueError:
            continue
        assert np.isfinite(vectors).all()


def test_vectors_of_another_length_are_refused(images, rng):
    flat = OnnxEncoding(network(inside("Flatten"))).fit(images)
    with pytest.raises(ValueError, match=r"must give 48 numbers.*got 100"):
        flat.transform_checked(rng.random((2, 10, 10)))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"std": 0.0}, "std must be positive"),
        ({"mean": [0.1, 0.2]}, "mean must be one number, or one for each"),
        ({"mean": np.nan}, "mean must be one number"),
    ],
)
def test_levels_that_are_none_are_refused(images, parameters, message):
    with pytest.raises(ValueError, match=message):
        OnnxEncoding(network(), **parameters).fit(images)


def test_a_missing_file_is_named(tmp_path, images):
    with pytest.raises(ValueError, match=r"no network file .*none\.onnx"):
        OnnxEncoding(tmp_path / "none.onnx").fit(images)
    with pytest.raises(TypeError, match="bytes as an array of uint8"):
        OnnxEncoding(np.ones(3)).fit(images)
    with pytest.raises(TypeError, match=r"network must be a path .*got bytes"):
        OnnxEncoding(b"network").fit(images)
