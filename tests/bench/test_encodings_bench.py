"""The benchmark of encodings: which rows there are, and that shares are shares."""

import pytest

from palpate.bench import BENCHES, run_bench


def test_stages_and_encodings_have_rows(monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    rows = run_bench("encodings", seconds=1e-3, names=["hu", "scaled-pixels"])
    assert [row["name"] for row in rows] == [
        "640 x 480 drawn decoding",
        "640 x 480 drawn rim finding",
        "640 x 480 drawn cropping",
        "640 x 480 drawn standardising",
        "640 x 480 drawn disc of a picture hu",
        "640 x 480 drawn encoding hu",
        "640 x 480 drawn encoding scaled-pixels",
    ]
    for row in rows[5:]:
        shares = [row[f"share_{part}"] for part in ("decode", "rim", "crop", "encode")]
        # Per cent of one sum.
        assert sum(shares) == pytest.approx(100)
        crop = rows[2]["ours_ms"] + rows[3]["ours_ms"]
        assert row["touch_ms"] == pytest.approx(crop + row["ours_ms"])
    assert rows[4]["peer"] == rows[5]["peer"] == "OpenCV"
    assert rows[5]["ratio"] == pytest.approx(rows[5]["peer_ms"] / rows[5]["ours_ms"])
    assert (rows[6]["ratio"], rows[6]["reason"]) == (None, "no package has it")


def test_a_folder_without_pictures_is_refused(tmp_path):
    with pytest.raises(ValueError, match="32 pictures in bathtip/originals, got 0"):
        run_bench("encodings", data=tmp_path)


def test_it_is_listed():
    assert BENCHES["encodings"][0] == "_encodings"
