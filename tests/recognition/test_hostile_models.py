"""Models that somebody forged are refused quickly, or answer like any other."""

import json
import time
import tracemalloc
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from forged_models import forged, models, mutated, opened
from numpy.testing import assert_array_equal

from palpate import ObjectRecogniser, Touches
from palpate.recognition import ModelFileError, SequenceCalibration

# What a forged model may cost at most; tracing memory makes reading four times slower,
# and machines are shared.
HANG_S = 10.0
MB = 2**20


def refusal_of(path):
    """Return what a model is refused with, "" where it is read."""
    try:
        ObjectRecogniser.load(path)
    except ModelFileError as error:
        return str(error)
    return ""


def check_bounded(path):
    """Load a model in bounded time and memory; return what it is refused with."""
    tracemalloc.start()
    start = time.process_time()
    refusal = refusal_of(path)
    seconds = time.process_time() - start
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < HANG_S, refusal
    assert peak < 4 * path.stat().st_size + 200 * MB, refusal
    return refusal


@pytest.mark.slow
@pytest.mark.parametrize(("n_seeds", "least"), [(100, 30), (10_000, 3000)])
def test_mutated_models_are_bounded(tmp_path, n_seeds, least):
    saved = [
        opened(model.save(tmp_path / f"{number}.palpate"))
        for number, model in enumerate(models())
    ]
    refused = 0
    for seed in range(n_seeds):
        document, tensors = mutated(*saved[seed % len(saved)], seed)
        path = forged(tmp_path / "forged.palpate", document, tensors)
        try:
            refused += bool(check_bounded(path))
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
    assert refused > least


def changed(folder, number, change):
    document, tensors = opened(models()[number].save(folder / "b.palpate"))
    change(document["model"]["learnt"], tensors)
    return forged(folder / "b.palpate", document, tensors)


def holders_of(node, name):
    """Return all dictionaries in which `name` is a key."""
    children = node.values() if isinstance(node, dict) else node
    holders = [node] if isinstance(node, dict) and name in node else []
    nested = (
        holders_of(child, name) for child in children if isinstance(child, dict | list)
    )
    return holders + [holder for inner in nested for holder in inner]


def with_all(name, value):
    def change(learnt, tensors):
        for holder in holders_of(learnt, name):
            holder[name] = value

    return change


def with_high_degree(learnt, tensors):
    kernel = {"class": "PolynomialKernel", "params": {"degree": 2**31}, "learnt": {}}
    for holder in holders_of(learnt, "kernels_"):
        holder["kernels_"]["list"][0] = kernel


def with_grids(shape, *names):
    def change(learnt, tensors):
        for number, holder in enumerate(holders_of(learnt, "smooth_down_")):
            for name in names:
                tensors[f"{name}{number}"] = np.ones(shape)
                holder[name] = {"array": f"{name}{number}", "shape": list(shape)}
        with_all("blur", {"float": "1.0"})(learnt, tensors)

    return change


def with_yes_or_no_pads(learnt, tensors):
    contact = learnt["contact_"]["learnt"]["pads_"]
    tensors[contact["array"]] = tensors[contact["array"]].astype(bool)


@pytest.mark.parametrize(
    ("number", "change", "message"),
    [
        (1, with_grids((8000, 10), "smooth_down_", "smooth_across_"), "do not fit"),
        (1, with_grids((300_000, 1, 1), "baseline_"), "do not fit"),
        (1, with_grids((8000, 10), "down_", "across_"), "at most 1024 cells"),
        (6, with_yes_or_no_pads, "pads_ are no whole numbers"),
        (6, with_all("grids_", {"list": [None, None]}), "no attribute"),
        (5, with_high_degree, "degree must be at most 60"),
        (5, with_all("shape", {"tuple": [12_000, 12_000]}), "at most 1024"),
        (4, with_all("disc_radius_", {"float": "1e9"}), "disc_radius_ must be"),
        (3, with_all("disc_radius_", {"float": "20.1"}), "between 0 and 20, got 20.1"),
        (3, with_all("disc_radius_", {"float": "-0.1"}), "between 0 and 20, got -0.1"),
        (3, with_all("disc_radius_", {"float": "20.0"}), ""),  # as large as its frame
        (1, with_all("image_shape_", {"tuple": [{"float": 1e400}, 5]}), "inf"),
    ],
)
def test_what_would_hang_or_fill_memory_is_refused(tmp_path, number, change, message):
    refusal = check_bounded(changed(tmp_path, number, change))
    assert message in refusal
    assert bool(message) == bool(refusal)


def test_the_checksum_is_compared(tmp_path):
    path = models()[0].save(tmp_path / "a.palpate")
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    assert "checksum does not match" in refusal_of(path)


def test_a_larger_file_than_asked_for_is_refused_unread(tmp_path, monkeypatch):
    path = models()[0].save(tmp_path / "a.palpate")
    monkeypatch.setenv("PALPATE_MAX_MODEL_MB", "0.001")
    assert "PALPATE_MAX_MODEL_MB" in refusal_of(path)
    for odd in ("2 GB", "nan", ""):
        monkeypatch.setenv("PALPATE_MAX_MODEL_MB", odd)
        assert f"must be a number of MB, got {odd!r}. Set" in refusal_of(path)


def test_what_could_not_be_read_is_not_written(tmp_path):
    model = ObjectRecogniser().fit(
        np.random.default_rng(0).random((8, 3, 6)), ["a"] * 4 + ["b" * 2000] * 4
    )
    with pytest.raises(ModelFileError, match="could not be read again"):
        model.save(tmp_path / "a.palpate")
    assert list(tmp_path.iterdir()) == []


def ratios(change):
    """Return what changes a curve by a change of its ratios."""
    return lambda curve: replace(curve, log_ratios=change(curve.log_ratios))


def remounted(**corrections):
    """Return a model whose encoder is wrapped in these corrections."""
    model = deepcopy(models()[0])
    images = np.random.default_rng(0).random((8, *model.encoder_.image_shape_))
    model.remount(Touches(100 * images, geometry="none"))
    nothing = {**dict.fromkeys(CORRECTIONS), "gain": 1.0}
    model.encoder_ = replace(model.encoder_, **{**nothing, **corrections})
    return model


CORRECTIONS = ["offset", "weighing", "drift", "broken", "look_offset"]


def test_corrections_as_large_as_a_touch_are_read_and_made(tmp_path):
    shape, n = models()[0].encoder_.image_shape_, models()[0].memory_.features.shape[1]
    rng = np.random.default_rng(0)
    model = remounted(
        drift=rng.normal(size=shape),
        broken=rng.random(shape) < 0.1,
        offset=rng.normal(size=n),
        weighing=np.eye(n) + 0.1 * rng.normal(size=(n, n)),
        look_offset=rng.normal(size=7),
    )
    model.encoder_.encoder.still_ = rng.normal(size=shape)
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    images = rng.random((3, *shape))
    for after, before in zip(
        again.evidence(images), model.evidence(images), strict=True
    ):
        assert_array_equal(after, before)


@pytest.mark.parametrize("name", [*CORRECTIONS, "still_"])
def test_corrections_of_a_touch_must_be_as_large_as_it(tmp_path, name):
    # Else a small column would be spread over all features, a thousand times over.
    small = np.zeros((1000, 1))
    model = remounted() if name == "still_" else remounted(**{name: small})
    if name == "still_":
        model.encoder_.encoder.still_ = small
    refusal = refusal_of(model.save(tmp_path / "m.palpate"))
    assert f"its {name} has shape" in refusal


def test_an_encoder_wrapped_twice_is_refused(tmp_path):
    model = remounted()
    model.encoder_ = replace(model.encoder_, encoder=model.encoder_)
    refusal = refusal_of(model.save(tmp_path / "m.palpate"))
    assert "encoder_ is a RemountedEncoder" in refusal


def test_a_gain_is_read_up_to_its_bounds(tmp_path):
    for gain, message in ((1e-6, ""), (1e6, ""), (9e-7, "gain"), (1.1e6, "gain")):
        refusal = refusal_of(remounted(gain=gain).save(tmp_path / "m.palpate"))
        assert message in refusal
        assert bool(message) == bool(refusal)


def test_an_encoder_that_holds_its_own_corrections_is_wrapped(tmp_path):
    """Model files were such before encoders were wrapped."""
    n_features = models()[0].memory_.features.shape[1]
    model = remounted(gain=1.5, offset=np.full(n_features, 0.25))
    document, tensors = opened(model.save(tmp_path / "new.palpate"))
    learnt = document["model"]["learnt"]
    params = learnt["encoder_"]["params"]
    learnt["encoder_"] = params.pop("encoder")
    learnt["encoder_"]["learnt"] |= {f"{name}_": v for name, v in params.items()}
    path = forged(tmp_path / "old.palpate", document, tensors)
    images = np.random.default_rng(1).random((3, *model.encoder_.image_shape_))
    log_likelihood = ObjectRecogniser.load(path).log_likelihood(images)
    assert_array_equal(log_likelihood, model.log_likelihood(images))


@pytest.mark.parametrize("number", range(6))
def test_a_sound_model_is_read_and_answers_as_before(tmp_path, number):
    model = models()[number]
    images = np.random.default_rng(1).random((3, *model.encoder_.image_shape_))
    touches = Touches(images, channels=list("rgb") if images.ndim == 4 else None)
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    assert_array_equal(again.log_likelihood(touches), model.log_likelihood(touches))


def with_nan(values):
    return np.where(np.arange(values.size).reshape(values.shape) == 0, np.nan, values)


def altered(folder, place, change):
    """Save a model that was changed at a place such as "strangers_.weights"."""
    model = deepcopy(models()[0])
    name, _, inner = place.partition(".")
    part = getattr(model, name)
    new = replace(part, **{inner: change(getattr(part, inner))}) if inner else None
    setattr(model, name, new if inner else change(part))
    return model.save(folder / "m.palpate")


def to(value):
    return lambda _: value


@pytest.mark.parametrize(
    ("place", "change", "message"),
    [
        ("strangers_.weights", lambda v: v[:0], "no such table"),
        ("strangers_.weights", lambda v: v[None], "no such table"),
        ("strangers_.weights", lambda v: -0.01 + 0 * v, "below 0"),
        ("strangers_.weights", to(np.ones(9) / 9), "by_encoding must have"),
        ("strangers_.weights", lambda v: np.ones_like(v) / len(v), ""),
        ("strangers_.usual", lambda v: v[:1], "no such table"),
        ("strangers_.usual", with_nan, "NaN or infinity"),
        ("strangers_.usual", lambda v: v - 1e6, ""),
        ("strangers_.far", lambda v: np.c_[v, v], "no such table"),
        ("strangers_.far", lambda v: 0 * v, "no spread"),
        ("strangers_.far", lambda v: np.c_[v[:, 0] - 1e6, v[:, 1]], ""),
        ("strangers_.high", lambda v: v[:, :1], "no such table"),
        ("strangers_.high", lambda v: 0 * v, "no spread"),
        ("strangers_.high", with_nan, "NaN or infinity"),
        ("strangers_.high", lambda v: np.c_[v[:, 0], 0 * v[:, 0] + 1e-6], ""),
        ("strangers_.exceeded", with_nan, "NaN or infinity"),
        ("strangers_.exceeded", lambda v: v[:0], "no such table"),
        ("strangers_.exceeded", lambda v: v[:1], ""),
        ("strangers_.low_curve", lambda v: replace(v, levels=v.levels[::-1]), "falls"),
        ("strangers_.low_curve", ratios(lambda r: r[:, 1:]), "no such table"),
        ("strangers_.low_curve", ratios(lambda r: r[[0, 0, 0]]), "other obj"),
        ("strangers_.low_curve", ratios(lambda r: 0 * r), ""),
        ("strangers_.high_curve", ratios(lambda r: -r), "falls"),
        (
            "strangers_.high_curve",
            lambda v: replace(v, levels=with_nan(v.levels)),
            "NaN",
        ),
        ("strangers_.low_category_curve", lambda v: v.levels, "curve of its strangers"),
        ("strangers_.n_units", to(0), "n_units must be at least 1"),
        ("strangers_.n_units", to(1), ""),
        ("strangers_.population", to(5), "no text"),
        ("memory_.looks", lambda v: v[:, :-1], "its looks have"),
        ("memory_.looks", lambda v: v[:-1], "sizes do not agree"),
        ("memory_.features", with_nan, "features hold NaN"),
        ("memory_.looks", lambda v: np.inf + 0 * v, "features hold NaN"),
        ("memory_.weights", with_nan, "weights are no positive numbers"),
        ("memory_.weights", lambda v: 0 * v, "weights are no positive numbers"),
        ("memory_.weights", lambda v: v / 4, ""),
        ("memory_.categories", lambda v: v[:1], "damaged"),
        ("memory_", to(None), "damaged"),
        ("memory_", lambda v: v.without(["mug", "pen"]), "damaged"),
        ("pose_", to(SequenceCalibration()), "pose_ is a SequenceCalibration"),
        ("classes_", lambda v: v[::-1], "objects are not those of its touches"),
        ("preset", to("zzz"), "preset must be one of"),
        ("modalities_", to([1]), "damaged"),
        ("modalities_", to({"sight": SequenceCalibration()}), "is a SequenceCalibrati"),
    ],
)
def test_parts_that_do_not_fit_are_refused(tmp_path, place, change, message):
    refusal = refusal_of(altered(tmp_path, place, change))
    assert message in refusal
    assert bool(message) == bool(refusal)


@pytest.mark.parametrize(
    ("place", "bounds", "beyond"),
    [
        ("floor_", (0.0, 0.5), (-1e-3, 0.501)),
        ("sequence_calibration_.strength", (0.0, 100.0), (-1e-3, 100.1)),
        ("sequence_calibration_.correlation", (0.0, 1.0), (-1e-3, 1.001)),
    ],
)
def test_numbers_are_read_up_to_their_bounds(tmp_path, place, bounds, beyond):
    message = f"{place.rpartition('.')[2]} must be"
    for number in (*bounds, *beyond):
        refusal = refusal_of(altered(tmp_path, place, to(number)))
        assert (message in refusal) == (number in beyond) == bool(refusal)


@pytest.mark.parametrize(
    ("calibration", "message"),
    [
        (SequenceCalibration(), ""),
        (7, "a sequence calibration is a int"),
        (SequenceCalibration(200.0), "strength must be"),
    ],
)
def test_a_sense_of_another_calibration_is_refused(tmp_path, calibration, message):
    model = deepcopy(models()[0])
    model.learn_modality("sight", np.eye(4), ["mug", "mug", "pen", "pen"])
    model.modalities_["sight"].sequence_calibration_ = calibration
    refusal = refusal_of(model.save(tmp_path / "m.palpate"))
    assert message in refusal
    assert bool(message) == bool(refusal)


def test_a_model_that_lacks_a_part_is_refused(tmp_path):
    path = changed(tmp_path, 0, lambda learnt, tensors: learnt.pop("pose_"))
    assert "has no attribute 'pose_'" in refusal_of(path)


def node(name="SequenceCalibration", params=None, **learnt):
    return {"class": name, "params": params or {}, "learnt": learnt}


def beside(*nodes):
    """Return a change that adds nodes to what a model keeps of its choices."""

    def change(learnt, tensors):
        learnt["chosen_"]["dict"].append(["more", {"list": [*nodes]}])

    return change


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return a function that forges a model, written once, with more nodes."""
    folder = tmp_path_factory.mktemp("plain")
    document, tensors = opened(models()[0].save(folder / "a.palpate"))

    def forge(place, *nodes):
        other = deepcopy(document)
        beside(*nodes)(other["model"]["learnt"], tensors)
        return forged(place / "b.palpate", other, tensors)

    return forge


TOUCHES = {"list": [0] * 2000}
MOST = {
    **dict.fromkeys(("degree", "order", "n_orientations", "n_partitions"), 60),
    **dict.fromkeys(("n_points", "n_rings", "radii", "n_harmonics", "cell"), 32),
    **dict.fromkeys(("shape", "side", "cells", "n", "resample", "n_quantiles"), 1024),
    **dict.fromkeys(("size", "size_"), 2048),
    "whatever_": 2**53,
}


@pytest.mark.parametrize("name", MOST)
def test_parameters_that_set_a_size_have_a_limit(tmp_path, plain, name):
    most = MOST[name]
    for value in (most, most + 1):
        part = node(params={name: value}) if name[-1] != "_" else node(**{name: value})
        refusal = refusal_of(plain(tmp_path, part))
        assert (f"{name} must be at most {most}, got {value}" in refusal) == (
            value > most
        )


@pytest.mark.parametrize("value", [-2048, -2049])
def test_sizes_have_a_limit_below_zero_and_inside_of_lists(tmp_path, plain, value):
    for size in (value, {"tuple": [1, value]}, {"list": [1, value]}):
        refusal = refusal_of(plain(tmp_path, node(size_=size)))
        assert (f"at most 2048, got {value}" in refusal) == (value < -2048)


@pytest.mark.parametrize(
    ("params", "learnt", "refused"),
    [
        # Zernike moments of high order keep tables for each level.
        ({"order": 20}, {"image_shape_": {"tuple": [9000, 9000]}}, False),
        # 45,339 levels times 441
        ({"order": 21}, {"image_shape_": {"tuple": [21, 2159]}}, False),
        ({"order": 21}, {"image_shape_": {"tuple": [21, 2160]}}, True),
        # 20 million
        ({"order": 40}, {"image_shape_": {"tuple": [100, 125]}}, False),
        ({"order": 40}, {"image_shape_": {"tuple": [1, 12_501]}}, True),
        ({"order": 60}, {"image_shape_": {"tuple": [5, 1112]}}, True),
        # Kernels times touches are at most five million.
        ({}, {"kernels_": {"list": [0] * 2500}, "touches_": TOUCHES}, False),
        ({}, {"kernels_": {"list": [0] * 2501}, "touches_": TOUCHES}, True),
    ],
)
def test_what_costs_too_much_for_one_touch_is_refused(
    tmp_path, plain, params, learnt, refused
):
    # The model is refused for another reason, or read, where this one does not hold.
    refusal = refusal_of(plain(tmp_path, node(params=params, **learnt)))
    assert ("too much for one touch" in refusal) == refused


def test_a_model_has_at_most_five_hundred_parts(tmp_path):
    document, _ = opened(models()[0].save(tmp_path / "a.palpate"))
    more = 500 - len(holders_of(document, "class"))
    for n_nodes, refused in ((more, False), (more + 1, True)):
        refusal = refusal_of(changed(tmp_path, 0, beside(*[node()] * n_nodes)))
        assert bool(refusal) == refused
        assert refusal.count("501 parts, too much for one touch") == refused


@pytest.mark.parametrize(
    ("counts", "refused"), [([0, 4], False), ([-1, 4], True), ([0, 5], True)]
)
def test_touches_are_counted_from_none_to_all(tmp_path, counts, refused):
    def change(learnt, tensors):
        tensors["t900"] = np.array(counts)
        counted = {"array": "t900", "shape": [2], "turned": False}
        beside(node(counts_=counted, points_={"list": [0] * 4}))(learnt, tensors)

    refusal = refusal_of(changed(tmp_path, 0, change))
    assert ("more touches than there are" in refusal) == refused


@pytest.mark.parametrize(
    ("shapes", "refused"),
    [
        ([[2, 3]] * 4, False),
        ([[2, 3]] * 5, True),
        ([[3, 2]], True),
        ([[6]], True),
        ([[]], True),
    ],
)
def test_an_array_is_used_four_times_at_most_in_its_own_shape(
    tmp_path, shapes, refused
):
    def change(learnt, tensors):
        tensors["t900"] = np.zeros((2, 3))
        uses = [{"array": "t900", "shape": shape, "turned": False} for shape in shapes]
        beside(*uses)(learnt, tensors)

    refusal = refusal_of(changed(tmp_path, 0, change))
    assert ("the array t900 has shape (2, 3)" in refusal) == refused


@pytest.mark.parametrize(("more", "refused"), [(0, False), (1, True)])
def test_a_document_has_a_million_values_and_one_in_fifty_bytes(
    tmp_path, more, refused
):
    """Each bracket, brace and comma counts as a value."""
    path, start, end = tmp_path / "a.palpate", '{"a":[0', "]}"

    def written(n_values):
        return forged(path, start + ",0" * (n_values - 2) + end, {}).stat().st_size

    n_values = 1_000_000
    while n_values + 1 <= 1_000_000 + written(n_values + 1) / 50:
        n_values = int(1_000_000 + written(n_values + 1) / 50)
    n_bytes = written(n_values + more)
    assert (n_values + more > 1_000_000 + n_bytes / 50) == refused
    message = f"{n_values + more} values are too many for its size"
    assert (message in check_bounded(path)) == refused


def test_a_document_of_other_letters_than_ascii_is_refused(tmp_path):
    path = forged(tmp_path / "a.palpate", '{"format": 4, "model": "é"}', {})
    assert "letters beyond ASCII" in refusal_of(path)


@pytest.mark.parametrize(("n_letters", "refused"), [(1000, False), (1001, True)])
def test_a_text_has_a_thousand_letters_at_most(tmp_path, plain, n_letters, refused):
    texts = {"text": ["x" * n_letters, "y"], "shape": [2]}
    refusal = f"2 texts of up to {n_letters} letters"
    assert (refusal in refusal_of(plain(tmp_path, texts))) == refused


def test_texts_take_32_mb_and_half_of_the_file_at_most(tmp_path):
    """Arrays of texts take 4 bytes a letter of the longest."""
    path = models()[0].save(tmp_path / "a.palpate")
    document, tensors = opened(path)
    texts = {"text": ["x" * 1000, *["y"] * 8499], "shape": [8500]}
    beside(texts)(document["model"]["learnt"], tensors)
    held = [holder["text"] for holder in holders_of(document, "text")]
    n_letters = sum(max(map(len, items), default=0) * len(items) for items in held)
    most = 2 * (4 * n_letters - 32 * MB)  # bytes of a file that may hold them
    text = json.dumps(document)
    # Files of whole words, as headers are.
    n_odd = forged(path, text, tensors).stat().st_size % 8
    tensors["t900"] = np.zeros(8 - n_odd, dtype=np.uint8)
    short = most - forged(path, text, tensors).stat().st_size
    assert 0 < short < 8 * MB
    for missing, refused in ((0, False), (8, True)):
        forged(path, text + " " * (short - missing), tensors)
        assert path.stat().st_size == most - missing
        assert ("texts of up to" in check_bounded(path)) == refused


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ([10_000, 5000], ""),  # 50 million levels, too many to try
        ([10_000, 5001], "images of 10000 x 5001 are none"),
        ([10], "images of 10 are none"),
        ([10, 0], "images of 10 x 0 are none"),
        ([2, 2, 2, 2], "images of 2 x 2 x 2 x 2 are none"),
        ([1, 800_001], ""),
        ([1, 800_000], "damaged"),  # tried, and does not fit
    ],
)
def test_images_have_50_million_levels_and_are_tried_up_to_800_000(
    tmp_path, shape, message
):
    model = deepcopy(models()[0])
    model.encoder_.image_shape_ = tuple(shape)
    model.encoder_.still_ = None
    refusal = refusal_of(model.save(tmp_path / "m.palpate"))
    assert message in refusal
    assert bool(message) == bool(refusal)
