"""Parts of the Corradi 2015 study against facts known without its code."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.evaluation import Plan
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, simulate_touches
from palpate.studies import STUDIES, corradi2015, run_study
from palpate.studies.corradi2015 import Corradi2015Plan, beside
from palpate.studies.corradi2015.beside import beside_tasks, moved_rows, sight_rows
from palpate.studies.corradi2015.episodes import (
    Answered,
    Partition,
    accuracy,
    category_folds,
    confusion,
    draw_orders,
    draw_partition,
    only_idle,
)
from palpate.studies.corradi2015.plan import (
    N_FREQUENCIES,
    N_RINGS,
    Encoded,
    Objects,
    encode,
    moment_normalised,
    polar_fourier,
)
from palpate.studies.corradi2015.recognisers import (
    BagOfTouches,
    ClusterBayes,
    Densities,
    Mixtures,
    Nuisance,
)

ROW, COL = np.mgrid[:61, :61] - 30.0


def blob(x, y, width, height, degrees):
    """A skewed smooth patch; its long tail points along `degrees`."""
    turn = np.deg2rad(degrees)
    u = np.cos(turn) * (COL - x) + np.sin(turn) * (ROW - y)
    v = -np.sin(turn) * (COL - x) + np.cos(turn) * (ROW - y)
    along = np.where(u > 0, u / (2 * width), u / width)
    return np.exp(-(along**2) - (v / height) ** 2).astype(np.float32)


def test_partitions_are_disjoint_and_of_the_sizes_asked_for():
    codes = np.repeat([0, 1, 2], [120, 80, 40])
    partition = draw_partition(codes, 60, 30, 45, (0, 1))
    assert_array_equal(np.bincount(codes[partition.train]), [60, 45, 10])
    assert partition.episodes.shape == (3, 30)
    assert not np.isin(partition.episodes, partition.train).any()
    for truth, rows in zip(partition.truth, partition.episodes, strict=True):
        assert (codes[rows] == truth).all()
        assert len(np.unique(rows)) == 30
    again = draw_partition(codes, 60, 30, 45, (0, 1))
    assert_array_equal(again.episodes, partition.episodes)


def test_orders_are_of_one_object_each():
    codes = np.repeat([0, 1], 6)
    episodes, which = draw_orders(codes, 4, 3, (0,))
    assert episodes.shape == (6, 4)
    assert (codes[episodes] == which[:, np.newaxis]).all()
    assert_array_equal(which, [0, 0, 0, 1, 1, 1])


def test_touches_without_contact_become_episodes_of_their_own():
    partition = Partition(np.arange(2), np.array([[2, 3], [4, 5]]), np.array([0, 1]))
    idle = np.array([True, False, False, True, True, True])
    alone = only_idle(partition, idle)
    assert_array_equal(alone.episodes, [[3], [4], [5]])
    assert_array_equal(alone.truth, [0, 1, 1])
    assert only_idle(partition, None) is None
    assert only_idle(partition, np.zeros(6, dtype=bool)) is None


def test_answers_become_shares():
    answers, truth = np.array([[0, 0], [0, 1]]), np.array([0, 1])
    answered = [Answered("ten objects", "drawn", "ours", answers, truth, {})]
    assert_allclose(accuracy(answered), [[0.5, 1.0]])
    assert_allclose(confusion(answered, 1, 2), [[1, 0], [1, 0]])


def test_polar_fourier_does_not_see_the_angle():
    image = blob(5, -4, 4, 3, 20)
    turned = np.stack([np.rot90(image, k) for k in range(4)])
    features = polar_fourier(np.ascontiguousarray(turned))
    # A quarter turn moves samples onto samples, but for single precision.
    assert_allclose(features, features[[0] * 4], atol=1e-5)


def test_rings_are_constant_where_the_image_is_round():
    round_image = np.exp(-(ROW**2 + COL**2) / 200).astype(np.float32)
    features = polar_fourier(round_image[np.newaxis]).reshape(N_RINGS, N_FREQUENCIES)
    assert (features[:, 0] > 0.01).all()
    # What linear interpolation adds to a bell of height 1 and width 14.
    assert_allclose(features[:, 1:], 0, atol=1e-3)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(blob(6, -5, 4, 3, 0), id="shifted"),
        pytest.param(blob(0, 0, 4, 3, 70), id="turned"),
        pytest.param(blob(0, 0, 4, 3, 180), id="turned over"),
        pytest.param(blob(0, 0, 6, 4.5, 0), id="larger"),
        pytest.param(3 * blob(0, 0, 4, 3, 0), id="stronger"),
    ],
)
def test_moment_normalised_patches_do_not_see_place_angle_size_and_strength(other):
    patches = moment_normalised(np.stack([blob(0, 0, 4, 3, 0), other]))
    assert_allclose(patches.sum(axis=1), 1)
    # Pixels 2 to 5 times smaller than the patch: a few per cent of the largest.
    assert_allclose(patches[1], patches[0], atol=0.06 * patches[0].max())


def test_a_patch_of_nothing_is_zero():
    assert_array_equal(moment_normalised(np.zeros((1, 9, 9), np.float32)), 0)


@pytest.fixture
def two_places():
    """Ten touches of each of two objects: nine at one place, one at the other's."""
    places = np.array([[0.0, 0.0], [10.0, 0.0]])
    which = np.r_[[0] * 9, 1, [1] * 9, 0]
    jitter = 1e-3 * np.random.default_rng(0).normal(size=(20, 2))
    return places[which] + jitter, np.repeat([0, 1], 10), places


def test_clusters_count_touches_with_one_added(two_places):
    train, codes, places = two_places
    episodes = np.repeat(places[:1], 3, axis=0)[np.newaxis]
    scores = ClusterBayes((2,)).scores(train, codes, episodes)
    odds = scores[0, :, 0] - scores[0, :, 1]
    # (9 + 1) / (10 + 2) against (1 + 1) / (10 + 2), each time.
    assert_allclose(odds, np.log(5) * np.arange(1, 4))


def test_bags_compare_histograms_by_chi_squared(two_places):
    train, codes, places = two_places
    episodes = places[[0, 1]][np.newaxis]
    scores = BagOfTouches((2,)).scores(train, codes, episodes)[0]
    touched = np.array([[1.0, 0.0], [0.5, 0.5]])
    learnt = np.array([[0.9, 0.1], [0.1, 0.9]])
    expected = [[-((s - k) ** 2 / (s + k)).sum() / 2 for k in learnt] for s in touched]
    assert_allclose(scores, expected)


def test_the_number_of_clusters_is_the_one_that_recognises():
    rng = np.random.default_rng(0)
    corners = np.array([[0, 0], [9, 9], [0, 9], [9, 0]], dtype=float)
    codes = np.repeat([0, 1], 24)
    # Diagonal corners belong together: two clusters cannot tell the objects apart.
    which = np.r_[np.tile([0, 1], 12), np.tile([2, 3], 12)]
    train = corners[which] + 0.1 * rng.normal(size=(48, 2))
    assert BagOfTouches((1, 4)).choose(train, codes) == 4


def test_one_component_is_the_gaussian_of_the_object(rng):
    codes = np.repeat([0, 1], 40)
    train = rng.normal(size=(80, 2)) + 3 * codes[:, np.newaxis]
    episodes = rng.normal(size=(5, 1, 2)) + 1.5
    scores = Mixtures(1).scores(train, codes, episodes)[:, 0]
    densities = []
    for code in (0, 1):
        of_object = train[codes == code]
        covariance = np.cov(of_object.T, bias=True)
        away = episodes[:, 0] - of_object.mean(axis=0)
        squared = np.einsum("ij,jk,ik->i", away, np.linalg.inv(covariance), away)
        densities.append(-0.5 * (squared + np.log(np.linalg.det(covariance))))
    odds = densities[1] - densities[0]
    # The lift of the covariances is a thousandth of the variance.
    assert_allclose(scores[:, 1] - scores[:, 0], odds, atol=0.05)


@pytest.mark.parametrize(("n_touches", "singular"), [(30, 0.0), (4, 100.0)])
def test_fewer_touches_than_features_make_singular_covariances(
    rng, n_touches, singular
):
    codes = np.repeat(np.arange(20), n_touches)
    facts = Mixtures(1).facts(rng.normal(size=(len(codes), 6)), codes)
    assert facts["n_features"] == 6
    assert facts["parameters"] == 6 + 21
    assert facts["singular"] == singular


def test_a_control_that_tells_everything_is_seen(rng):
    codes = np.repeat([0, 1], 12)
    train = codes[:, np.newaxis] + 0.01 * rng.normal(size=(24, 2))
    scores = Nuisance("brightness").scores(train, codes, np.ones((1, 2, 2)))
    assert_array_equal(scores.argmax(axis=-1), [[1, 1]])


@pytest.fixture
def dome_touches():
    camera = DomeCamera(image_shape=(60, 60))
    touches = simulate_touches(["ball", "box"], 12, camera, random_state=0)
    return touches.without("no_contact")


def test_densities_are_the_preset(dome_touches):
    encoded = encode(dome_touches)
    values = encoded.features["Zernike"]
    rows = np.array([[0, 1, 2], [12, 13, 14]])
    scores = Densities().scores(values, encoded.codes, values[rows])
    recogniser = ObjectRecogniser("corradi2015").fit(dome_touches)
    for episode, belief_rows in zip(scores, rows, strict=True):
        belief = recogniser.start(strangers=0)
        for after, row in zip(episode, belief_rows, strict=True):
            belief.update(dome_touches[int(row)])
            posterior = [belief.posterior[name] for name in encoded.names.tolist()]
            # Discs are in single precision; posteriors near 0 and 1 hide no more.
            assert_allclose(np.exp(after), posterior, atol=1e-4)


def test_all_features_are_finite_and_one_row_a_touch(dome_touches):
    encoded = encode(dome_touches)
    for values in encoded.features.values():
        assert len(values) == len(dome_touches)
        assert np.isfinite(values).all()
    assert encoded.idle is None


def test_a_category_is_tested_on_objects_that_were_not_learnt():
    objects = np.repeat(["mug_a", "mug_b", "pen_a", "pen_b", "pen_c"], 25)
    category = np.char.partition(objects, "_")[:, 0]
    touches = Touches(np.zeros((125, 8, 8)), object=objects, category=category)
    names, codes = np.unique(objects, return_inverse=True)
    encoded = Encoded(names, codes, {}, None)
    by_category, folds = category_folds(Corradi2015Plan(orders=2), touches, encoded)
    assert len(folds) == 2
    for fold in folds:
        tested = np.unique(objects[fold.episodes])
        assert len(tested) == 2
        assert not np.isin(tested, objects[fold.train]).any()
        truth = by_category.names[fold.truth]
        assert_array_equal(category[fold.episodes[:, 0]], truth)


NAMES = ("mug_a", "mug_b", "mug_c", "pen_a", "pen_b", "pen_c")
PLAN = Corradi2015Plan(touches=(1, 5, 30), orders=4)


def drawn(names, noise, rng, **columns):
    """Values of 3 x 24 electrodes, sixteen touches of each object."""
    images = [
        np.random.default_rng(sum(map(ord, name))).normal(size=(3, 24))
        + noise * rng.normal(size=(16, 3, 24))
        for name in names
    ]
    return Touches(
        np.concatenate(images),
        object=np.repeat(names, 16),
        category=np.repeat([name.split("_")[0] for name in names], 16),
        geometry="none",
        **columns,
    )


def photographed(names, archive, of_name):
    """Write eight photographs of each object, with 40 words of `of_name` each."""
    rows = [np.bincount([of_name(name)] * 40, minlength=12) for name in names]
    counts = np.repeat(rows, 8, axis=0)
    np.savez(archive, counts=counts, object=np.repeat(names, 8))
    return beside.read_photographs(archive)


def test_photographs_are_roots_of_shares(tmp_path):
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    np.testing.assert_allclose((photographs.words**2).sum(axis=1), 1)
    assert photographs.words[8].argmax() == 1
    assert photographs.object[8] == NAMES[1]


def test_telling_photographs_help_touches_that_tell_nothing(rng, tmp_path):
    touches = drawn(NAMES, 1e3, rng)
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    right = beside.sight(touches, photographs, Plan(touches=(1, 30)))
    # "last" tests a quarter of 16 touches, so that nothing is said after 30.
    assert {sense: list(curve) for sense, curve in right.items()} == {
        "touch": [1],
        "sight": [0],
        "both": [1],
    }
    assert_array_equal(right["sight"][0], np.ones(6))
    # Chance is 1/6.
    assert right["touch"][1].mean() < 0.5
    assert right["both"][1].mean() > 0.9


def test_photographs_of_unseen_objects_name_their_category(rng, tmp_path):
    touches = drawn((*NAMES[:2], *NAMES[3:5]), 1, rng)
    of_kind = {name: 3 * name.startswith("pen") for name in NAMES}
    photographs = photographed(NAMES, tmp_path / "w.npz", of_kind.__getitem__)
    right = beside.sight(
        touches, photographs, Plan(label="category", touches=(1,), orders=4)
    )
    # Two folds, one object of each category in each.
    assert_array_equal(right["sight"][0], np.ones(4))


def test_objects_without_photographs_are_left_out(rng, tmp_path):
    touches = drawn(NAMES, 0.1, rng)
    photographs = photographed((*NAMES[:4], "key_a"), tmp_path / "w.npz", len)
    right = beside.sight(touches, photographs, Plan(touches=(1,), orders=2))
    assert_array_equal(right["touch"][1], np.ones(4))


def test_the_first_authors_figures_stand_beside_ours(rng, tmp_path):
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    rows = sight_rows(PLAN, drawn(NAMES, 0.1, rng), photographs, "object")
    paper = {(r["recogniser"], r["touches"]): r["paper"] for r in rows}
    assert paper["both", 1] == 45.2
    assert paper["touch", 1] == 18.8
    assert paper["sight", 0] == 39.7
    assert {row["objects"] for row in rows} == {6}
    assert len({row["name"] for row in rows}) == len(rows)
    (table,) = STUDIES["corradi2015"].tables({"rows": rows, "confusion": {}})
    title, columns, lines = table
    assert title.startswith("Objects, with a photograph, recorded")
    assert columns == ["recogniser", "0", "1"]
    by_name = {line[0]: line[1:] for line in lines}
    assert by_name["first author, both"] == ["-", "45.2"]
    assert by_name["sight"] == ["100±0", "-"]


@pytest.mark.parametrize("at", [5, 9, 12])
def test_a_jump_is_found_where_it_is(at, rng):
    centres = rng.normal(scale=0.1, size=(20, 2))
    centres[at:] += 6
    assert beside.jump_of(centres) == at


def moved_touches(rng):
    """Two objects whose camera moved after seven touches, and two where it stood."""
    names = (*beside.MOVED[:2], "box_a", "can_a")
    order = np.tile(rng.permutation(16), 4)
    rim = rng.normal(scale=0.1, size=(64, 3))
    rim[:32][order[:32] >= 7] += 9
    return drawn(names, 0.1, rng, order=order, **{beside.RIM: rim})


def test_touches_are_parted_where_the_camera_moved(rng):
    touches = moved_touches(rng)
    early = beside.before_the_move(touches)
    assert_array_equal(early[:32], touches.order[:32] < 7)
    assert early[32:].all()


def test_moved_objects_are_tested_on_the_other_side_alone(rng):
    rows = moved_rows(PLAN, moved_touches(rng))
    ours = [row for row in rows if row["recogniser"] == "default"]
    # Seven touches before the move, nine after: both ways one and five are answered.
    assert {(row["table"], row["touches"]) for row in ours} == {
        (f"moved, {way}", k) for way in beside.WAYS for k in (1, 5)
    }
    # These touches do not change as the camera moves.
    assert all(row["ours"] == 100 and row["objects"] == 2 for row in ours)
    assert {row["recogniser"] for row in rows} > {"brightness", "sorted pixels"}


def test_missing_photographs_and_columns_are_named_as_skipped(rng, tmp_path):
    tasks, skipped = beside_tasks(PLAN, drawn(NAMES, 1, rng), tmp_path)
    assert tasks == []
    assert "no bathtip/visual_words50.npz" in skipped[0]
    assert "no object among bowl_whitebig" in skipped[1]
    (tmp_path / "bathtip").mkdir()
    photographed(NAMES, tmp_path / "bathtip" / "visual_words50.npz", NAMES.index)
    without_rim = drawn((beside.MOVED[0], "box_a"), 1, rng)
    tasks, skipped = beside_tasks(PLAN, without_rim, tmp_path)
    assert len(tasks) == 2
    assert "no columns 'order' and 'rim_circle" in skipped[0]
    tasks, skipped = beside_tasks(PLAN, moved_touches(rng), tmp_path)
    assert (len(tasks), skipped) == (3, [])


@pytest.mark.parametrize("later", [True, False])
def test_sight_and_moved_cameras_come_with_the_later_experiments(
    later, rng, monkeypatch
):
    touches = drawn(NAMES, 1, rng)
    objects = Objects("bathtip", touches, touches)
    tasks_and_skipped = ([lambda: [{"name": "beside"}]], ["Left out."])
    stubs = {
        "recorded_touches": touches,
        "recorded_objects": objects,
        "simulated_objects": objects,
        "beside_tasks": tasks_and_skipped,
        "unseen_beliefs": {},
        "confusions": {},
        **{n: [] for n in ("learnt_tasks", "later_tasks", "experiment_rows")},
        **{n: [] for n in ("unseen_rows", "timing_rows")},
    }
    for name, answer in stubs.items():
        modules = (corradi2015, corradi2015.episodes, corradi2015.stated)
        module = next(module for module in modules if hasattr(module, name))
        monkeypatch.setattr(module, name, lambda *_, it=answer: fresh(it))
    plan = Corradi2015Plan(later=later)
    result = run_study("corradi2015", plan=plan, workers=1, progress=False)
    assert [row["name"] for row in result["rows"]] == (["beside"] if later else [])
    assert result["skipped"] == (["Left out."] if later else [])
    assert not Corradi2015Plan.quick().later


def fresh(answer):
    """Return lists as new ones: the study adds to them."""
    return list(answer) if isinstance(answer, list) else answer
