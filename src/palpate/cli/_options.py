"""Options that several verbs share, and reading what they name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..touches import Touches

TouchesPath = Annotated[
    Path,
    typer.Argument(
        metavar="TOUCHES", help="A touch archive (.npz) or a folder of JPEG/PNG images."
    ),
]
ModelPath = Annotated[
    Path, typer.Argument(metavar="MODEL", help="A model file (.palpate).")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object and nothing else.")
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]
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
MaxMegapixels = Annotated[
    float,
    typer.Option("--max-megapixels", help="Larger pictures are refused unread."),
]


def read_touches(
    path: Path,
    name_pattern: str | None,
    no_contact: Path | None,
    max_megapixels: float,
) -> "Touches":
    """Read an archive or a folder as the shared options say."""
    from ..touches import Touches

    return Touches.load(
        path,
        name_pattern=name_pattern,
        no_contact=no_contact,
        max_pixels=int(max_megapixels * 1e6),
    )
