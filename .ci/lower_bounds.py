"""Print the oldest versions that pyproject.toml promises, as `make test-oldest` wants.

Everything that palpate names itself is pinned to its lower bound; what that brings
along is the newest that fits.
"""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

# These read the code and never run it. schemathesis needs newer packages than users
# do; its tests skip.
LEFT_OUT = {"palpate", "ruff", "mypy", "scipy-stubs", "schemathesis"}


def main() -> None:
    """Print one requirement a line, as pip takes them."""
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    print("\n".join(sorted(set(oldest(tomllib.loads(text)["project"])))))


def oldest(project: dict) -> Iterator[str]:
    """Yield the core, the extras and what the tests need, each at its lower bound."""
    extras = project["optional-dependencies"]
    for extra, requirements in {"": project["dependencies"], **extras}.items():
        for requirement in requirements:
            name = re.split(r"[\[>]", requirement)[0]
            if extra not in ("dev", "docs") and name not in LEFT_OUT:
                yield pin(requirement)


def pin(requirement: str) -> str:
    """Turn `name>=1.2,<2; where` into `name==1.2; where`; each must name its oldest."""
    found = re.fullmatch(r"([\w.-]+)>=([\w.]+)(,<[\w.]+)?(;.+)?", requirement)
    if found is None:
        raise SystemExit(f"{requirement!r} in pyproject.toml must be `name>=version`.")
    return f"{found[1]}=={found[2]}{found[4] or ''}"


if __name__ == "__main__":
    main()
