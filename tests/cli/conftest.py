"""Running the command inside the test process: no start-up to wait for."""

import json
import sys
from dataclasses import dataclass

import pytest

from palpate.cli import main
from palpate.recognition import Belief


@dataclass
class Result:
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
        return Result(code, printed.out, printed.err)

    return run


@pytest.fixture
def answer_of(palpate):
    """Call `palpate ARGUMENTS... --json`, which must end well; return its JSON."""

    def run(*arguments, cwd=None):
        result = palpate(*arguments, "--json", cwd=cwd)
        assert result.returncode == 0, result.stderr
        return json.loads(result.stdout)

    return run


@pytest.fixture
def error_shares(monkeypatch):
    """The shares of errors and refusals at which beliefs are asked to decide."""
    shares, plain = set(), Belief.named

    def named(self, error=0.01, costs=None, *, refusal=None, level="object"):
        shares.add((error, refusal))
        return plain(self, error, costs, refusal=refusal, level=level)

    monkeypatch.setattr(Belief, "named", named)
    return shares
