"""`palpate demo`: learn ten real objects and recognise them touch by touch."""

import os
from pathlib import Path
from typing import Annotated

import typer

from ._options import Seed
from ._output import percent

SOURCE = "https://github.com/Exhor/deep_visuotactile_classification"
NAME_PATTERN = (
    r"touch_\d+_img_(?P<order>\d+)_name_(?P<object>(?P<category>[a-z]+)_.+)"
    r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)"
)
TRAIN_TOUCHES = 60


def demo(
    folder: Annotated[
        Path, typer.Option("--output", help="Where to write the model and the report.")
    ] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Learn ten household objects from a dome camera's pictures and recognise them.

    Reads the recorded touches in the folder that PALPATE_DATA names. The last
    line printed is the path of the report.
    """
    pictures = _pictures()
    from ..evaluation import Plan, check_report_path, evaluate, split_by_count
    from ..touches import Touches
    from ._stages import Stages
    from .recognise import print_episode, recognise_episodes

    folder.mkdir(parents=True, exist_ok=True)
    report = folder / "report.html"
    check_report_path(report)
    with Stages() as stage:
        stage("reading the pictures")
        touches = Touches.load(
            pictures,
            name_pattern=NAME_PATTERN,
            no_contact=pictures / "baselineForCalibration.jpg",
        )
        train, test = split_by_count(touches, TRAIN_TOUCHES, seed)
        plan = Plan(touches=(1, 3, 5, 10), seed=seed)
        figures, trials = evaluate(train, test, plan=plan, progress=stage)
    recogniser = trials[0].recogniser
    print(
        f"Learnt {len(recogniser.classes_)} objects from {len(train)} touches "
        f"({TRAIN_TOUCHES} each) and recognise the other {len(test)}, one by one:\n"
    )
    for episode in recognise_episodes(recogniser, test, error=0.01):
        print_episode(episode, at_most=5)
    for k, share in figures["accuracy"].items():
        spread = percent(figures["accuracy_sd"][k])
        print(
            f"right after {k:>2} touches: {percent(share)} % (sd {spread} over objects)"
        )
    from ..evaluation import write_report

    recogniser.save(folder / "ten-objects.palpate")
    print(f"model: {(folder / 'ten-objects.palpate').resolve()}")
    write_report(report, figures, trials)
    print(report.resolve())


def _pictures() -> Path:
    data = os.environ.get("PALPATE_DATA")
    pictures = Path(data or ".") / "bathtip" / "originals"
    if not data or not pictures.is_dir():
        raise ValueError(
            "the demo needs recorded touches: fetch the tactile pictures of "
            f"{SOURCE} and set PALPATE_DATA to the folder that holds them as "
            "bathtip/originals."
        )
    return pictures
