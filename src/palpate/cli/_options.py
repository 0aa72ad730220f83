"""Options that several verbs share, and reading what they name."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..library import Selection
    from ..touches import Touches

TouchesPath = Annotated[
    Path,
    typer.Argument(
        metavar="TOUCHES",
        help="A touch archive (.npz), a folder of JPEG/PNG images, or a library.",
    ),
]
ModelPath = Annotated[
    Path, typer.Argument(metavar="MODEL", help="A model file (.palpate).")
]
MOST_SEED = 2**32 - 1


def checked_seed(seed: int) -> int:
    """Return a seed that every generator takes, or say what --seed should be."""
    if not 0 <= seed <= MOST_SEED:
        raise ValueError(
            f"--seed must be between 0 and {MOST_SEED}, got {seed}. "
            "Give another number."
        )
    return seed


AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object and nothing else.")
]
Seed = Annotated[
    int,
    typer.Option("--seed", help="Seed of everything random.", callback=checked_seed),
]
Preset = Annotated[
    str, typer.Option("--preset", help='"default", "corradi2015" or "liu2014".')
]
Label = Annotated[
    str, typer.Option("--label", help='What to recognise: "object" or "category".')
]
Floor = Annotated[
    float | None,
    typer.Option(
        "--floor",
        help="Least probability one touch leaves to all objects; 0 lets one touch "
        "rule an object out. Default: the preset's.",
    ),
]
NamePattern = Annotated[
    str | None,
    typer.Option(
        "--name-pattern",
        help="Regular expression for image names with named groups, such as "
        r"'(?P<object>\w+)_(?P<order>\d+)'. Without it folders name the objects.",
    ),
]
NoContact = Annotated[
    Path | None,
    typer.Option("--no-contact", help="The image of the sensor touching nothing."),
]
Where = Annotated[
    str | None,
    typer.Option(
        "--where",
        help="Of a library, the touches that meet this filter alone, such as "
        '"object = mug and force_n > 0.5". Comparisons: = != < <= > >= in contains, '
        "is null; joined by and, or, not.",
    ),
]
Calibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        help="A `TaxelCalibration` (JSON) of a pressure array: readings become kPa "
        "before anything else. Give the same to `learn` and `recognise`.",
    ),
]
MaxMegapixels = Annotated[
    float,
    typer.Option("--max-megapixels", help="Larger pictures are refused unread."),
]


def read_touches(
    path: Path,
    name_pattern: str | None,
    no_contact: Path | None,
    max_megapixels: float,
    where: str | None = None,
) -> "Touches":
    """Read an archive, a folder or a library as the shared options say."""
    from ..library import TouchLibrary
    from ..touches import Touches

    if TouchLibrary.is_library(path):
        _refuse_picture_options(path, name_pattern, no_contact)
        with TouchLibrary.open(path) as library:
            return library.touches(where)
    if where is not None:
        raise ValueError(
            f"--where must be given with a library of touches, got {where!r} with "
            f"{path}. Make a library with `palpate library add`."
        )
    return Touches.load(
        path,
        name_pattern=name_pattern,
        no_contact=no_contact,
        max_pixels=int(max_megapixels * 1e6),
    )


def calibrated(touches: "Touches", calibration: Path | None) -> "Touches":
    """Return touches in kPa by the calibration of their array, if one is given."""
    if calibration is None:
        return touches
    from ..images import TaxelCalibration
    from ..touches import Touches

    known = TaxelCalibration.load(calibration)
    whole = dict(touches.whole)
    if touches.no_contact is not None:
        whole["no_contact"] = known.transform(touches.no_contact[None])[0]
    return Touches(known.transform(touches.images), **touches.columns, **whole)


@contextmanager
def training_touches(
    path: Path,
    name_pattern: str | None,
    no_contact: Path | None,
    max_megapixels: float,
    where: str | None,
) -> "Iterator[Touches | Selection]":
    """Read touches to learn from; those of a library are read as they are needed."""
    from ..library import TouchLibrary

    if not TouchLibrary.is_library(path):
        yield read_touches(path, name_pattern, no_contact, max_megapixels, where)
        return
    _refuse_picture_options(path, name_pattern, no_contact)
    with TouchLibrary.open(path) as library:
        yield library.select(where)


def _refuse_picture_options(
    path: Path, name_pattern: str | None, no_contact: Path | None
) -> None:
    given = {"--name-pattern": name_pattern, "--no-contact": no_contact}
    for option, value in given.items():
        if value is not None:
            raise ValueError(
                f"{option} must be left out for a library, got {value} with {path}. "
                "Give it to `palpate library add`, which keeps what it finds."
            )
