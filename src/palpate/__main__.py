"""`python -m palpate`, and the command `palpate`.

What takes a while to import is imported in `main`, so that Ctrl-C, early as it may be,
ends in one sentence.
"""

import os
import sys


def main() -> None:
    """Run the command line, as `palpate.cli.main` says."""
    try:
        from .cli import main as run
    except KeyboardInterrupt:
        if os.environ.get("PALPATE_DEBUG"):
            raise
        sys.stderr.write("palpate: Stopped by Ctrl-C before anything was begun.\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
