"""Options that several verbs share, and reading and working as they say.

An option is a type (`Seed`). Options that belong together are a dataclass (`Reading`):
a verb takes one parameter of it, and `grouped` puts its fields on the command line, in
the help under the dataclass's `PANEL`.
"""

import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from filecmp import cmp
from functools import wraps
from inspect import Parameter, Signature, signature
from itertools import chain
from pathlib import Path
from shlex import quote
from shutil import copyfileobj
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args
from warnings import catch_warnings, simplefilter

import typer

from .. import _durable
from .._extras import install, needed
from ._output import WrongUse, say

if TYPE_CHECKING:
    from ..recognition import ObjectRecogniser
    from ..sensors import TouchDetector
    from ..touches import Touches, TouchSource

    # Touches to learn from, held or read as they are needed.
    Labelled = Touches | TouchSource

# Of options of reading: what they are for, as `kind_of` calls it, and in words.
_FILES = ("folder", "file")
_FOR: dict[str, tuple[tuple[str, ...], str]] = {
    "where": (("library",), "a library; make one with `palpate library add`"),
    **dict.fromkeys(("name_pattern", "levels"), (_FILES, "folders of pictures")),
    **dict.fromkeys(
        ("no_contact", "colour"),
        ((*_FILES, "film"), "pictures and films; else what is read says it itself"),
    ),
    **dict.fromkeys(("shape", "dtype", "channels"), (_FILES, "files of numbers")),
    "begin": (("film",), "films, and for --detect"),
}
_TYPED = ("COMMANDLINE", "ENVIRONMENT")
MOST_SEED = 2**32 - 1
CONNECT_S = 20.0
MEGAPIXELS = 50  # of the largest picture that is read unless told


def checked_seed(seed: int) -> int:
    if not 0 <= seed <= MOST_SEED:
        raise WrongUse(
            f"--seed must be between 0 and {MOST_SEED}, got {seed}. "
            "Give another number."
        )
    return seed


def one_of(name: str, values: Callable[[], Iterable[str]]) -> Callable[..., Any]:
    """Return what refuses a value of an option that is none of `values`."""

    def checked(value: str | None) -> str | None:
        from .._checks import check_option

        if value is not None:
            try:
                check_option(name, value, values())
            except ValueError as error:
                raise WrongUse(str(error)) from None
        return value

    return checked


def allowed(name: str) -> Callable[[], Iterable[str]]:
    """Return what lists the values that a type of `_types.py` allows."""

    def values() -> Iterable[str]:
        from .. import _types

        return get_args(getattr(_types, name))

    return values


def checked_workers(workers: int | None) -> int | None:
    if workers is not None and workers < 1 and workers != -1:
        raise WrongUse(
            f"--workers must be at least 1, or -1 for all cores, got {workers}."
        )
    return workers


def typed(context: typer.Context, *names: str) -> list[str]:
    """Return those of a verb's options that were typed, though it be their default."""
    sources = {name: context.get_parameter_source(name) for name in names}
    return [n for n, source in sources.items() if source and source.name in _TYPED]


def say_limit(source: Path, detector: "TouchDetector") -> None:
    """Say where another limit would have found more touches in a stream."""
    if detector.note:
        say(f"{source}: {detector.note} See --begin.", file=sys.stderr)


def numbers_of_touches(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise WrongUse(
            f"--touches must be whole numbers with commas, got {text!r}; "
            "write --touches 1,5,15."
        ) from None


def option(*names_and_help: str, **more: Any) -> Any:
    """Return an option of the command line: its names, then what it does, as text.

    Without names it is called as its parameter: `aim_sd` is `--aim-sd`. Square brackets
    in the text, as in `palpate[plot]`, are no markup.
    """
    *names, text = names_and_help
    return typer.Option(*names, help=_no_markup(text), **more)


def flag(*names_and_help: str, **more: Any) -> Any:
    """Return an option that takes no value, and so shows no type of one."""
    return option(*names_and_help, metavar="", **more)


def written_file(*names: str, ending: str, text: str) -> Any:
    """Return an option of a file to write, which is refused before the work for it."""

    def checked(path: Path | None) -> Path | None:
        if path is not None:
            if path.suffix.lower() != ending:
                raise WrongUse(f"{names[-1]} must end in {ending}, got {path.name!r}.")
            _durable.check_folder_of(path)
        return path

    return option(*names, text, callback=checked)


def _checked_model(path: Path) -> Path:
    from ..recognition import ObjectRecogniser

    return ObjectRecogniser.check_path(path)


def _checked_report(path: Path | None) -> Path | None:
    from .._page import check_report_path

    return path and check_report_path(path)


def _take_profile(context: typer.Context, path: Path | None) -> Path | None:
    """Take options of reading from a file, as if typed; paths in it start there."""
    if path is None:
        return None
    try:
        written = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"--read must be a TOML file, got {path}: {error}.") from error
    names = [field.name for field in fields(Reading) if field.name != "read"]
    defaults = {key.replace("-", "_"): value for key, value in written.items()}
    for name, value in defaults.items():
        if name not in names or not isinstance(value, str | float | int):
            choices = ", ".join(names).replace("_", "-")
            raise ValueError(
                f"{path} must hold options of reading, a text or number each, got "
                f"{name} = {value!r}. Choose among {choices}."
            )
        place = path.parent / str(value)
        defaults[name] = str(place if name == "no_contact" else value)
    context.default_map = defaults
    return path


def _checked_levels(levels: str | None) -> str | None:
    from ..touches import TouchesError, levels_pattern

    if levels is not None:
        try:
            levels_pattern(levels)
        except TouchesError as error:
            raise WrongUse(str(error)) from None
    return levels


def kind_of(path: Path, topic: str | None = None) -> str:
    """Return what touches are read from: library, bag, Parquet file, film, folder..."""
    from .._types import FILMS
    from ..library import TouchLibrary, is_recording
    from ..touches import ParquetTouches

    if TouchLibrary.is_library(path):
        return "library"
    if topic is not None or is_recording(path):
        return "bag"
    if ParquetTouches.is_parquet(path):
        return "Parquet file"
    if path.suffix.lower() in FILMS:
        return "film"
    return "folder" if path.is_dir() else "file"


def argument(*name_and_help: str) -> Any:
    """Return an argument of the command line: its name, if it has one, and its help."""
    *name, text = name_and_help
    return typer.Argument(metavar=name[0] if name else None, help=_no_markup(text))


def _no_markup(text: str) -> str:
    return re.sub(r"(?=\[[a-z#/@])", r"\\", text)  # what Rich would take for a tag


TouchesPath = Annotated[
    Path,
    argument(
        "TOUCHES",
        "An archive (.npz), a folder of images, a library, a CSV or .npy file, a film, "
        "a bag of ROS or a LeRobotDataset.",
    ),
]
ModelPath = Annotated[
    Path,
    argument(
        "MODEL",
        "A model file (.palpate), or a ready one: sim-array, sim-dome or sim-gel.",
    ),
]
MaxModelMb = Annotated[
    float,
    option(
        "--max-model-mb",
        "A larger model file is refused unread.",
        callback=lambda mb: os.environ.update(PALPATE_MAX_MODEL_MB=str(mb)) or mb,
        envvar="PALPATE_MAX_MODEL_MB",
    ),
]
ModelOutput = Annotated[
    Path,
    option(
        *("-o", "--output", "The model file to write (.palpate)."),
        callback=_checked_model,
    ),
]
RecordedData = Annotated[
    Path | None,
    option("--data", "Folder of recorded touches. Default: `palpate data where`."),
]
AsJson = Annotated[bool, flag("--json", "Print one JSON object and nothing else.")]
Seed = Annotated[
    int, option("--seed", "Seed of everything random.", callback=checked_seed)
]
Preset = Annotated[
    str,
    option(
        "--preset",
        '"default", "corradi2015" or "liu2014".',
        callback=one_of("--preset", allowed("PresetName")),
    ),
]
Label = Annotated[
    str,
    option(
        'What to recognise: "object" or "category".',
        callback=one_of("--label", allowed("Label")),
    ),
]
STRANGERS = 0.05  # as where Python is asked, which is loaded later
Strangers = Annotated[
    float,
    option(
        "--strangers",
        "Share of episodes with something never learnt; 0: it is always one of those.",
    ),
]
_REPORT = "Write one self-contained .html."
Page = Annotated[Path | None, written_file("--report", ending=".html", text=_REPORT)]
# With figures, which need the extra `plot`.
Report = Annotated[Path | None, option("--report", _REPORT, callback=_checked_report)]
ListNames = Annotated[bool, flag("--list", "List them.")]
NamePattern = Annotated[
    str | None,
    option(
        "--name-pattern",
        "Regular expression for image names with named groups, such as "
        r"'(?P<object>\w+)_.*'. Without it folders name the objects.",
    ),
]
NoContact = Annotated[
    Path | None, option("--no-contact", "The image of the sensor touching nothing.")
]
Where = Annotated[
    str | None,
    option(
        "--where",
        "Of a library, the touches that meet this filter alone, such as "
        '"object = mug and force_n > 0.5". It compares by =, !=, <, <=, >, >=, in, '
        "contains or is null, joined by and, or, not.",
    ),
]
Calibration = Annotated[
    Path | None,
    option(
        "--calibration",
        "A `TaxelCalibration` (JSON) of a pressure array: readings become kPa "
        "before anything else. Give the same to `learn` and `recognise`.",
    ),
]


def model_file(model: Path, library: Path | None = None) -> Path:
    """Return the file of a model; a ready one's name, where no file has it, is made.

    With a `library` in which more may be learnt, of a ready one a copy in that folder.
    """
    from .. import datasets
    from .._checks import did_you_mean, nearest_path

    if model.exists():
        return model
    names = datasets.READY
    if str(model) not in names:
        if not nearest_path(model) and (near := did_you_mean(model, names)):
            raise ValueError(f"There is no model file {model}.{near}")
        return model
    ready = datasets.fetch(str(model), progress=lambda what: say(what, file=sys.stderr))
    if library is None:
        return ready
    in_library = library / "model.palpate"
    if (library / "library.sqlite").exists() or (
        in_library.exists() and not cmp(in_library, ready, shallow=False)
    ):
        raise ValueError(
            f"{model} must be learnt on in a library that is not there yet, got "
            f"{library} with touches or a model of its own. Name another --library, "
            f"or the model {in_library}."
        )
    library.mkdir(parents=True, exist_ok=True)
    with ready.open("rb") as file, _durable.replacing(in_library) as whole:
        copyfileobj(file, whole)
    return in_library


@dataclass(frozen=True)
class Learning:
    """How a recogniser is made, as `ObjectRecogniser` and `Plan` name it."""

    PANEL: ClassVar[str] = "How it learns"

    preset: Preset = "default"
    label: Label = "object"
    floor: Annotated[
        float | None,
        option(
            "Least probability one touch leaves to all objects; 0 lets one touch "
            "rule an object out. Default: the preset's."
        ),
    ] = None
    presentation: Annotated[
        str,
        option(
            "How objects come: any (angle and place), turned (any angle), shifted (any "
            "place), fixed (always the same), or auto: found out.",
            callback=one_of("--presentation", allowed("Presentation")),
        ),
    ] = "auto"
    seed: Seed = 0


@dataclass(frozen=True)
class Deciding:
    """When something is named, or called unknown; see `ObjectRecogniser.episode`."""

    error: Annotated[float, option("Accepted share of wrong names.")] = 0.01
    refusal: Annotated[
        float | None,
        option(
            "Unknown is said when its probability reaches 1 minus this. If none: "
            "--error."
        ),
    ] = None
    strangers: Strangers = STRANGERS


@dataclass(frozen=True)
class Reading:
    """How touches are read from an archive, a folder or a library.

    `read` names a file that says it once for all verbs: what was not given is taken
    from there.
    """

    PANEL: ClassVar[str] = "How TOUCHES are read"

    read: Annotated[
        Path | None,
        option(
            "A file (.toml) that holds the options below, such as "
            "levels = 'object/session'; what is given here goes before.",
            callback=_take_profile,
            is_eager=True,
        ),
    ] = None
    where: Where = None
    name_pattern: NamePattern = None
    levels: Annotated[
        str | None,
        option(
            "What folder levels are, such as object/session; - skips one, =gel reads "
            "its folder gel alone. Unnamed: category/object.",
            callback=_checked_levels,
        ),
    ] = None
    skip_bad: Annotated[
        bool,
        flag("--skip-bad", "Leave out pictures that `palpate check` finds fault with."),
    ] = False
    no_contact: NoContact = None
    colour: Annotated[
        bool | None,
        flag("--colour", "Read pictures of a folder in red, green and blue."),
    ] = None
    shape: Annotated[
        str | None,
        option("Of a CSV file or raw frames: rows x columns of its taxels, 16x16."),
    ] = None
    dtype: Annotated[
        str | None,
        option("Of frames without a header (.raw, .bin, .dat): uint16, <f4 ..."),
    ] = None
    channels: Annotated[
        str | None,
        option("What each taxel measures, number by number, such as x,y,z."),
    ] = None
    begin: Annotated[
        float | None,
        option(
            "Of a film or with --detect: the change at which a touch begins. "
            "Default: 6 noises."
        ),
    ] = None
    max_megapixels: Annotated[
        float | None, option("Larger pictures are refused unread. Default: 50.")
    ] = None

    def touches(
        self, path: Path, topic: str | None = None, *, quiet: bool = False
    ) -> "Touches":
        """Read touches, all of them at once; `topic` is for bags.

        `quiet` says nothing of what is left out.
        """
        from ..recognition import find_geometry

        kind = self._kind(path, topic, held=True)
        several = kind == "library" or (kind == "Parquet file" and not self.no_contact)
        if not several:
            return self._recording(path, kind, topic, quiet=quiet)
        with self.selection(path) as chosen:
            rows = range(len(chosen))
            touches: Touches = chosen.touches(rows)
            # As learning sees them: taxels of each recording from their own frame.
            frame = chosen.no_contact if touches.no_contact is None else None
            if frame is not None and find_geometry(touches) in ("array", "none"):
                touches = chosen.resting_at(frame).touches(rows)
            return touches

    def like(self, recogniser: "ObjectRecogniser", path: Path) -> Self:
        """Return this, in colour where the model's pictures were and nothing is said.

        Archives, libraries, bags and Parquet say themselves what they hold.
        """
        from .._types import PICTURES, RGB

        pictures = kind_of(path) in ("film", "folder")
        pictures = pictures or path.suffix.lower() in PICTURES
        in_colour = tuple(recogniser.encoder_.channels_ or ()) == RGB
        if self.colour is None and in_colour and pictures:
            return replace(self, colour=True)
        return self

    def with_model(
        self, model: Path, path: Path, stage: Callable[[str], None]
    ) -> "tuple[ObjectRecogniser, Touches]":
        """Read a model, and touches as it has learnt them; `stage` takes what is read.

        Refuses touches in place of the model, and a model in place of touches.
        """
        from ..recognition import ObjectRecogniser

        if path.suffix == ".palpate" and model.suffix != ".palpate":
            raise WrongUse(
                f"MODEL must come first, then TOUCHES, got {model} {path}. Give them "
                f"as {path} {model}."
            )
        stage(f"reading {model}")
        recogniser = ObjectRecogniser.load(model_file(model))
        stage(f"reading {path}")
        return recogniser, self.like(recogniser, path).touches(path)

    def parts(self, path: Path, topic: str | None = None) -> "Iterator[Touches]":
        """Read touches to be kept, those of Parquet and libraries some at a time.

        The first are read at once, so that what is refused leaves nothing behind.
        """
        parts = self._parts(path, topic)
        return chain([next(parts)], parts)

    def _parts(self, path: Path, topic: str | None) -> "Iterator[Touches]":
        from ..touches import read_parquet

        kind = self._kind(path, topic)
        if kind == "library":  # each recording with what describes it
            with self.selection(path) as chosen:
                yield from chosen.parts()
        elif kind == "Parquet file":
            yield from read_parquet(path, max_pixels=self.max_pixels)
        else:
            yield self._recording(path, kind, topic)

    @contextmanager
    def selection(self, path: Path) -> Iterator[Any]:
        """Read touches to learn from; of a library or Parquet as they are needed."""
        from ..library import TouchLibrary
        from ..touches import ParquetTouches

        kind = self._kind(path)
        if kind == "library":
            with TouchLibrary.open(path) as library:
                library.refuse_unknown(self.where)
                yield library.select(self.where)
        elif kind == "Parquet file":
            yield ParquetTouches(path, max_pixels=self.max_pixels)
        else:
            yield self._recording(path, kind)

    @property
    def max_pixels(self) -> int:
        """Largest picture that is read."""
        from .._checks import check_positive

        most = MEGAPIXELS if self.max_megapixels is None else self.max_megapixels
        return int(check_positive("max_megapixels", most) * 1e6)

    def _kind(self, path: Path, topic: str | None = None, *, held: bool = False) -> str:
        """Return what is read; refuse options that say nothing of such a one.

        Parquet that is `held` is a file like others, else read as it is needed.
        """
        kind = kind_of(path, topic)
        read_as = "file" if held and kind == "Parquet file" else kind
        for name, (kinds, words) in _FOR.items():
            value = getattr(self, name)
            says = value is not None and value is not False
            if says and read_as not in kinds:
                raise ValueError(
                    f"--{name.replace('_', '-')} must be left out for a {kind} such as "
                    f"{path}, got {str(value)!r}. It is for {words}."
                )
        return kind

    def _recording(
        self, path: Path, kind: str, topic: str | None = None, *, quiet: bool = False
    ) -> "Touches":
        from ..library import read_bag
        from ..touches import Touches, TouchesError

        if kind == "bag":
            return read_bag(path, topic)
        if kind == "film":
            from ..sensors import TouchDetector

            rest, in_colour = self.no_contact, bool(self.colour)
            still = Touches.load(rest, colour=in_colour).images[0] if rest else None
            detector = TouchDetector(still, begin=self.begin)
            touches = detector.touches_in(path, colour=in_colour)
            say_limit(path, detector)
            return touches
        with catch_warnings(record=True) as left_out:
            simplefilter("always")
            try:
                read = Touches.load(path, **self._how())
            except TouchesError as error:
                if quiet or self.skip_bad or not path.is_dir():
                    raise
                typed = f"{quote(str(path))}{' --colour' * bool(self.colour)}"
                raise TouchesError(
                    f"{error} `palpate check {typed}` lists all that is wrong."
                ) from error
        for warning in () if quiet else left_out:
            say(warning.message, file=sys.stderr)
        return read

    def _how(self) -> dict[str, Any]:
        return {
            "name_pattern": self.name_pattern,
            "no_contact": self.no_contact,
            "levels": self.levels,
            "colour": bool(self.colour),
            "skip_bad": self.skip_bad,
            "shape": None if self.shape is None else _sides(self.shape),
            "dtype": self.dtype,
            "channels": None if self.channels is None else self.channels.split(","),
            "max_pixels": self.max_pixels,
        }


def _sides(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})[xX×](\d{1,5})", text.strip())
    if match is None:
        raise WrongUse(f"--shape must be rows x columns such as 16x16, got {text!r}.")
    return int(match[1]), int(match[2])


@dataclass(frozen=True)
class Working:
    """Where parallel work runs: this machine's processes or a Dask cluster."""

    PANEL: ClassVar[str] = "Where the work runs"

    workers: Annotated[
        int | None,
        option("Processes on this machine; -1 is one per core. Results do not change."),
    ] = None
    cluster: Annotated[
        str | None,
        option(
            "Address of a Dask scheduler, such as tcp://lab:8786; needs "
            + install("distributed")
        ),
    ] = None

    @contextmanager
    def started(self, usual: int | None = None) -> Iterator[int | None]:
        """Let joblib run its tasks where the options say.

        Yields the number of jobs to ask for: `workers`, where neither option is given
        `usual`, or -1 (all) on a cluster.
        """
        from joblib import parallel_config

        if self.cluster is None:
            workers = usual if self.workers is None else checked_workers(self.workers)
            with parallel_config("loky", n_jobs=workers):
                yield workers
            return
        if self.workers is not None:
            raise ValueError(
                "Give either --workers or --cluster, got both; a cluster has its own."
            )
        distributed = needed("distributed", "distributed", "--cluster")
        address = self.cluster
        try:
            client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise OSError(
                f"--cluster must be the address of a Dask scheduler, got {address}: "
                f"{error or 'no answer'}. Start one with `dask scheduler`, workers "
                "with `dask worker ADDRESS`."
            ) from error
        with client, parallel_config("dask"):
            if not client.scheduler_info()["workers"]:
                raise OSError(
                    f"The scheduler at {address} must have workers, got none. Start "
                    f"some with `dask worker {address}`."
                )
            yield -1


def grouped(verb: Callable[..., None]) -> Callable[..., None]:
    """Put the fields of a verb's groups of options on the command line.

    A parameter whose type is a dataclass stands for the dataclass's fields, each an
    option of its own; the verb gets them together again.
    """
    taken = signature(verb).parameters
    groups: dict[str, Any] = {
        n: p.annotation for n, p in taken.items() if is_dataclass(p.annotation)
    }
    flat: list[Parameter] = []
    for name, parameter in taken.items():  # those of a dataclass are its own fields
        group_options = _options_of(groups[name]) if name in groups else None
        flat += [
            p.replace(kind=Parameter.KEYWORD_ONLY) for p in group_options or [parameter]
        ]

    @wraps(verb)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            parts = {field.name: values.pop(field.name) for field in fields(group)}
            values[name] = group(**parts)
        verb(**values)

    run.__annotations__ = {p.name: p.annotation for p in flat}
    vars(run)["__signature__"] = Signature(flat)  # what Typer reads
    return run


def _options_of(group: Any) -> list[Parameter]:
    """Return the fields of a group as parameters, in the help under its `PANEL`."""
    parameters = []
    for parameter in signature(group).parameters.values():
        kind, info = get_args(parameter.annotation)
        shown = copy(info)
        shown.rich_help_panel = getattr(group, "PANEL", None)
        parameters.append(parameter.replace(annotation=Annotated[kind, shown]))
    return parameters


def calibrated(touches: "Touches", calibration: Path | None) -> "Touches":
    """Return touches in kPa by the calibration of their array, if one is given."""
    if calibration is None:
        return touches
    from ..images import TaxelCalibration
    from ..touches import Touches

    of_taxels = TaxelCalibration.load(calibration)
    whole = dict(touches.whole)
    if touches.no_contact is not None:
        whole["no_contact"] = of_taxels.transform(touches.no_contact[None])[0]
    return Touches(of_taxels.transform(touches.images), **touches.columns, **whole)
