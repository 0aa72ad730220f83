"""Each converter makes the archive at hand, array for array.

Of the sources' own files only 772 pictures of BathTip are at hand. For the other sets
the archive's touches are written back in the source's layout, without loss.
"""

import hashlib
import io
import warnings
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
    """Return the path of a set, and the warnings after that of the first hash."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        path = fetch(name)
    messages = [str(warning.message) for warning in warned]
    assert "was trusted" in messages[0]
    return path, messages[1:]


def behind_the_figures(data_folder, name):
    with np.load(data_folder / card(name)["makes"][0]) as archive:
        return dict(archive)


def pins_back(arrays):
    shots = zip(arrays["object"], arrays["frame"], arrays["images"], strict=True)
    root = "dataset-image/Dataset-shapes"
    return zipped({f"{root}/{o}/_{n}.png": png(levels) for o, n, levels in shots})


def digit_back(arrays):
    labels = zip(arrays["object"], arrays["part"], arrays["order"], strict=True)
    names = [f"data/{o}_{part}/interaction_{n:04d}.jpg" for o, part, n in labels]
    large = arrays["images"][..., ::-1].repeat(2, axis=1).repeat(2, axis=2)
    return zipped({n: png(levels) for n, levels in zip(names, large, strict=True)})


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
    for subject, session, object, levels in zip(
        *(arrays[c] for c in columns), strict=True
    ):
        name = session.capitalize()
        place = f"experiment-ii/{subject}/{name}_Mat/Matrix_{name}_{object}.txt"
        files[place] = text_of(levels, " ")
    return files


def postures_back(arrays):
    files = {}
    columns = ("subject", "object", "images")
    for subject, object, levels in zip(*(arrays[c] for c in columns), strict=True):
        frames = np.stack(
            [0 * levels, 0 * levels + 1, levels, levels // 2, levels // 3]
        )
        film = b"Frame by frame\n" + text_of(frames.reshape(5, -1), "\t")
        files[f"experiment-i/{subject}/{int(object[1:])}.txt"] = film
    return files


@pytest.mark.parametrize(
    ("name", "back"),
    [("taxel10x10", films_back), ("tactip4", pins_back), ("digit_survey", digit_back)],
)
@pytest.mark.slow
def test_a_zip_becomes_the_archive_at_hand(name, back, sources, data_folder):
    arrays = behind_the_figures(data_folder, name)
    sources.put(name, back(arrays))
    path, messages = fetched(name)
    assert messages == []  # no array differs from the card's
    assert_same_archive(path, arrays)


@pytest.mark.parametrize(
    ("name", "back"), [("mattress", mattress_back), ("postures", postures_back)]
)
@pytest.mark.slow
def test_a_list_of_files_becomes_the_archive_at_hand(name, back, sources, data_folder):
    arrays = behind_the_figures(data_folder, name)
    files = {**back(arrays), "experiment-ii/S8/Air_Mat/Matrix_Air_B1.txt": b"no"}
    sums = {
        place: hashlib.sha256(content).hexdigest() for place, content in files.items()
    }
    listed = "".join(f"{digest} {place}\n" for place, digest in sums.items())
    sources.put(name, f"{listed}{'0' * 64} LICENSE.txt\n".encode())
    for place, content in files.items():
        sources.put(name, content, f"files/pmd/1.0.0/{place}")
    path, messages = fetched(name)
    assert messages == []
    assert_same_archive(path, arrays)
    assert not [
        path for path in sources.requests if "ii/S8" in path or "LICENSE" in path
    ]


def assert_same_archive(path, arrays):
    """Fail where an array has another name, type, value or position."""
    with np.load(path) as archive:
        assert list(archive) == list(arrays)
        for key, expected in arrays.items():
            assert archive[key].dtype == expected.dtype, key
            assert_array_equal(archive[key], expected, err_msg=key)


@pytest.mark.slow
def test_pictures_become_their_rows_to_the_bit(sources, data_folder):
    """772 pictures of the camera become rows, and lie beside the archive too."""
    originals = data_folder / "bathtip" / "originals"
    pictures = {p.relative_to(originals): p for p in originals.rglob("*.jpg")}
    files = {f"code/data/touch/{n}": p.read_bytes() for n, p in pictures.items()}
    sources.put("bathtip", zipped(files))
    path, messages = fetched("bathtip")
    assert "not the arrays behind the figures" in messages[0]  # 40 objects are missing
    arrays = behind_the_figures(data_folder, "bathtip")
    rows = np.isin(arrays["source_path"], [p.as_posix() for p in pictures])
    assert rows.sum() == 772
    with np.load(path) as converted:
        for key in ("images", "object", "category", "order", "position_raw"):
            assert_array_equal(converted[key], arrays[key][rows], err_msg=key)
        assert_array_equal(converted["no_contact"], arrays["no_contact"])
    again = where() / "bathtip" / "originals"
    assert {p.relative_to(again) for p in again.rglob("*.jpg")} == set(pictures)
    for name, place in pictures.items():
        assert (again / name).read_bytes() == place.read_bytes()


@pytest.mark.slow
def test_all_pictures_become_the_archive(sources, data_folder):
    """Each 4 x 4 block of a picture has the level of a pixel of the archive."""
    arrays = behind_the_figures(data_folder, "bathtip")

    def large(levels):
        picture = np.zeros((480, 640), np.uint8)
        picture[:, :480] = levels.repeat(4, axis=0).repeat(4, axis=1)
        return png(picture)

    shots = zip(arrays["source_path"], arrays["images"], strict=True)
    files = {str(name): large(levels) for name, levels in shots}
    first = min(files)
    added = first.replace("img_", "img_600")  # a touch that the archive leaves out
    files[added] = files[first]
    files["baselineForCalibration.jpg"] = large(arrays["no_contact"])
    sources.put("bathtip", zipped(files))
    path, messages = fetched("bathtip")
    assert messages == []
    touches = Touches.load(path)
    assert_array_equal(touches.images, arrays["images"])
    assert touches.columns["source_path"].tolist() == arrays["source_path"].tolist()
    assert len(list(Path(path.parent / "originals").rglob("touch*.jpg"))) == 772
