"""Running the command inside the test process: no start-up to wait for."""

import sys
from dataclasses import dataclass

import pytest

from palpate.cli import main


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def palpate(capsys, monkeypatch):
    """Call `palpate ARGUMENTS...` as a shell would and return what it printed."""

    def run(*arguments, cwd=None):
        monkeypatch.setenv("PALPATE_MAX_MODEL_MB", "2000")
        monkeypatch.setattr(sys, "argv", ["palpate", *map(str, arguments)])
        if cwd is not None:
            monkeypatch.chdir(cwd)
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        printed = capsys.readouterr()
        return Done(code, printed.out, printed.err)

    return run
