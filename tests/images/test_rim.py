"""Finding the rim: drawn domes of known place, symmetries, images without a rim."""

import re
from threading import Thread

import cv2
import numpy as np
import pytest

from palpate.images import find_rims, typical_rim

BLANK = find_rims(np.zeros((1, 9, 9)))
Rims, Circle = type(BLANK), type(BLANK[0])


def draw(shape, row, col, radius, *, inside=110.0, outside=250.0, lit=30.0):
    """A dome lit from one side; a pixel on the rim mixes both by its distance."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    distance = np.hypot(y - row, x - col)
    share = np.clip(radius - distance + 0.5, 0, 1)
    dome = inside + lit * (y - row) / radius - 15 * (x - col) / radius
    return np.rint(share * dome + (1 - share) * outside).astype(np.uint8)


def press(image, row, col, size, amount):
    """Add a soft round contact."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    bump = amount * np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * size**2))
    return np.clip(image + bump, 0, 255).astype(np.uint8)


def shift(image, down, right):
    """Move by whole pixels; the edges are repeated."""
    rows = np.clip(np.arange(image.shape[0]) - down, 0, image.shape[0] - 1)
    cols = np.clip(np.arange(image.shape[1]) - right, 0, image.shape[1] - 1)
    return image[rows[:, np.newaxis], cols]


def find_rim(image, near=None):
    return find_rims(np.asarray(image)[np.newaxis], near=near)[0]


def off_by(rim, row, col):
    return np.hypot(rim.row - row, rim.col - col)


PLACES = {
    "whole": ((120, 160), 58.3, 81.7, 44.2),
    "cut on one side": ((120, 160), 47.6, 90.1, 56.5),
    "cut on two sides": ((120, 160), 52.2, 40.8, 60.3),
    "cut on three sides": ((120, 160), 57.4, 50.9, 68.1),
    "small in a large frame": ((480, 640), 201.3, 377.9, 130.4),
    "as the real ones": ((480, 640), 214.4, 218.3, 265.7),
    "cut by a square frame": ((120, 120), 53.3, 54.3, 66.3),
    "portrait": ((300, 200), 166.6, 98.2, 85.5),
}


@pytest.mark.parametrize("outside", [250.0, 5.0], ids=["bright", "dark"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_drawn_circle_is_found(place, outside):
    shape, row, col, radius = place
    rim = find_rim(draw(shape, row, col, radius, outside=outside))
    assert rim.visible
    # Sampling and rounding to grey levels leave some hundredths of a pixel.
    assert off_by(rim, row, col) < 0.1
    assert abs(rim.radius - radius) < 0.1


@pytest.mark.parametrize("sigma", [0.6, 1.5])
def test_blur_and_noise_cost_little(rng, sigma):
    image = cv2.GaussianBlur(draw((240, 320), 118.7, 130.2, 125.4), (0, 0), sigma)
    noisy = np.clip(image + rng.normal(scale=6, size=image.shape), 0, 255)
    rim = find_rim(noisy.astype(np.uint8))
    # About a hundred rays, each good to some tenths of a pixel.
    assert off_by(rim, 118.7, 130.2) < 0.2


def test_contacts_and_highlights_on_the_rim_count_little():
    clean = draw((240, 320), 118.7, 130.2, 125.4)
    image = press(press(clean, 40, 210, 18, 140), 190, 60, 25, 120)
    image = press(image, 118, 255, 3, 200)
    # A fifth of the rim vanishes in the bright surround.
    assert off_by(find_rim(image), 118.7, 130.2) < 0.3


def test_sharp_round_contact_is_not_taken_for_the_rim():
    image = draw((240, 320), 118.7, 130.2, 125.4)
    cv2.circle(image, (120, 100), 62, 230, -1, cv2.LINE_AA)
    assert off_by(find_rim(image), 118.7, 130.2) < 0.2


@pytest.mark.parametrize("down", [-10, -3, 0, 10])
@pytest.mark.parametrize("right", [-10, 0, 7, 10])
@pytest.mark.parametrize("with_near", [True, False])
def test_shifted_image_gives_shifted_rim(down, right, with_near):
    image = press(draw((240, 320), 107.2, 109.1, 132.8), 90, 100, 30, 90)
    near = find_rim(image) if with_near else None
    rim = find_rim(shift(image, down, right), near=near)
    # The repeated edges bend the rim by up to ten pixels where the frame cuts it.
    assert off_by(rim, 107.2 + down, 109.1 + right) < 0.4


@pytest.mark.parametrize("gamma", [1 / 1.3, 1.3])
def test_exposure_moves_the_rim_little(gamma):
    image = draw((240, 320), 107.2, 109.1, 132.8)
    exposed = (255 * (image / 255) ** gamma).astype(np.uint8)
    # On a blurred rim gamma moves the steepest place, but on all sides alike.
    assert off_by(find_rim(exposed), 107.2, 109.1) < 0.1


@pytest.mark.parametrize(
    ("dtype", "gain", "offset"),
    [(d, 7, 1000) for d in (np.uint16, np.int32, np.float32, np.float64)]
    + [pytest.param(np.uint8, -1, 255, id="negative")],
)
def test_unit_of_grey_levels_does_not_matter(dtype, gain, offset):
    image = draw((120, 160), 52.2, 40.8, 60.3)
    scaled = (image.astype(np.float64) * gain + offset).astype(dtype)
    wanted, rim = find_rim(image), find_rim(scaled)
    # 8-bit images are interpolated in steps of one grey level, others exactly.
    assert off_by(rim, wanted.row, wanted.col) < 0.02


@pytest.mark.parametrize("name", ["flipped", "turned"])
def test_rim_follows_the_images_symmetries(name):
    image = press(draw((120, 160), 52.2, 40.8, 60.3), 50, 50, 15, 80)
    wanted = find_rim(image)
    if name == "flipped":
        rim, place = find_rim(image[::-1]), (119 - wanted.row, wanted.col)
    else:
        rim, place = find_rim(np.rot90(image)), (159 - wanted.col, wanted.row)
    # The rays and the first guess fall elsewhere; the edges do not.
    assert off_by(rim, *place) < 0.05


def test_near_holds_the_radius_but_not_the_centre():
    image = draw((120, 160), 57.4, 50.9, 68.1)
    near = Circle(57.4 - 12, 50.9 + 14, 68.1)
    rim = find_rim(image, near=near)
    assert off_by(rim, 57.4, 50.9) < 0.1
    held = find_rim(image, near=Circle(57.4, 50.9, 68.6))
    free = find_rim(image)
    assert abs(held.radius - 68.6) < abs(free.radius - 68.6)


def without_rim():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:120, :160]
    soft = np.exp(-((y - 60) ** 2 + (x - 80) ** 2) / (2 * 30**2))
    square = np.full((120, 160), 40, np.uint8)
    square[20:100, 40:120] = 200
    dots = np.zeros((120, 160), np.uint8)
    for row, col in rng.integers(10, 110, size=(60, 2)):
        cv2.circle(dots, (int(col) + 20, int(row)), 3, 255, -1)
    smooth = cv2.GaussianBlur(rng.normal(size=(120, 160)), (0, 0), 8)
    ellipse = np.zeros((120, 160), np.uint8)
    cv2.ellipse(ellipse, (80, 60), (55, 33), 20, 0, 360, 200, -1)
    return {
        "noise": rng.integers(0, 256, (120, 160)).astype(np.uint8),
        "soft blob": soft * 200,
        "square": square,
        "dots": dots,
        "smooth": smooth,
        "islands": np.where(smooth > 0, 200, 30).astype(np.uint8),
        "ellipse": ellipse,
        "stripes": 127 + 100 * np.sin(x / 3.0 + y / 5.0),
        "gradient": x.astype(np.float64),
        "constant": np.full((120, 160), 7, np.uint8),
        "black": np.zeros((120, 160)),
        "small": draw((30, 30), 15, 15, 11),
        "array": rng.random((10, 10)),
        "one taxel": np.ones((1, 1)),
    }


@pytest.mark.parametrize("name", without_rim())
def test_image_without_a_rim_gets_the_inscribed_circle_as_not_visible(name):
    image = without_rim()[name]
    rows, cols = image.shape
    wanted = Circle((rows - 1) / 2, (cols - 1) / 2, min(rows, cols) / 2, False, 0.0)
    assert find_rim(image) == wanted
    near = Circle(50.0, 60.0, 48.0)
    assert find_rim(image, near=near) == Circle(50.0, 60.0, 48.0, False, 0.0)


@pytest.mark.parametrize(("col", "visible"), [(60, True), (66, False)])
def test_a_fifth_of_the_circle_must_be_seen(col, visible):
    # 22 % of the circle is in the frame, until the fourth side cuts it to 15 %.
    image = draw((120, 160), 59.5, col, 95, lit=0)
    assert find_rim(image).visible == visible


def test_noise_is_hardly_ever_a_rim(rng):
    scales = rng.uniform(0.5, 12, size=60)
    images = [cv2.GaussianBlur(rng.normal(size=(96, 128)), (0, 0), s) for s in scales]
    assert not any(find_rim(image).visible for image in images)


def touches_of_one_device(rng, n=9, radius=60.3):
    places = np.array([52.2, 50.8]) + rng.uniform(-4, 4, size=(n, 2))
    images = [draw((120, 160), *place, radius) for place in places]
    return np.stack(
        [press(im, *rng.uniform(30, 80, 2), 12, 90) for im in images]
    ), places


def test_a_batch_finds_each_touchs_own_centre_and_the_median_circle(rng):
    images, places = touches_of_one_device(rng)
    rims = find_rims(images)
    assert rims.visible.all()
    error = np.hypot(rims.row - places[:, 0], rims.col - places[:, 1])
    # The soft contacts cross the rim here and there.
    assert error.max() < 0.2
    typical = typical_rim(images)
    # Medians of centres that are each good to 0.2 pixels.
    assert off_by(typical, *np.median(places, axis=0)) < 0.2
    assert abs(typical.radius - 60.3) < 0.2
    # A touch alone is as among others.
    together = find_rims(images, near=typical)
    assert list(together) == [find_rim(image, near=typical) for image in images]
    # A frame of no contact without a rim is passed over.
    assert typical_rim(images, no_contact=np.zeros((120, 160))) == typical


def test_no_contact_frame_gives_the_radius(rng):
    images, _ = touches_of_one_device(rng)
    frame = draw((120, 160), 52.2, 50.8, 60.3)
    typical = typical_rim(images, no_contact=frame)
    assert typical.radius == typical_rim(frame[np.newaxis]).radius
    rims, wanted = find_rims(images, no_contact=frame), find_rims(images)
    # Both priors are the same circle to a few hundredths, wherever the search begins.
    np.testing.assert_allclose(rims.row, wanted.row, atol=0.05)
    here = find_rims(images, near=find_rim(frame))
    np.testing.assert_allclose(rims.row, here.row, atol=0.05)
    # The search begins where touches show it.
    assert typical.row == pytest.approx(np.median(here.row), abs=0.05)


def test_round_things_of_many_sizes_are_no_rim_of_a_device(rng):
    radii = np.linspace(34, 56, 12)
    images = np.stack([draw((120, 160), 60, 80, r, outside=10) for r in radii])
    assert all(find_rim(image).visible for image in images)
    assert typical_rim(images) is None


def test_round_things_in_many_places_are_no_rim_of_a_device():
    places = [(45, 45), (45, 110), (75, 45), (75, 110), (60, 75)]
    images = np.stack([draw((120, 160), *p, 36, outside=10) for p in places])
    assert typical_rim(images) is None


def test_few_touches_with_a_rim_make_no_device(rng):
    images, _ = touches_of_one_device(rng, n=5)
    noise = rng.integers(0, 256, (6, 120, 160)).astype(np.uint8)
    assert typical_rim(np.concatenate([images, noise])) is None
    assert typical_rim(np.concatenate([images, noise[:5]])) is not None


def test_rims_are_indexed_like_arrays():
    circles = [Circle(1.0, 2.0, 3.0), Circle(4.0, 5.0, 6.0, False, 0.0)]
    rims = Rims.of(circles)
    assert len(rims) == 2
    assert list(rims) == circles
    assert rims[-1] == circles[1]
    np.testing.assert_array_equal(rims[rims.visible].row, [1.0])
    np.testing.assert_array_equal(rims[::-1].radius, [6.0, 3.0])
    with pytest.raises(IndexError):
        rims[2]


SPOILT = np.full((3, 50, 50), [[[1.0]], [[np.nan]], [[1.0]]])


@pytest.mark.parametrize(
    ("images", "near", "kind", "message"),
    [
        (np.ones((50, 50)), None, ValueError, "X[np.newaxis]"),
        (np.ones((50, 50), np.uint8), None, ValueError, "X[np.newaxis]"),
        (np.full((1, 9, 9), "a"), None, TypeError, "must be numbers"),
        (np.ones((0, 50, 50), np.uint8), None, ValueError, "at least one"),
        (SPOILT, None, ValueError, "in touch 1"),
        (np.ones((1, 50, 50)), Circle(1, 1, 0), ValueError, "near.radius must be pos"),
    ],
)
def test_wrong_arguments_are_refused(images, near, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        find_rims(images, near=near)


def running_median(values, n=11):
    """Median over `n` neighbours in order; at the ends over the nearest `n`."""
    starts = np.clip(np.arange(len(values)) - n // 2, 0, max(len(values) - n, 0))
    return np.stack([np.median(values[s : s + n], axis=0) for s in starts])


def steady_share(rims, objects):
    centre = np.stack([rims.row, rims.col], axis=1)
    away = np.empty_like(centre)
    for name in np.unique(objects):
        of_object = objects == name
        away[of_object] = centre[of_object] - running_median(centre[of_object])
    return np.mean(np.hypot(*away.T) < 1)


def originals(data_folder):
    paths = (data_folder / "bathtip/originals").glob("*/*/*.jpg")
    numbered = []
    for path in paths:
        number, name = re.search(r"_img_(\d+)_name_(.+)_at_", path.name).groups()
        numbered.append((name, int(number), path))
    return sorted(numbered)


def read(path):
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


@pytest.mark.realdata
@pytest.mark.slow
def test_original_centres_keep_to_their_running_median(data_folder):
    touches = originals(data_folder)  # of every other object
    names = sorted({name for name, _, _ in touches})[::2]
    touches = [touch for touch in touches if touch[0] in names]
    near = find_rim(read(data_folder / "bathtip/originals/baselineForCalibration.jpg"))
    rims = Rims.of(find_rim(read(path), near=near) for _, _, path in touches)
    assert rims.visible.all()
    assert steady_share(rims, np.array([name for name, _, _ in touches])) >= 0.95


@pytest.mark.realdata
@pytest.mark.parametrize("with_near", [True, False])
def test_shifts_and_exposure_of_real_touches_are_recovered(data_folder, rng, with_near):
    base = find_rim(read(data_folder / "bathtip/originals/baselineForCalibration.jpg"))
    near = base if with_near else None
    for _, _, path in originals(data_folder)[::19]:
        image = read(path)
        before, (down, right) = find_rim(image, near=near), rng.integers(-10, 11, 2)
        levels = 255 * (image / 255) ** 1.3 ** rng.uniform(-1, 1)
        after = find_rim(shift(levels.astype(np.uint8), down, right), near=near)
        assert off_by(after, before.row + down, before.col + right) < 1


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["tactip4/tactip4.npz", "taxel10x10/taxel10x10.npz"])
def test_sensors_without_a_rim_show_none(data_folder, name):
    with np.load(data_folder / name) as archive:
        images = archive["images"][::16]
    assert not find_rims(images).visible.any()


def test_rims_are_found_on_one_thread_and_opencv_gets_its_own_back(monkeypatch):
    before, thread_counts, remap = cv2.getNumThreads(), [], cv2.remap

    def noted(*arguments, **named):
        thread_counts.append(cv2.getNumThreads())
        return remap(*arguments, **named)

    monkeypatch.setattr(cv2, "remap", noted)
    cv2.setNumThreads(2)
    try:
        images = np.stack([draw((90, 120), 45, 60, 30)] * 8)
        threads = [Thread(target=find_rims, args=(images,)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        with pytest.raises(ValueError, match=r"near\.radius must be positive"):
            find_rims(images, near=Circle(45, 60, -1))
        assert set(thread_counts) == {1}
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
