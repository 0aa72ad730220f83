"""`python -m palpate_look MODEL TOUCHES -o FILE`: what a model believes, to look at."""

import argparse
import sys
from pathlib import Path

from palpate import ObjectRecogniser, Touches

from . import log_episodes


def main(arguments: list[str] | None = None) -> int:
    """Write the episodes of touches to a file; return the exit code."""
    parser = argparse.ArgumentParser(prog="palpate_look", description=__doc__)
    parser.add_argument("model", type=Path, help="model file (.palpate)")
    parser.add_argument("touches", type=Path, help="touch archive or folder")
    parser.add_argument("-o", "--output", type=Path, required=True, help=".rrd, .mcap")
    parser.add_argument("--error", type=float, default=0.01, help="accepted error")
    options = parser.parse_args(arguments)
    try:
        recogniser = ObjectRecogniser.load(options.model)
        touches = Touches.load(options.touches)
        n_episodes = log_episodes(options.output, recogniser, touches, options.error)
    except (ValueError, OSError, ImportError) as error:
        print(f"palpate_look: {error}", file=sys.stderr)
        return 1
    print(f"{len(touches)} touches in {n_episodes} episodes are in {options.output}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
