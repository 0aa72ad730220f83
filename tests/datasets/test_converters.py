"""Each converter makes the archive at hand, array for array.

The sources' own files are not at hand, but for 772 pictures of BathTip: of the others
the archive's touches are written back in the source's layout, without loss.
"""

import hashlib
import io
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.io import savemat

from palpate import Touches
from palpate.datasets import card, fetch, where

from .conftest import png, zipped

pytestmark = pytest.mark.realdata


def fetched(name):
    """Return the path of a set, and the warnings but for that of the first hash."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        path = fetch(name)
    said = [str(one.message) for one in told]
    assert "was trusted" in said[0]
    return path, said[1:]


def behind_the_figures(data_folder, name):
    with np.load(data_folder / card(name)["makes"][0]) as archive:
        return dict(archive)


def pins_back(arrays):
    shots = zip(arrays["object"], arrays["frame"], arrays["images"], strict=True)
    root = "dataset-image/Dataset-shapes"
    return zipped({f"{root}/{o}/_{n}.png": png(levels) for o, n, levels in shots})


def digit_back(arrays):
    whose = zip(arrays["object"], arrays["part"], arrays["order"], strict=True)
    names = [f"data/{o}_{part}/interaction_{n:04d}.jpg" for o, part, n in whose]
    large = arrays["images"][..., ::-1].repeat(2, axis=1).repeat(2, axis=2)
    return zipped({n: png(one) for n, one in zip(names, large, strict=True)})


def films_back(arrays):
    files = {}
    index = arrays["frame_index"] - 1  # as MATLAB counts
    for name in np.unique(arrays["object"]):
        rows = arrays["object"] == name
        film = np.zeros((100, 900, rows.sum()))
        film[:, index] = arrays["frames"][rows].reshape(rows.sum(), 30, 100).T
        film[:, 599] = arrays["images"][rows].reshape(-1, 100).T
        buffer = io.BytesIO()
        savemat(buffer, {"C": film, "other": 1.0}, do_compression=True)
        place = f"Data_Analysis/Measurements_Collected/{name}/{name}_raster.mat"
        files[place] = buffer.getvalue()
    return zipped(files)


def text_of(levels, gap):
    return "\n".join(gap.join(map(str, row)) for row in levels).encode()


def mattress_back(arrays):
    columns = ("subject", "session", "object", "images")
    files = {}
    for who, mat, what, levels in zip(*(arrays[c] for c in columns), strict=True):
        name = mat.capitalize()
        place = f"experiment-ii/{who}/{name}_Mat/Matrix_{name}_{what}.txt"
        files[place] = text_of(levels, " ")
    return files


def postures_back(arrays):
    files = {}
    columns = ("subject", "object", "images")
    for who, what, levels in zip(*(arrays[c] for c in columns), strict=True):
        frames = np.stack(
            [0 * levels, 0 * levels + 1, levels, levels // 2, levels // 3]
        )
        film = b"Frame by frame\n" + text_of(frames.reshape(5, -1), "\t")
        files[f"experiment-i/{who}/{int(what[1:])}.txt"] = film
    return files


@pytest.mark.parametrize(
    ("name", "back"),
    [
        ("taxel10x10", films_back),
        ("tactip4", pins_back),
        ("digit_survey", digit_back),
    ],
)
@pytest.mark.slow
def test_a_zip_becomes_the_archive_at_hand(name, back, sources, data_folder):
    arrays = behind_the_figures(data_folder, name)
    sources.put(name, back(arrays))
    path, said = fetched(name)
    assert said == []  # no array differs from the card's
    same_as(path, arrays)


@pytest.mark.parametrize(
    ("name", "back"),
    [("mattress", mattress_back), ("postures", postures_back)],
)
@pytest.mark.slow
def test_a_list_of_files_becomes_the_archive_at_hand(name, back, sources, data_folder):
    arrays = behind_the_figures(data_folder, name)
    files = {**back(arrays), "experiment-ii/S8/Air_Mat/Matrix_Air_B1.txt": b"no"}
    sums = {p: hashlib.sha256(content).hexdigest() for p, content in files.items()}
    listed = "".join(f"{digest} {p}\n" for p, digest in sums.items())
    sources.put(name, f"{listed}{'0' * 64} LICENSE.txt\n".encode())
    for place, content in files.items():
        sources.put(name, content, f"files/pmd/1.0.0/{place}")
    path, said = fetched(name)
    assert said == []
    same_as(path, arrays)
    assert not [one for one in sources.asked if "ii/S8" in one or "LICENSE" in one]


def same_as(path, arrays):
    """Fail where an array has another name, type or value, or another place."""
    with np.load(path) as made:
        assert list(made) == list(arrays)
        for key, wanted in arrays.items():
            assert made[key].dtype == wanted.dtype, key
            assert_array_equal(made[key], wanted, err_msg=key)


@pytest.mark.slow
def test_pictures_become_their_rows_to_the_bit(sources, data_folder):
    """772 pictures as the camera wrote them; they come back beside the archive too."""
    originals = data_folder / "bathtip" / "originals"
    pictures = {p.relative_to(originals): p for p in originals.rglob("*.jpg")}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, place in pictures.items():
            archive.write(place, f"repository/code/data/touch/{name}")
    sources.put("bathtip", buffer.getvalue())
    path, said = fetched("bathtip")
    assert "not the arrays behind the figures" in said[0]  # 40 objects are missing
    arrays = behind_the_figures(data_folder, "bathtip")
    rows = np.isin(arrays["source_path"], [p.as_posix() for p in pictures])
    assert rows.sum() == 772
    with np.load(path) as made:
        for key in ("images", "object", "category", "order", "position_raw"):
            assert_array_equal(made[key], arrays[key][rows], err_msg=key)
        assert_array_equal(made["no_contact"], arrays["no_contact"])
    again = where() / "bathtip" / "originals"
    assert {p.relative_to(again) for p in again.rglob("*.jpg")} == set(pictures)
    for name, place in pictures.items():
        assert (again / name).read_bytes() == place.read_bytes()


@pytest.mark.slow
def test_all_pictures_become_the_archive(sources, data_folder):
    """Pictures of which each 4 x 4 block has the level of the archive's pixel."""
    arrays = behind_the_figures(data_folder, "bathtip")

    def large(levels):
        picture = np.zeros((480, 640), np.uint8)
        picture[:, :480] = levels.repeat(4, axis=0).repeat(4, axis=1)
        return png(picture)

    shots = zip(arrays["source_path"], arrays["images"], strict=True)
    files = {str(name): large(levels) for name, levels in shots}
    one = min(files)
    files[one.replace("img_", "img_600")] = files[one]  # kept apart: not in the archive
    files["baselineForCalibration.jpg"] = large(arrays["no_contact"])
    sources.put("bathtip", zipped(files))
    path, said = fetched("bathtip")
    assert said == []
    touches = Touches.load(path)
    assert_array_equal(touches.images, arrays["images"])
    assert touches.columns["source_path"].tolist() == arrays["source_path"].tolist()
    assert len(list(Path(path.parent / "originals").rglob("touch*.jpg"))) == 772
