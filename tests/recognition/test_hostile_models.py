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
from palpate.recognition import ModelFileError

HANG_S = 2.0
MB = 2**20


def told(path):
    """Load a model; return what it was refused with, seconds, and the peak in bytes."""
    tracemalloc.start()
    start, refusal = time.process_time(), None
    try:
        ObjectRecogniser.load(path)
    except ModelFileError as error:
        refusal = str(error)
    seconds = time.process_time() - start
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return refusal, seconds, peak


def check_bounded(path):
    refusal, seconds, peak = told(path)
    assert seconds < HANG_S, refusal
    assert peak < 4 * path.stat().st_size + 200 * MB, refusal
    return refusal


def campaign(folder, seeds):
    saved = [
        opened(model.save(folder / f"{number}.palpate"))
        for number, model in enumerate(models())
    ]
    refused = 0
    for seed in seeds:
        document, tensors = mutated(*saved[seed % len(saved)], seed)
        path = forged(folder / "forged.palpate", document, tensors)
        try:
            refused += check_bounded(path) is not None
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
    return refused


def test_a_hundred_mutated_models_are_bounded(tmp_path):
    assert campaign(tmp_path, range(100)) > 30


@pytest.mark.slow
def test_ten_thousand_mutated_models_are_bounded(tmp_path):
    assert campaign(tmp_path, range(10_000)) > 3000


def changed(folder, number, change):
    document, tensors = opened(models()[number].save(folder / "b.palpate"))
    change(document["model"]["learnt"], tensors)
    return forged(folder / "b.palpate", document, tensors)


def every(node, name):
    """Return all dictionaries in which `name` is a key."""
    children = node.values() if isinstance(node, dict) else node
    found = [node] if isinstance(node, dict) and name in node else []
    nested = (
        every(child, name) for child in children if isinstance(child, dict | list)
    )
    return found + [one for some in nested for one in some]


def with_all(name, value):
    def change(learnt, tensors):
        for holder in every(learnt, name):
            holder[name] = value

    return change


def with_high_degree(learnt, tensors):
    kernel = {"class": "PolynomialKernel", "params": {"degree": 2**31}, "learnt": {}}
    for holder in every(learnt, "kernels_"):
        holder["kernels_"]["list"][0] = kernel


def with_many_kernels(learnt, tensors):
    for holder in every(learnt, "kernels_"):
        holder["kernels_"]["list"] *= 1000


def with_many_counted(learnt, tensors):
    name = learnt["classifier_"]["learnt"]["counts_"]["array"]
    tensors[name] = np.full_like(tensors[name], 2**30)


def with_array_again(learnt, tensors):
    encoder = learnt["encoder_"]["learnt"]
    again = {"list": [encoder["encodings_"]] * 100}
    encoder["encodings_"] = {"dict": [["", again]]}


@pytest.mark.parametrize(
    ("number", "change", "message"),
    [
        (5, with_high_degree, "degree must be at most 60"),
        (4, with_all("order", 10**30), "order must be at most 60"),
        (5, with_all("shape", {"tuple": [12_000, 12_000]}), "at most 1024"),
        (5, with_many_kernels, "501 parts"),
        (4, with_many_counted, "more touches than there are"),
        (1, with_array_again, "array t1"),
        (1, with_all("image_shape_", {"tuple": [9000, 9000]}), "9000 x 9000"),
        (1, with_all("image_shape_", {"tuple": [{"float": 1e400}, 5]}), "inf"),
    ],
)
def test_what_would_hang_or_fill_memory_is_refused(tmp_path, number, change, message):
    path = changed(tmp_path, number, change)
    assert message in (check_bounded(path) or "")


def test_nan_among_the_features_is_refused(tmp_path):
    def spoil(learnt, tensors):
        tensors[learnt["memory_"]["params"]["features"]["array"]][3] = np.nan

    path = changed(tmp_path, 1, spoil)
    with pytest.raises(ModelFileError, match="features hold NaN"):
        ObjectRecogniser.load(path)


def test_the_checksum_is_compared(tmp_path):
    path = models()[0].save(tmp_path / "a.palpate")
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match="checksum does not match"):
        ObjectRecogniser.load(path)


def test_a_document_of_millions_of_values_is_refused(tmp_path):
    text = json.dumps({"format": 4, "model": {"list": [[]] * 3_000_000}})
    path = forged(tmp_path / "a.palpate", text, {})
    assert "values are too many" in check_bounded(path)


def test_a_larger_file_than_asked_for_is_refused_unread(tmp_path, monkeypatch):
    path = models()[0].save(tmp_path / "a.palpate")
    monkeypatch.setenv("PALPATE_MAX_MODEL_MB", "0.001")
    with pytest.raises(ModelFileError, match="--max-model-mb"):
        ObjectRecogniser.load(path)


def test_what_could_not_be_read_is_not_written(tmp_path):
    model = ObjectRecogniser().fit(
        np.random.default_rng(0).random((8, 3, 6)), ["a"] * 4 + ["b" * 2000] * 4
    )
    with pytest.raises(ModelFileError, match="could not be read again"):
        model.save(tmp_path / "a.palpate")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["offset_", "weighing_", "drift_", "still_", "broken_", "look_offset_"]
)
def test_what_is_added_to_a_touch_must_be_as_large_as_it(tmp_path, name):
    # Else a small column would be spread over all features, a thousand times over.
    model = deepcopy(models()[0])
    setattr(model.encoder_, name, np.zeros((1000, 1)))
    with pytest.raises(ModelFileError, match=f"its {name} has shape"):
        ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))


@pytest.mark.parametrize("number", range(6))
def test_a_sound_model_is_read_and_answers_as_before(tmp_path, number):
    model = models()[number]
    images = np.random.default_rng(1).random((3, *model.encoder_.image_shape_))
    touches = Touches(images, channels=list("rgb") if images.ndim == 4 else None)
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    assert_array_equal(again.log_likelihood(touches), model.log_likelihood(touches))


def with_nan(values):
    return np.where(np.arange(values.size).reshape(values.shape) == 0, np.nan, values)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", lambda v: v[:0], "no such table"),
        ("weights", lambda v: v[None], "no such table"),
        ("weights", lambda v: 1.01 + 0 * v, "not between 0 and 1"),
        ("usual", lambda v: v[:1], "no such table"),
        ("usual", with_nan, "NaN or infinity"),
        ("far", lambda v: np.c_[v, v], "no such table"),
        ("far", lambda v: 0 * v, "no spread"),
        ("quantiles", lambda v: v[:, 1:], "no such table"),
        ("quantiles", lambda v: v - 2, "not between 0 and 1"),
        ("naming", lambda v: v[1:], "no such table"),
        ("refusing", with_nan, "NaN or infinity"),
        ("wrong", lambda v: v + 2, "not between 0 and 1"),
        ("n_units", lambda v: 0, "n_units must be at least 1"),
        ("population", lambda v: 5, "no text"),
    ],
)
def test_limits_that_decide_nothing_are_refused(tmp_path, name, change, message):
    model = deepcopy(models()[0])
    changed = change(getattr(model.limits_, name))
    model.limits_ = replace(model.limits_, **{name: changed})
    with pytest.raises(ModelFileError, match=message):
        ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))


@pytest.mark.parametrize(
    ("part", "name", "values", "message"),
    [
        ("", "floor_", (0.0, 0.5), "floor_"),
        ("encoder_", "gain_", (1e-6, 1e6), "gain_"),
        ("sequence_calibration_", "strength", (0.0, 100.0), "strength"),
        ("sequence_calibration_", "correlation", (0.0, 1.0), "correlation"),
    ],
)
def test_numbers_are_read_up_to_their_bounds(tmp_path, part, name, values, message):
    for value, step in zip(values, (-1e-3, 1e-3), strict=True):
        for beyond in (False, True):
            model = deepcopy(models()[0])
            holder = getattr(model, part) if part else model
            number = value * (1 + 2 * np.sign(step) * 0.1) + step if beyond else value
            if part == "sequence_calibration_":
                model.sequence_calibration_ = replace(holder, **{name: number})
            else:
                setattr(holder, name, number)
            if beyond:
                with pytest.raises(ModelFileError, match=message):
                    ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
            else:
                ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("looks", lambda looks: looks[:, :-1], "its looks have"),
        ("looks", lambda looks: looks[:-1], "sizes do not agree"),
    ],
)
def test_a_memory_that_does_not_fit_is_refused(tmp_path, name, change, message):
    model = deepcopy(models()[0])
    changed = change(getattr(model.memory_, name))
    model.memory_ = replace(model.memory_, **{name: changed})
    with pytest.raises(ModelFileError, match=message):
        ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))


def test_a_pose_of_another_kind_is_refused(tmp_path):
    model = deepcopy(models()[0])
    model.pose_ = model.memory_
    with pytest.raises(ModelFileError, match="pose_ is a Memory"):
        ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))


def with_texts(first, others):
    def change(learnt, tensors):
        for holder in every(learnt, "text"):
            if len(holder["text"]) > 2:
                holder["text"] = [first, *others]
                holder["shape"] = [1 + len(others)]

    return change


@pytest.mark.parametrize(
    ("n_letters", "n_others", "told"),
    [
        (50_000, 20_000, True),
        (1000, 15, False),
        (1001, 15, True),
        (900, 20_000, True),
        (40, 20_000, False),
    ],
)
def test_texts_of_a_model_are_bounded(tmp_path, n_letters, n_others, told):
    """To 1,000 letters; in an array each letter of the longest takes four bytes."""
    path = changed(tmp_path, 0, with_texts("x" * n_letters, ["y"] * n_others))
    refusal = f"{n_others + 1} texts of up to {n_letters} letters"
    assert (refusal in (check_bounded(path) or "")) == told
