"""The command and its verbs; what goes wrong becomes one sentence and exit code 1.

Nothing heavy is imported here: each verb imports what it needs when it runs, so
that `palpate --help` answers at once.
"""

import os
import sys

import typer

from . import simulate_dome  # noqa: F401, registers `dome` and `pins`
from .bench import bench
from .demo import demo
from .doctor import doctor
from .evaluate import evaluate
from .explore import explore
from .learn import learn
from .library import library
from .live import live
from .recognise import recognise
from .record import record
from .serve import serve
from .simulate import simulate
from .study import study

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Recognise things by touch: learn objects from touches, recognise them "
    "touch by touch, and say when something is unknown.",
)
for verb in (learn, recognise, evaluate, demo, study, bench, doctor):
    app.command()(verb)
for live_verb in (serve, record, live):
    app.command()(live_verb)
app.add_typer(simulate, name="simulate")
app.add_typer(library, name="library")
app.add_typer(explore, name="explore")


@app.callback()
def _root() -> None:
    """Take the verbs as they are."""


def main() -> None:
    """Run the command line; exit 1 for a failure, 2 for wrong usage.

    PALPATE_DEBUG=1 in the environment shows the whole traceback of a failure.
    """
    try:
        app()
    except (
        ValueError,
        TypeError,
        OSError,
        RuntimeError,
        ImportError,
        MemoryError,
    ) as error:
        if os.environ.get("PALPATE_DEBUG"):
            raise
        print(f"palpate: {error}", file=sys.stderr)
        sys.exit(1)
