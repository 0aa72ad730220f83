"""`palpate demo`: explore and learn six objects, recognise them, meet another."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ._options import AsJson, RecordedData, Seed, Strangers, flag, option
from ._output import answer, say, stages
from .evaluate import in_options
from .explore import print_attempt
from .recognise import print_episode, recognise_episodes

if TYPE_CHECKING:
    from ..recognition import ObjectRecogniser
    from ..touches import Touches

NAME_PATTERN = (
    r"touch_\d+_img_(?P<order>\d+)_name_(?P<object>(?P<category>[a-z]+)_.+)"
    r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)"
)
# What touch can tell apart, and a thing like none of them (the paper's ten: `study`).
LEARNT = ("stapler", "toothbrush", "mug", "box", "pen", "ball")
UNLIKE = ("massage ball",)
# Another placement shows more than more touches in the same.
TRAIN_TOUCHES, TRAIN_SESSIONS = 120, 20
TEST_TOUCHES = 20
UNKNOWN_TOUCHES = 20
RECORDED_TOUCHES = 60
UNKNOWN_RECORDED = 2
SIDE = 120
EPISODES_OF = ("toothbrush", "box", "ball")
ERROR = 0.05
# One in four of the things that it touches was never learnt.
STRANGERS = 0.25
MOST_ATTEMPTS = 16

Sets = tuple["Touches", "Touches", "Touches"]


def demo(
    real: Annotated[bool, flag("--real", "Recorded ones: see --data.")] = False,
    data: RecordedData = None,
    folder: Annotated[Path, option("--output", "For model and report.")] = Path("demo"),
    strangers: Strangers = STRANGERS,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Learn six objects, recognise three of them by touch, and meet an unknown one.

    A simulated arm explores simulated objects with a dome camera: 120 touches of each
    in 20 placements, made in one step, to learn them; guarded ones to recognise them.
    Or, with --real, recorded pictures of ten objects are read, 60 touches each, of
    which two are not learnt but met as unknown ones. The last line printed is the path
    of the report.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"--output must be a folder, got the file {str(folder)!r}.")
    pictures = _pictures(data) if real else None
    from .._page import check_report_path
    from ..evaluation import Plan, evaluate, write_report

    plan = Plan(touches=(1, 3, 5, 10), seed=seed, error=ERROR, strangers=strangers)
    if not (pictures or as_json):
        say(
            "A simulated arm touches six objects to learn them, 120 times each; then "
            f"it names things, at an accepted error of {100 * ERROR:.0f} %. A minute "
            "or two."
        )
    folder.mkdir(parents=True, exist_ok=True)
    report = check_report_path(folder / "report.html")
    with stages() as stage:
        sets = _read(pictures, seed, stage) if pictures else _explored(seed)
        train, test, unknown = sets
        figures, trials = evaluate(
            train, test, unknown=unknown, plan=plan, progress=stage
        )
    in_options(figures)
    recogniser = trials[0].recogniser
    if not as_json:
        say(
            f"Learnt {len(recogniser.classes_)} objects from {len(train)} touches "
            f"({len(train) // len(recogniser.classes_)} each).\n"
        )
    if pictures:
        episodes = _recognise_recorded(
            recogniser, test, unknown, strangers, quiet=as_json
        )
    else:
        episodes = _recognise_by_exploring(recogniser, seed, strangers, quiet=as_json)
    name = "recorded-objects" if pictures else "six-objects"
    model = recogniser.save(folder / f"{name}.palpate")
    write_report(report, figures, trials)
    written = {"model": str(model.resolve()), "report": str(report.resolve())}
    answer(
        as_json,
        {**figures, "episodes": episodes, **written},
        *figures.summary(),
        f"model: {written['model']}",
        written["report"],
    )


def _explored(seed: int) -> Sets:
    """Explore to learn in twenty sessions, to be tested in five others, and unknowns.

    In every session the object is put down and turned anew and the picture has
    drifted.
    """
    from ..exploration import explore_to_learn
    from ..simulation import DomeCamera, find_object

    learnt_objects, unknown = (
        list(map(find_object, names)) for names in (LEARNT, UNLIKE)
    )
    explore = partial(
        explore_to_learn,
        camera=DomeCamera(image_shape=(SIDE, SIDE)),
        turned=True,
        drift=True,
        guarded=False,
        n_jobs=-1,
        progress=None,
    )
    return (
        explore(
            learnt_objects,
            TRAIN_TOUCHES,
            n_sessions=TRAIN_SESSIONS,
            random_state=3 * seed,
        ),
        explore(learnt_objects, TEST_TOUCHES, n_sessions=5, random_state=3 * seed + 1),
        explore(unknown, UNKNOWN_TOUCHES, n_sessions=5, random_state=3 * seed + 2),
    )


def _recognise_by_exploring(
    recogniser: "ObjectRecogniser", seed: int, strangers: float, *, quiet: bool
) -> list[dict[str, Any]]:
    import numpy as np

    from ..exploration import RandomHemisphere, explore, put_down
    from ..simulation import DomeCamera, find_object

    episodes = []
    for number, name in enumerate(EPISODES_OF + UNLIKE):
        rng = np.random.default_rng([seed, number])
        stand = put_down(
            find_object(name),
            DomeCamera(image_shape=(SIDE, SIDE)).drifted(rng),
            yaw_rad=float(rng.uniform(0, 2 * np.pi)),
            random_state=int(rng.integers(2**31)),
        )
        met = "never learnt" if name in UNLIKE else "learnt"
        if not quiet:
            say(f"The arm touches the {name} ({met}) at random places:")
        end = explore(
            stand.robot,
            stand.sensor,
            recogniser,
            RandomHemisphere(stand.hemisphere, random_state=seed),
            guard=stand.quick_guard,
            max_attempts=MOST_ATTEMPTS,
            error=ERROR,
            strangers=strangers,
            clock=stand.robot.clock,
            on_attempt=None if quiet else print_attempt,
        )
        if not quiet:
            say(f"  {end.reason}\n")
        ended = end.to_dict(recogniser, stand.hemisphere)
        episodes.append({"object": name, **ended})
    return episodes


def _recognise_recorded(
    recogniser: "ObjectRecogniser",
    test: "Touches",
    unknown: "Touches",
    strangers: float,
    *,
    quiet: bool,
) -> list[dict[str, Any]]:
    how = {"error": ERROR, "strangers": strangers}
    of_learnt = recognise_episodes(recogniser, test, how)
    others = recognise_episodes(recogniser, unknown, how)
    names = " and ".join(str(episode["object"]) for episode in others)
    shown = {
        f"Recognising the other {len(test)} touches, one by one:": of_learnt,
        f"Now {names}, recorded like the others but left out of learning, so that "
        "there is something unknown:": others,
    }
    for title, episodes in shown.items() if not quiet else ():
        say(f"{title}\n")
        for episode in episodes:
            print_episode(episode)
    return of_learnt + others


def _read(pictures: Path, seed: int, stage: Callable[[str], None]) -> Sets:
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
    return *split_by_count(touches[~unknown], RECORDED_TOUCHES, seed), touches[unknown]


def _pictures(data: Path | None) -> Path:
    from .. import datasets

    pictures = datasets.where(data) / "bathtip" / "originals"
    if not pictures.is_dir():
        raise ValueError(
            f"--real needs recorded touches, got no folder {pictures}: type `palpate "
            "data fetch bathtip`, or name a folder with --data or PALPATE_DATA."
        )
    return pictures
