"""Models that somebody forged are refused quickly, or answer like any other."""

import json
import time
import tracemalloc
from copy import deepcopy

import numpy as np
import pytest
from forged_models import forged, models, mutated, opened

from palpate import ObjectRecogniser
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


def with_long_label(learnt, tensors):
    for holder in every(learnt, "text"):
        if len(holder["text"]) > 2:
            holder["text"] = ["x" * 50_000] + ["y"] * 20_000
            holder["shape"] = [20_001]


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
        (0, with_long_label, "20001 texts of up to 50000 letters"),
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
