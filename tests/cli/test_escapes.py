"""What a terminal would obey is shown, not printed raw."""

import sys
import warnings

import numpy as np

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.touches import png_bytes


def test_escapes_in_texts_of_a_library_are_shown(palpate, tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        images = np.zeros((2, 3, 3), np.uint8)
        library.add(Touches(images, session=["\x1b[2J", "b"], object=["pen", "cup"]))
        key = library.list()[0].id
    for arguments in (["list", tmp_path], ["show", tmp_path, key]):
        done = palpate("library", *arguments)
        assert done.returncode == 0
        assert "\x1b[2J" not in done.stdout
        assert r"\x1b[2J" in done.stdout


def pictures(folder, names):
    """Write drawn pictures under these names."""
    rng = np.random.default_rng(0)
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(png_bytes(rng.integers(0, 255, (12, 12), dtype=np.uint8)))


CLEAR = "\x1b]0;owned\x07\x1b[2J\x9b31m"


def test_escapes_in_names_of_files_are_shown(palpate, tmp_path):
    """In results, refusals and warnings alike, on both outputs."""
    folder, model = tmp_path / f"things{CLEAR}", tmp_path / "m.palpate"
    names = [f"{o}{CLEAR}/{n}.png" for o in ("mug", "pen") for n in range(6)]
    pictures(folder, names)
    asked = [
        ["learn", folder, "-o", model, "--preset", "liu2014"],
        ["recognise", model, folder],
        ["check", folder],
        ["learn", folder / "nothing", "-o", model],
        ["evaluate", "--train", folder, "--test", folder, "--preset", "liu2014"],
    ]
    said = []
    for arguments in asked:
        done = palpate(*arguments)
        said.append(done.stdout + done.stderr)
    (folder / names[0]).write_bytes(b"no picture")
    for arguments in (asked[0], [*asked[0], "--skip-bad"], asked[2]):
        done = palpate(*arguments)
        said.append(done.stdout + done.stderr)
    for one in said:
        assert not {"\x1b", "\x07", "\x9b"} & {*one}, repr(one)
    assert sum(r"\x1b[2J" in one for one in said) >= 6


def test_warnings_show_what_a_terminal_would_obey(palpate, monkeypatch):
    usual = warnings.formatwarning

    def warned(**_):
        about = UserWarning(f"{CLEAR} is odd"), UserWarning, "palpate", 1
        print(warnings.formatwarning(*about), file=sys.stderr)

    monkeypatch.setattr("palpate.cli._app.app", warned)
    said = palpate("doctor").stderr
    assert r"\x1b[2J" in said
    assert "\x1b" not in said
    assert warnings.formatwarning is usual
