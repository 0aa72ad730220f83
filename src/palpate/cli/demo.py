"""`palpate demo`: learn ten objects, recognise them by touch, meet unknown ones."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import Seed
from ._output import percent
from ._stages import Stages

if TYPE_CHECKING:
    from ..touches import Touches

SOURCE = "https://github.com/Exhor/deep_visuotactile_classification"
NAME_PATTERN = (
    r"touch_\d+_img_(?P<order>\d+)_name_(?P<object>(?P<category>[a-z]+)_.+)"
    r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)"
)
TRAIN_TOUCHES = 60
TEST_TOUCHES = 30
UNKNOWN_SHOWN = ("plastic card", "soft textbook")


def demo(
    real: Annotated[
        bool, typer.Option("--real", help="Use the recorded touches in PALPATE_DATA.")
    ] = False,
    folder: Annotated[
        Path, typer.Option("--output", help="Where to write the model and the report.")
    ] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Learn ten household objects from 60 touches each and recognise them.

    Touches a dome camera's simulated objects, or reads recorded pictures with
    --real. The last line printed is the path of the report.
    """
    pictures = _pictures() if real else None
    import numpy as np

    from ..evaluation import (
        Plan,
        check_report_path,
        evaluate,
        write_report,
    )
    from .recognise import print_episode, recognise_episodes

    folder.mkdir(parents=True, exist_ok=True)
    report = check_report_path(folder / "report.html")
    with Stages() as stage:
        train, test, unknown = (
            _read(pictures, seed, stage) if pictures else _simulate(seed)
        )
        plan = Plan(touches=(1, 3, 5, 10), seed=seed)
        figures, trials = evaluate(
            train, test, unknown=unknown, plan=plan, progress=stage
        )
    recogniser = trials[0].recogniser
    print(
        f"Learnt {len(recogniser.classes_)} objects from {len(train)} touches "
        f"({TRAIN_TOUCHES} each) and recognise the other {len(test)}, one by one:\n"
    )
    for episode in recognise_episodes(recogniser, test, error=0.01):
        print_episode(episode)
    if unknown is not None:
        print("Objects that were never learnt:\n")
        shown = unknown[np.isin(unknown.columns["object"], UNKNOWN_SHOWN)]
        for episode in recognise_episodes(recogniser, shown, error=0.01):
            print_episode(episode)
    _print_end(figures)
    model = recogniser.save(folder / "ten-objects.palpate")
    write_report(report, figures, trials)
    print(f"model: {model.resolve()}")
    print(report.resolve())


def _read(
    pictures: Path, seed: int, stage: Stages
) -> tuple["Touches", "Touches", None]:
    from ..evaluation import split_by_count
    from ..touches import Touches

    stage("reading the pictures")
    touches = Touches.load(
        pictures,
        name_pattern=NAME_PATTERN,
        no_contact=pictures / "baselineForCalibration.jpg",
    )
    return *split_by_count(touches, TRAIN_TOUCHES, seed), None


def _simulate(seed: int) -> tuple["Touches", "Touches", "Touches"]:
    """Learn in six sessions, recognise in two others.

    In every session the object is turned anew and the camera has moved.
    """
    from ..simulation import HOUSEHOLD, UNSEEN, simulate_touches

    def explore(
        objects: Any, n_touches: int, n_sessions: int, number: int
    ) -> "Touches":
        return simulate_touches(
            objects,
            n_touches,
            n_sessions=n_sessions,
            random_state=3 * seed + number,
            n_jobs=-1,
            progress=None,
        )

    return (
        explore(HOUSEHOLD, TRAIN_TOUCHES, 6, 0),
        explore(HOUSEHOLD, TEST_TOUCHES, 2, 1),
        explore(UNSEEN, TEST_TOUCHES, 2, 2),
    )


def _print_end(figures: dict[str, Any]) -> None:
    for k, share in figures["accuracy"].items():
        spread = percent(figures["accuracy_sd"][k])
        line = f"right after {k:>2} touches: {percent(share):>5} % (sd {spread})"
        if "unknown_auroc" in figures:
            line += f"; known from unknown: {figures['unknown_auroc'][k]:.2f} ROC area"
        print(line)


def _pictures() -> Path:
    data = os.environ.get("PALPATE_DATA")
    pictures = Path(data or ".") / "bathtip" / "originals"
    if not data or not pictures.is_dir():
        raise ValueError(
            "--real needs recorded touches: fetch the tactile pictures of "
            f"{SOURCE} and set PALPATE_DATA to the folder that holds them as "
            "bathtip/originals."
        )
    return pictures
