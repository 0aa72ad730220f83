"""What lerobot itself reads of an export, and what comes back of its datasets."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.library import TouchLibrary, read_bag

torch = pytest.importorskip("torch")
datasets = pytest.importorskip("lerobot.datasets.lerobot_dataset")
pytest.importorskip("palpate_lerobot")
# What lerobot's dependencies warn of is not ours to mend.
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def array(rng):
    return rng.normal(size=(9, 3, 4)).astype(np.float32), {}


def grey(rng):
    return rng.integers(0, 256, (9, 60, 80), dtype=np.uint8), {}


def colour(rng):
    images = rng.integers(0, 256, (9, 60, 80, 3), dtype=np.uint8)
    return images, {"channels": ["r", "g", "b"], "geometry": "plane"}


def forces(rng):
    images = rng.integers(-9, 9, (9, 4, 4, 3)).astype(np.int16)
    return images, {"channels": ["x", "y", "z"]}


def pads(rng):
    images = rng.normal(size=(9, 4, 9)).astype(np.float32)
    images[:, :, 4] = np.nan
    boxes = [[0, 0, 4, 4], [0, 5, 4, 4]]
    return images, {"pads": boxes, "pad_names": ["thumb", "index"]}


@pytest.fixture
def exported(tmp_path, rng):
    """Export touches of a kind; return them as stored, and the folder."""

    def export(kind, labelled=True):
        images, whole = kind(rng)
        labels = {"object": ["cup"] * 4 + ["pen"] * 5} if labelled else {}
        touches = Touches(
            images,
            **labels,
            **whole,
            session=["a"] * 2 + ["b"] * 2 + ["a"] * 5,
            time_s=1e9 + np.cumsum(rng.uniform(0.1, 3, 9)),
            force_n=rng.uniform(size=9),
            position_mm=rng.normal(size=(9, 3)),
        )
        with TouchLibrary.open(tmp_path / "library", create=True) as library:
            library.add(touches)
            library.export(tmp_path / "robot")
            return library.touches(), tmp_path / "robot"

    return export


def as_read(images):
    """Return images as lerobot gives them: channels first, pictures from 0 to 1."""
    if images.dtype != np.uint8:
        return images.astype(np.float32)
    if images.ndim == 3:  # grey three times
        images = np.repeat(images[..., None], 3, axis=3)
    return np.moveaxis(images, 3, 1).astype(np.float32) / np.float32(255)


@pytest.mark.parametrize("labelled", [True, False], ids=["labelled", "unlabelled"])
@pytest.mark.parametrize("kind", [array, grey, colour, forces, pads])
def test_lerobot_reads_what_was_stored(exported, kind, labelled):
    stored, folder = exported(kind, labelled)
    dataset = datasets.LeRobotDataset("palpate/test", root=folder)
    frames = [dataset[i] for i in range(len(dataset))]
    # Without labels a session is one episode, and the touches of "b" come last.
    order = np.arange(9) if labelled else np.array([0, 1, 4, 5, 6, 7, 8, 2, 3])
    first = [0, 0, 2, 2, *[4] * 5] if labelled else [*[0] * 7, 2, 2]
    images = np.stack([frame["observation.tactile"] for frame in frames])
    # Pictures are divided by 255 in float32 by lerobot and here: one unit of rounding.
    assert_allclose(images, as_read(stored.images[order]), rtol=1.2e-7)
    time_s = stored.columns["time_s"]
    times = [frame["timestamp"].item() for frame in frames]
    assert_allclose(times, time_s[order] - time_s[first], rtol=1e-6)  # as float32
    tasks = [frame["task"] for frame in frames]
    if labelled:
        assert tasks == [f"touch {name}" for name in stored.object]
        assert [frame["object"] for frame in frames] == stored.object.tolist()
    else:
        assert set(tasks) == {"touch"}
    assert dataset.num_episodes == (3 if labelled else 2)


@pytest.mark.parametrize("kind", [array, colour, pads])
def test_one_step_of_training(exported, kind):
    """Through a DataLoader, with the spread that stands beside the frames."""
    _, folder = exported(kind)
    dataset = datasets.LeRobotDataset("palpate/test", root=folder)
    loader = torch.utils.data.DataLoader(dataset, batch_size=4, shuffle=True)
    batch = next(iter(loader))
    assert len(batch["object"]) == 4
    spread = dataset.meta.stats["observation.tactile"]
    mean, std = (torch.tensor(spread[n], dtype=torch.float32) for n in ("mean", "std"))
    values = (batch["observation.tactile"] - mean) / (std + 1e-6)
    values = torch.nan_to_num(values).flatten(1)
    model = torch.nn.Linear(values.shape[1], 2)
    names = ["cup", "pen"]
    labels = torch.tensor([names.index(name) for name in batch["object"]])
    step = torch.optim.SGD(model.parameters(), lr=1e-3 / values.shape[1])
    losses = []
    for _ in range(2):
        loss = torch.nn.functional.cross_entropy(model(values), labels)
        losses.append(loss.item())
        step.zero_grad()
        loss.backward()
        step.step()
    assert np.isfinite(losses).all()
    assert losses[1] < losses[0]


@pytest.mark.parametrize("kind", [grey, colour])
def test_a_policy_trains_on_an_export(exported, kind, tmp_path, monkeypatch):
    """`lerobot-train --policy.type=act`, three steps, nothing fetched."""
    train = pytest.importorskip("lerobot.scripts.lerobot_train")
    stored, folder = exported(kind)
    dataset = datasets.LeRobotDataset("palpate/test", root=folder)
    places = stored.columns["position_mm"].astype(np.float32)
    following = places[[1, 1, 3, 3, 5, 6, 7, 8, 8]]  # three visits
    frames = [dataset[i] for i in range(len(dataset))]
    assert_array_equal(np.stack([f["action"] for f in frames]), following)
    states = np.stack([frame["observation.state"] for frame in frames])
    assert_array_equal(states[:, :3], places)
    assert_allclose(states[:, 3], stored.columns["force_n"], rtol=1e-7)
    losses = []
    update = train.update_policy

    def noted(*args, **options):
        tracker, output = update(*args, **options)
        losses.append(tracker.loss.val)
        return tracker, output

    monkeypatch.setattr(train, "update_policy", noted)
    options = {
        "policy.type": "act",
        "policy.device": "cpu",
        "policy.push_to_hub": "false",
        "policy.pretrained_backbone_weights": "null",
        "policy.chunk_size": 4,
        "policy.n_action_steps": 4,
        "dataset.repo_id": "palpate/test",
        "dataset.root": folder,
        "steps": 3,
        "batch_size": 2,
        "num_workers": 0,
        "save_checkpoint": "false",
        "wandb.enable": "false",
        "output_dir": tmp_path / "trained",
    }
    words = ["lerobot-train", *(f"--{name}={value}" for name, value in options.items())]
    monkeypatch.setattr("sys.argv", words)
    train.main()
    assert len(losses) == 3
    assert np.isfinite(losses).all()


@pytest.mark.parametrize("kind", [array, grey, colour, forces, pads])
def test_an_export_comes_back(exported, kind):
    stored, folder = exported(kind)
    again = read_bag(folder)
    assert again.images.dtype == stored.images.dtype
    assert_array_equal(again.images, stored.images)
    for name in ("object", "session", "time_s"):
        assert_array_equal(again.columns[name], stored.columns[name])
    assert again.channels == stored.channels
    assert again.pad_names == stored.pad_names
    assert_array_equal(again.pads, stored.pads)


@pytest.mark.parametrize("feature", ["observation.images.gel", "observation.state"])
def test_a_dataset_that_lerobot_wrote_is_touches(tmp_path, rng, feature):
    pictures = rng.integers(0, 256, (4, 48, 64, 3), dtype=np.uint8)
    states = rng.normal(size=(4, 5)).astype(np.float32)
    axes = ["height", "width", "channels"]
    dataset = datasets.LeRobotDataset.create(
        "palpate/other",
        fps=10,
        root=tmp_path / "other",
        use_videos=False,
        features={
            "observation.images.gel": {
                "dtype": "image",
                "shape": (48, 64, 3),
                "names": axes,
            },
            "observation.state": {"dtype": "float32", "shape": (5,), "names": None},
        },
    )
    for first, task in ((0, "grasp the cup"), (2, "grasp the pen")):
        for i in (first, first + 1):
            gel = {"observation.images.gel": pictures[i]}
            dataset.add_frame({**gel, "observation.state": states[i], "task": task})
        dataset.save_episode()
    dataset.finalize()
    touches = read_bag(tmp_path / "other", feature)
    expected = pictures if "gel" in feature else states[:, None]
    assert_array_equal(touches.images, expected)
    assert touches.object.tolist() == ["grasp the cup"] * 2 + ["grasp the pen"] * 2
    assert touches.columns["episode"].tolist() == [0, 0, 1, 1]
    assert_allclose(touches.columns["time_s"], [0, 0.1, 0, 0.1], atol=1e-7)
    if "gel" in feature:
        assert_array_equal(read_bag(tmp_path / "other").images, pictures)


def test_a_video_that_lerobot_wrote_is_what_it_was_given(tmp_path):
    """Smooth pictures, which its codec, AV1, keeps well; two episodes, two films."""
    row, col = np.mgrid[:48, :64]
    pictures = [
        np.stack([row * 3 + n, col * 2 + 5 * n, 0 * row + 20 * n], axis=2)
        for n in range(1, 9)
    ]
    pictures = np.array(pictures).clip(0, 255).astype(np.uint8)
    axes = ["height", "width", "channels"]
    film = {"dtype": "video", "shape": (48, 64, 3), "names": axes}
    root = tmp_path / "filmed"
    dataset = datasets.LeRobotDataset.create(
        "palpate/filmed", fps=10, root=root, features={"observation.images.gel": film}
    )
    for first, task in ((0, "cup"), (5, "pen")):
        for picture in pictures[first : 5 if first == 0 else 8]:
            dataset.add_frame({"observation.images.gel": picture, "task": task})
        dataset.save_episode()
    dataset.finalize()
    touches = read_bag(root)
    differences = np.abs(touches.images.astype(int) - pictures)
    # 1.5 levels apart at the mean; two pictures that follow each other are 8.
    assert differences.mean(axis=(1, 2, 3)).max() < 3
    assert touches.object.tolist() == ["cup"] * 5 + ["pen"] * 3
    expected_s = [0, 0.1, 0.2, 0.3, 0.4, 0, 0.1, 0.2]
    assert_allclose(touches.columns["time_s"], expected_s, atol=1e-6)
