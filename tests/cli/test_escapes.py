"""Escape sequences, which a terminal would obey, are printed as visible text."""

import io
import re
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palpate import Touches, cli
from palpate.cli import serve
from palpate.cli.sensor import need_baseline
from palpate.library import TouchLibrary
from palpate.sensors import ContactError

from .conftest import put_each

CLEAR = "\x1b]0;owned\x07\x1b[2J\x9b31m"


def assert_harmless(output):
    assert not {"\x1b", "\x07", "\x9b"} & {*output}, repr(output)


def test_escapes_in_texts_of_a_library_are_shown(palpate, tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        images = np.zeros((2, 3, 3), np.uint8)
        library.add(Touches(images, session=["\x1b[2J", "b"], object=["pen", "cup"]))
        key = library.list()[0].id
    for arguments in (["list", tmp_path], ["show", tmp_path, key]):
        printed = palpate.printed("library", *arguments)
        assert_harmless(printed)
        assert r"\x1b[2J" in printed


def test_escapes_in_names_of_files_are_shown(palpate, tmp_path):
    """They are visible text in results, refusals and warnings, on both outputs."""
    folder, model = tmp_path / f"things{CLEAR}", tmp_path / "m.palpate"
    put_each(folder, 6, [f"mug{CLEAR}", f"pen{CLEAR}"])
    commands = [
        ["learn", folder, "-o", model, "--preset", "liu2014"],
        ["recognise", model, folder],
        ["check", folder],
        ["learn", folder / "nothing", "-o", model],
        ["evaluate", "--train", folder, "--test", folder, "--preset", "liu2014"],
    ]
    results = [palpate(*arguments) for arguments in commands]
    (folder / f"mug{CLEAR}" / "0.png").write_bytes(b"no picture")
    for arguments in (commands[0], [*commands[0], "--skip-bad"], commands[2]):
        results.append(palpate(*arguments))
    outputs = [result.stdout + result.stderr for result in results]
    for output in outputs:
        assert_harmless(output)
    assert sum(r"\x1b[2J" in output for output in outputs) >= 6


def test_letters_that_an_output_cannot_hold_are_written_out(
    palpate, tmp_path, monkeypatch, model
):
    """As standard output has it under LC_ALL=C, or in a file on Windows."""
    touches = tmp_path / "t.npz"
    Touches(np.ones((2, 3, 24)), object=["Tässe"] * 2, geometry="none").save(touches)
    held = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(held, "ascii"))
    palpate.printed("recognise", model, touches)
    sys.stdout.flush()
    printed = held.getvalue().decode("ascii")
    assert r"Touches of T\xe4sse:" in printed
    assert re.search(r"touch   1  #*\.* 0\.", printed)


def test_warnings_show_what_a_terminal_would_obey(palpate, monkeypatch):
    usual = warnings.formatwarning

    def warned(**_):
        about = UserWarning(f"{CLEAR} is odd"), UserWarning, "palpate", 1
        print(warnings.formatwarning(*about), file=sys.stderr)

    monkeypatch.setattr("palpate.cli.app", warned)
    printed = palpate("doctor").stderr
    assert r"\x1b[2J" in printed
    assert "\x1b" not in printed
    assert printed.startswith("palpate: ")  # no line of code
    assert warnings.formatwarning is usual


@pytest.mark.parametrize(
    "arguments",
    [
        [CLEAR],
        ["learn", f"--{CLEAR}"],
        ["learn", CLEAR, "-o", CLEAR],
        ["learn", "x", "-o", "m.palpate", CLEAR],
        ["library", CLEAR],
        ["serve", "--sensor", f"camera:a?{CLEAR}=1"],
        ["serve", "--sensor", f"nothing:{CLEAR}"],
        ["serve", "--sensor", "sim:mug", "--publish", CLEAR],
        ["serve", "--sensor", "sim:mug", "--port", "0", "--log", f"x.{CLEAR}"],
        ["serve", "--host", CLEAR, "--port", "0"],
        ["live", f"m{CLEAR}.palpate", "--sensor", f"replay:{CLEAR}"],
        ["bench", CLEAR],
        ["data", "fetch", CLEAR],
        ["explore", "recognise", CLEAR, CLEAR],
        ["simulate", CLEAR, "-o", "x.npz"],
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_wrong_usage_shows_what_was_typed(palpate, tmp_path, arguments, as_json):
    result = palpate(*arguments, *["--json"] * as_json, cwd=tmp_path)
    assert result.returncode in (1, 2)
    printed = result.stdout + result.stderr
    assert_harmless(printed)
    assert "owned" in printed


def test_escapes_in_the_address_of_a_server_are_shown(monkeypatch, capsys):
    """A given host name and a given token are printed again, on both outputs."""
    serve._say_where(CLEAR, 80, CLEAR, as_json=False)
    printed = capsys.readouterr()
    for output in (printed.out, printed.err):
        assert_harmless(output)
        assert r"\x1b[2J" in output


def test_escapes_in_what_a_sensor_says_of_itself_are_shown(monkeypatch, capsys):
    """Names of cameras come from the device, those of recordings from a file."""
    refusal = ContactError(f"{CLEAR} is pressed.")
    sensor = SimpleNamespace(unfixed=f"{CLEAR} does not hold still.")

    def refuse(*, force=False):
        if not force:
            raise refusal

    session = SimpleNamespace(
        watch=SimpleNamespace(sensor=sensor), baseline=None, take_baseline=refuse
    )
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    need_baseline(session)
    printed = capsys.readouterr().err
    assert_harmless(printed)
    assert printed.count(r"\x1b[2J") == 2


def test_only_the_module_of_output_prints():
    """Other modules call `say`, or give rich what `printable` returned."""
    folder = Path(cli.__file__).parent
    raw = re.compile(r"(?<![\w.])print\(|typer\.s?echo|\.write\(|Console\(|\.secho")
    printing_files = {
        path.name
        for path in folder.glob("*.py")
        if path.name != "_output.py" and raw.search(path.read_text())
    }
    assert not printing_files
