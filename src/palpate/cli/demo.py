"""`palpate demo`: explore and learn ten objects, recognise them, meet unknown ones."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ._options import AsJson, Seed, option
from ._output import percent, print_json, stages
from .explore import exploration_to_dict, print_attempt
from .recognise import print_episode, recognise_episodes

if TYPE_CHECKING:
    from ..evaluation import Trial
    from ..recognition import ObjectRecogniser
    from ..touches import Touches

SOURCE = "https://github.com/Exhor/deep_visuotactile_classification"
NAME_PATTERN = (
    r"touch_\d+_img_(?P<order>\d+)_name_(?P<object>(?P<category>[a-z]+)_.+)"
    r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)"
)
TRAIN_TOUCHES = 60
TEST_TOUCHES = 30
UNKNOWN_TOUCHES = 20
UNKNOWN_RECORDED = 2
SIDE = 120
KNOWN_SHOWN = ("mug", "stapler", "water bottle")
UNKNOWN_SHOWN = ("plastic card", "massage ball")
ERROR = 0.1
MOST_ATTEMPTS = 16

Sets = tuple["Touches", "Touches", "Touches"]
Stage = Callable[[str], None]


def demo(
    real: Annotated[
        bool, option("--real", "Use the recorded touches in PALPATE_DATA.")
    ] = False,
    folder: Annotated[
        Path, option("--output", "Where to write the model and the report.")
    ] = Path("demo"),
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Learn ten household objects from 60 touches each and recognise them.

    A simulated arm explores simulated objects with a dome camera, or, with --real,
    recorded pictures of ten objects are read, of which two are not learnt but met
    as unknown ones. The last line printed is the path of the report.
    """
    pictures = _pictures() if real else None
    from ..evaluation import Plan, check_report_path, evaluate, write_report

    folder.mkdir(parents=True, exist_ok=True)
    report = check_report_path(folder / "report.html")
    with stages() as stage:
        sets = _read(pictures, seed, stage) if pictures else _explored(seed)
        train, test, unknown = sets
        plan = Plan(touches=(1, 3, 5, 10), seed=seed)
        figures, trials = evaluate(
            train, test, unknown=unknown, plan=plan, progress=stage
        )
    recogniser = trials[0].recogniser
    if not as_json:
        print(
            f"Learnt {len(recogniser.classes_)} objects from {len(train)} touches "
            f"({TRAIN_TOUCHES} each).\n"
        )
    if pictures:
        episodes = _recognise_recorded(recogniser, test, unknown, quiet=as_json)
    else:
        episodes = _recognise_by_exploring(recogniser, train, seed, quiet=as_json)
    name = "recorded-objects" if pictures else "ten-objects"
    model = recogniser.save(folder / f"{name}.palpate")
    write_report(report, figures, trials)
    if as_json:
        written = {"model": str(model.resolve()), "report": str(report.resolve())}
        print_json({**figures, "episodes": episodes, **written})
        return
    _print_figures(figures, trials[0])
    print(f"model: {model.resolve()}")
    print(report.resolve())


def _explored(seed: int) -> Sets:
    """Explore to learn in twelve sessions, to be tested in five others, and unknowns.

    In every session the object is put down and turned anew and the picture has
    drifted.
    """
    from ..exploration import explore_to_learn
    from ..simulation import HOUSEHOLD, UNSEEN, DomeCamera

    explore = partial(
        explore_to_learn,
        camera=DomeCamera(image_shape=(SIDE, SIDE)),
        turned=True,
        drift=True,
        n_jobs=-1,
        progress=None,
    )
    return (
        explore(HOUSEHOLD, TRAIN_TOUCHES, n_sessions=12, random_state=3 * seed),
        explore(HOUSEHOLD, TEST_TOUCHES, n_sessions=5, random_state=3 * seed + 1),
        explore(UNSEEN, UNKNOWN_TOUCHES, n_sessions=5, random_state=3 * seed + 2),
    )


def _recognise_by_exploring(
    recogniser: "ObjectRecogniser", train: "Touches", seed: int, *, quiet: bool
) -> list[dict[str, Any]]:
    """Let the arm choose its touches on some objects until each is decided."""
    import numpy as np

    from ..exploration import (
        InformativeTouch,
        RandomHemisphere,
        Strategy,
        TouchMap,
        explore,
        put_down,
    )
    from ..simulation import DomeCamera, find_object

    touch_map = TouchMap(random_state=seed).fit(recogniser, train)
    episodes = []
    for number, name in enumerate(KNOWN_SHOWN + UNKNOWN_SHOWN):
        rng = np.random.default_rng([seed, number])
        stand = put_down(
            find_object(name),
            DomeCamera(image_shape=(SIDE, SIDE)).drifted(rng),
            yaw_rad=float(rng.uniform(0, 2 * np.pi)),
            random_state=int(rng.integers(2**31)),
        )
        strategy: Strategy = InformativeTouch(touch_map, stand.hemisphere)
        how = "(learnt) where it expects to learn most"
        if name in UNKNOWN_SHOWN:
            # What counts as unknown was learnt from touches at random places.
            strategy = RandomHemisphere(stand.hemisphere, random_state=seed)
            how = "(never learnt) at random places"
        if not quiet:
            print(f"The arm touches the {name} {how}:")
        end = explore(
            stand.robot,
            stand.sensor,
            recogniser,
            strategy,
            max_attempts=MOST_ATTEMPTS,
            error=ERROR,
            clock=stand.robot.clock,
            on_attempt=None if quiet else print_attempt,
        )
        if not quiet:
            print(f"  {end.reason}\n")
        episodes.append({"object": name, **exploration_to_dict(recogniser, end)})
    return episodes


def _recognise_recorded(
    recogniser: "ObjectRecogniser", test: "Touches", unknown: "Touches", *, quiet: bool
) -> list[dict[str, Any]]:
    known = recognise_episodes(recogniser, test, error=ERROR)
    others = recognise_episodes(recogniser, unknown, error=ERROR)
    if not quiet:
        print(f"Recognising the other {len(test)} touches, one by one:\n")
        for episode in known:
            print_episode(episode)
        names = " and ".join(str(episode["object"]) for episode in others)
        print(
            f"Now {names}, recorded like the others but left out of learning, so that "
            "there is something unknown:\n"
        )
        for episode in others:
            print_episode(episode)
    return known + others


def _read(pictures: Path, seed: int, stage: Stage) -> Sets:
    """Read the recorded pictures; some objects, drawn by lot, are the unknown ones."""
    import numpy as np

    from ..evaluation import split_by_count
    from ..touches import Touches

    stage("reading the pictures")
    touches = Touches.load(
        pictures,
        name_pattern=NAME_PATTERN,
        no_contact=pictures / "baselineForCalibration.jpg",
    )
    names = np.unique(np.asarray(touches.object))
    drawn = np.random.default_rng(seed).permutation(names)[:UNKNOWN_RECORDED]
    unknown = np.isin(np.asarray(touches.object), drawn)
    return *split_by_count(touches[~unknown], TRAIN_TOUCHES, seed), touches[unknown]


def _print_figures(figures: dict[str, Any], trial: "Trial") -> None:
    """Print the accuracy with, beside it, what nuisance values alone achieve."""
    controls = {k: v for k, v in figures["controls"].items() if v is not None}
    heads = ["touches", "right %", "sd", *(f"{name} %" for name in controls)]
    heads += ["known from unknown", "unknown found %"]
    n_objects = len(trial.recogniser.classes_)
    print(
        f"{len(trial.fold.test)} other touches of {n_objects} objects (chance "
        f"{100 / n_objects:.0f} %). Beside what is right, controls: what the place of "
        "the disc, brightness\nor grey levels alone get right, and touches without "
        "contact; then the ROC area of known against unknown,\nand how many unknown "
        "ones are found where one known in twenty is refused (0.5 is chance: unknown "
        "objects\nthat resemble known ones are taken for them; what resembles nothing "
        "is found at once)."
    )
    print("  ".join(heads))
    for k, share in figures["accuracy"].items():
        cells = [k, percent(share), percent(figures["accuracy_sd"][k])]
        cells += [percent(values.get(k)) for values in controls.values()]
        cells.append(f"{figures['unknown_auroc'][k]:.2f}")
        cells.append(percent(figures["unknown_refused"][k]))
        pairs = zip(cells, heads, strict=True)
        print("  ".join(cell.rjust(len(head)) for cell, head in pairs))


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
