"""Running the command inside the test process, and touches and pictures to give it.

What is no failure to be told in a sentence leaves `main` as an exception, so that a
test of a refusal needs not look for a traceback.
"""

import json
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image

from palpate import ObjectRecogniser, Touches
from palpate.cli import main
from palpate.exploration import explore_to_learn
from palpate.library import TouchLibrary
from palpate.recognition import Belief
from palpate.simulation import DomeCamera, find_object

NAMES = ("ball", "mug", "pen")


def put(path, levels=None, **how):
    """Write a picture of these levels, or else of noise of its own, darker of a mug."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if levels is None:
        rng = np.random.default_rng(list(str(path).encode()))
        levels = rng.normal(60 if "mug" in str(path) else 160, 9, (10, 12))
    Image.fromarray(np.asarray(levels).clip(0, 255).astype(np.uint8)).save(path, **how)
    return path


def put_each(root, n_each, names=("mug", "pen"), ending="png"):
    """Write so many pictures of each object, in a folder of its name."""
    for name in names:
        for number in range(n_each):
            put(root / name / f"{number}.{ending}")
    return root


def drawn(seed, names=NAMES, n_each=20):
    """Touches of patterns, each with noise of this seed, in the order of their making.

    Besides those of `NAMES` there is a cap.
    """
    rng, noise = np.random.default_rng(3), np.random.default_rng(seed)
    patterns = {name: rng.normal(size=(3, 24)) for name in (*NAMES, "cap")}
    objects = np.repeat(names, n_each)
    images = [patterns[o] + 0.5 * noise.normal(size=(3, 24)) for o in objects]
    order = np.tile(np.arange(n_each), len(names))
    return Touches(np.array(images), object=objects, order=order, geometry="none")


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("touches") / "t.npz"
    drawn(0).save(path)
    return path


@pytest.fixture(scope="session")
def model(archive):
    """The file of a model that has learnt the archive."""
    recogniser = ObjectRecogniser().fit(Touches.load(archive))
    return recogniser.save(archive.with_name("m.palpate"))


@pytest.fixture(scope="session")
def explored(tmp_path_factory):
    """A folder with a dome's model, m.palpate, and its touches, and a library, lib."""
    folder = tmp_path_factory.mktemp("explored")
    camera = DomeCamera(image_shape=(48, 48), n_nodes=24)
    things = [find_object(name) for name in ("ball", "box", "pen")]
    taught = explore_to_learn(things, 14, camera, n_sessions=2)
    taught.save(folder / "m.npz")
    ObjectRecogniser(rehearse=False).fit(taught).save(folder / "m.palpate")
    with TouchLibrary.open(folder / "lib", create=True) as library:
        library.add(drawn(0))
    return folder


@dataclass
class Result:
    returncode: int
    stdout: str
    stderr: str


class Command:
    """The command `palpate`, as a shell would call it."""

    def __init__(self, capsys, monkeypatch):
        self._capsys, self._monkeypatch = capsys, monkeypatch

    def __call__(self, *arguments, cwd=None):
        """Call `palpate ARGUMENTS...` and return what it printed."""
        self._monkeypatch.setenv("PALPATE_MAX_MODEL_MB", "2000")
        self._monkeypatch.setattr(sys, "argv", ["palpate", *map(str, arguments)])
        if cwd is not None:
            self._monkeypatch.chdir(cwd)
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        printed = self._capsys.readouterr()
        return Result(code, printed.out, printed.err)

    def printed(self, *arguments, cwd=None):
        """Call `palpate ARGUMENTS...`, which must succeed; return what it prints."""
        result = self(*arguments, cwd=cwd)
        assert result.returncode == 0, result.stderr
        return result.stdout

    def answer(self, *arguments, cwd=None, code=0):
        """Call `palpate ARGUMENTS... --json`, which must end so; return its JSON."""
        result = self(*arguments, "--json", cwd=cwd)
        assert result.returncode == code, result.stderr
        return json.loads(result.stdout)

    def refusal(self, *arguments, cwd=None, code=1):
        """Call `palpate ARGUMENTS...`, which must fail; return what it says of that."""
        result = self(*arguments, cwd=cwd)
        assert result.returncode == code, result.stdout
        return result.stderr


@pytest.fixture
def palpate(capsys, monkeypatch):
    return Command(capsys, monkeypatch)


@pytest.fixture
def error_shares(monkeypatch):
    """The shares of errors and refusals at which beliefs are asked to decide."""
    shares, plain = set(), Belief.named

    def named(self, error=0.01, costs=None, *, refusal=None, level="object"):
        shares.add((error, refusal))
        return plain(self, error, costs, refusal=refusal, level=level)

    monkeypatch.setattr(Belief, "named", named)
    return shares
