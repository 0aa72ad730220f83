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
