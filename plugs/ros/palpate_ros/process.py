"""The process that recognises: the command `palpate live` on the wire of ROS.

palpate needs Python 3.11 and numpy 2, ROS 2 has its own Python; so palpate lives in an
environment of its own, is named by its command, and speaks DDS or zenoh by itself.
"""

import os
import shutil
import subprocess
from collections.abc import Mapping

# Variables of the Python of ROS, which another Python must not have.
_OF_ROS = ("PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH", "VIRTUAL_ENV")
_FOREVER_S = "1e9"
_PATIENCE_S = 10.0


class ProcessError(RuntimeError):
    """palpate is not there, or its process has ended."""


def wire(environment: Mapping[str, str]) -> str:
    """Return the options of an address: domain and wire, by the variables of ROS."""
    domain = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    zenoh = environment.get("RMW_IMPLEMENTATION", "").startswith("rmw_zenoh")
    return f"domain={domain}&via={'zenoh' if zenoh else 'dds'}"


def command_line(
    parameters: Mapping[str, object], environment: Mapping[str, str], prefix: str
) -> list[str]:
    """Return the command that recognises by the parameters of a node.

    Raises
    ------
    ProcessError
        No model is named, or there is no such command.
    """
    model, library = str(parameters["model"]), str(parameters["library"])
    if not model:
        raise ProcessError(
            "The parameter model must name a model file: --ros-args -p model:=FILE."
        )
    named = str(parameters["palpate"])
    palpate = shutil.which(named)
    if palpate is None:
        raise ProcessError(
            f"The parameter palpate must name the command palpate, got {named!r}. "
            'Install it: python3.11 -m venv P; P/bin/pip install "palpate[ros]"; '
            "then -p palpate:=P/bin/palpate."
        )
    where = wire(environment)
    topic = str(parameters["topic"]).lstrip("/")
    line = [palpate, "live", model, "--sensor", f"ros:/{topic}?{where}"]
    # ROS has its own services; the process would offer the same ones again.
    line += ["--publish", f"ros:{prefix}?{where}&services=no"]
    line += ["--episodes", "0", "--timeout", _FOREVER_S]
    line += ["--error", str(parameters["error"])]
    return line + (["--library", library] if library else [])


class PalpateProcess:
    """`palpate live`, from `start` to `stop`."""

    def __init__(self, line: list[str]) -> None:
        self._line = line
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, without the variables of the Python of ROS."""
        kept: dict[str, str] = {
            name: value for name, value in os.environ.items() if name not in _OF_ROS
        }
        self._process = subprocess.Popen(self._line, env=kept)

    def check(self) -> None:
        """Raise `ProcessError` where it has ended."""
        if self._process is None:
            return
        code = self._process.poll()
        if code is not None:
            raise ProcessError(f"palpate ended with {code}; its last lines say why.")

    def stop(self) -> None:
        """End it, whatever it does."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        try:
            process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
