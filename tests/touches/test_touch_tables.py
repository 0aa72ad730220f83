"""CSV files, arrays of numpy and data frames are touches; what is wrong is named."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.touches import TouchesError

HEADED = """object,force_n,x_mm,y_mm,z_mm,a,b,c,d
cup,0.5,1,2,3,0,1,2,3
cup,0.6,1,2,4,4,5,,7
pen,0.7,1,2,5,8,9,10,1e1
"""


@pytest.fixture
def csv(tmp_path):
    def write(text, name="touches.csv"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_each_line_is_a_touch(csv):
    touches = Touches.load(csv(HEADED), shape=(2, 2))
    assert touches.object.tolist() == ["cup", "cup", "pen"]
    assert touches.columns["force_n"].tolist() == [0.5, 0.6, 0.7]
    assert_array_equal(touches.columns["position_mm"][:, 2], [3, 4, 5])
    assert_array_equal(touches.images[0], [[0, 1], [2, 3]])
    assert_array_equal(touches.images[1], [[4, 5], [np.nan, 7]])  # a dead taxel
    assert touches.geometry is None


def test_without_a_shape_places_mean_nothing(csv):
    touches = Touches.load(csv("1;2;3\n4;5;6\n"))
    assert_array_equal(touches.images, [[[1, 2, 3]], [[4, 5, 6]]])
    assert touches.geometry == "none"
    assert touches.object is None


@pytest.mark.parametrize("ending", ["csv", "npy"])
def test_of_a_folder_each_file_is_a_touch(tmp_path, ending, rng):
    images = rng.normal(size=(4, 3, 2))
    for n, image in enumerate(images):
        path = tmp_path / "in" / ["cup", "pen"][n // 2] / f"{n}.{ending}"
        path.parent.mkdir(parents=True, exist_ok=True)
        if ending == "csv":
            np.savetxt(path, image, delimiter=",", fmt="%.17g")
        else:
            np.save(path, image)
    touches = Touches.load(tmp_path / "in")
    assert_array_equal(touches.images, images)
    assert touches.object.tolist() == ["cup", "cup", "pen", "pen"]
    np.save(tmp_path / "in/pen/9.npy", np.zeros((3, 3)))
    with pytest.raises(TouchesError, match=r"9.npy must be \(3, 2\) float64 like"):
        Touches.load(tmp_path / "in")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold lines of numbers, got none"),
        ("a,b\n", "a line for each touch, got names alone"),
        ("1,2\n3\n", "line 2 must have 2 cells like the first, got 1"),
        ("1,2\n3,x\n", "taxel 1, number 2 must be a number as others are, got 'x'"),
        ("a,b\n1,2\n3,oops\n", "b, number 3 must be a number as others are"),
        ("1,2\n3,inf\n", "must be a number .*got 'inf'"),
        ("a,a\n1,2\n", "must be there and differ, got a, a"),
        ("object,session\ncup,a\n", "must have columns of taxels, got object"),
        ('"1,2\n3,4\n', "must be a CSV file of numbers in UTF-8"),
    ],
)
def test_what_is_no_table_of_touches_is_refused(csv, text, message):
    with pytest.raises(TouchesError, match=message):
        Touches.load(csv(text))


def test_bytes_that_are_no_text_and_wrong_options_are_refused(csv, tmp_path):
    (tmp_path / "b.csv").write_bytes(b"1,2\n\xff\xfe\n")
    with pytest.raises(TouchesError, match="in UTF-8, got"):
        Touches.load(tmp_path / "b.csv")
    with pytest.raises(TouchesError, match="as many taxels as the table, 4, got 2 x 3"):
        Touches.load(csv(HEADED), shape=(2, 3))
    with pytest.raises(TouchesError, match=r"a file of \d+ bytes"):
        Touches.load(csv(HEADED), max_bytes=100)
    with pytest.raises(TouchesError, match="line 2, number 1 must be a number"):
        Touches.load(csv("1,2\nx,3\n", "in/cup/1.csv").parents[1])


def test_arrays_of_numpy_are_touches(tmp_path, rng):
    images = rng.normal(size=(4, 3, 2))
    np.save(tmp_path / "many.npy", images)
    np.save(tmp_path / "one.npy", images[0])
    assert_array_equal(Touches.load(tmp_path / "many.npy").images, images)
    assert_array_equal(Touches.load(tmp_path / "one.npy").images, images[:1])
    np.savez(tmp_path / "plain.npz", X=images, y=[1, 1, 2, 2])
    touches = Touches.load(tmp_path / "plain.npz")
    assert_array_equal(touches.images, images)
    assert touches.object.tolist() == ["1", "1", "2", "2"]
    np.savez(tmp_path / "two.npz", X=images, Z=images)
    with pytest.raises(TouchesError, match=r"named images .* it holds X .*, Z"):
        Touches.load(tmp_path / "two.npz")
    np.save(tmp_path / "odd.npy", np.array([{}, None]), allow_pickle=True)
    with pytest.raises(TouchesError, match=r"an array that numpy\.save wrote"):
        Touches.load(tmp_path / "odd.npy")
    content = (tmp_path / "many.npy").read_bytes()
    (tmp_path / "cut.npy").write_bytes(content[:-8])
    with pytest.raises(TouchesError, match=r"an array that numpy\.save wrote"):
        Touches.load(tmp_path / "cut.npy")
    with pytest.raises(TouchesError, match="more than 100 bytes"):
        Touches.load(tmp_path / "many.npy", max_bytes=100)


def test_a_picture_is_one_touch(tmp_path, rng):
    deep = rng.integers(0, 2**16, (5, 4), dtype=np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    assert_array_equal(Touches.load(tmp_path / "deep.png").images, deep[None])
    rgb = rng.integers(0, 256, (5, 4, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(tmp_path / "rgb.png")
    touches = Touches.load(tmp_path / "rgb.png", colour=True)
    assert_array_equal(touches.images, rgb[None])
    assert touches.channels == ("r", "g", "b")


def test_data_frames_go_both_ways(csv):
    pandas = pytest.importorskip("pandas")
    from_file = Touches.load(csv(HEADED), shape=(2, 2))
    frame = pandas.read_csv(csv(HEADED))
    touches = Touches.from_frame(frame, shape=(2, 2))
    assert_array_equal(touches.images, from_file.images)
    assert touches.object.tolist() == from_file.object.tolist()
    columns = touches.to_frame()
    assert columns["object"].tolist() == ["cup", "cup", "pen"]
    assert columns["position_mm_2"].tolist() == [3, 4, 5]
    assert len(columns) == 3
    with pytest.raises(TouchesError, match="must have columns of taxels"):
        Touches.from_frame(frame[["object"]])
