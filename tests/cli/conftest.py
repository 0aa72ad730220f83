"""Running the command inside the test process: no start-up to wait for."""

import json
import sys
from dataclasses import dataclass

import pytest

from palpate.cli import main
from palpate.recognition import Belief


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


@pytest.fixture
def told(palpate):
    """Call `palpate ARGUMENTS... --json`, which must end well; return the object."""

    def run(*arguments, cwd=None):
        done = palpate(*arguments, "--json", cwd=cwd)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture
def asked(monkeypatch):
    """At which shares of errors and refusals beliefs are asked to decide."""
    found, plain = set(), Belief.named

    def named(self, error=0.01, costs=None, *, refusal=None, level="object"):
        found.add((error, refusal))
        return plain(self, error, costs, refusal=refusal, level=level)

    monkeypatch.setattr(Belief, "named", named)
    return found
