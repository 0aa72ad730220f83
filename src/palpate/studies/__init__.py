"""The papers' experiments: each study prints the paper's figures beside ours.

`Study` is the frame of all: a plan, touches, a run, and a result for people (tables,
pictures, a page). A study's subpackage, imported when the study is first used, has what
differs from paper to paper: its `PLAN`, a class; `measure(plan, data, work)`, which
returns `rows`, `skipped` and what else the result holds; `tables`, `pictures` and the
`introduction` of its page, made of a result; its `TITLE` and, by picture, the
`CAPTIONS`, whose first line says what it is and is its alt text. matplotlib is the
extra `plot`, imported where it is used. Figures are in per cent.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from html import escape
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import _parallel
from .._checks import check_count, check_option
from .._durable import replacing, write_text
from .._types import Indices
from ..datasets import where
from ..touches import Touches

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Codes = Indices
Row = dict[str, Any]
# A title, the names of the columns, and lines of text.
Table = tuple[str, list[str], list[list[str]]]
Figures = dict[str, "Figure"]
Value = TypeVar("Value")


@dataclass(frozen=True)
class Plan:
    """Sizes of a study; the defaults are the whole of it, `first_look` is --quick."""

    seed: int = 0
    first_look: ClassVar[Mapping[str, Any]] = {}

    @classmethod
    def quick(cls, **changes: Any) -> Self:
        """Return the plan of a first look, with changes."""
        return cls(**{**cls.first_look, **changes})

    def check_counts(self, *names: str, at_least: int = 1) -> None:
        """Refuse sizes, or lists of sizes, that are no whole numbers or too small."""
        for name in names:
            value = getattr(self, name)
            for number in value if isinstance(value, tuple | list) else (value,):
                check_count(name, number, at_least=at_least)


@dataclass(frozen=True)
class Work:
    """The way tasks of a study are done: by so many processes, with a bar or not."""

    workers: int = -1
    progress: bool | None = None

    def done(
        self, function: Callable[..., Any], tasks: Sequence[Iterable[Any]], what: str
    ) -> list[Any]:
        """Return `function(*task)` of each, on one thread so that sums round alike."""
        alone = [(function, *task) for task in tasks]
        return _parallel.in_parallel(
            on_one_thread, alone, what, n_jobs=self.workers, show=self.progress
        )


def fitted(model: Any, *training: Any) -> Any:
    """Return `model.fit(*training)`, converged or not."""
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(*training)


def on_one_thread(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return `function(*arguments)`, its linear algebra on one thread."""
    with _parallel.on_one_thread():
        return function(*arguments)


@dataclass(frozen=True)
class Study:
    """A paper's experiment: its name, what it is about, and how it is run."""

    name: str
    summary: str

    def run(
        self,
        *,
        data: str | Path | None = None,
        quick: bool = False,
        workers: int = -1,
        seed: int = 0,
        progress: bool | None = None,
        plan: Plan | None = None,
        **changes: Any,
    ) -> dict[str, Any]:
        """Run the study, on recorded touches too if `data` or PALPATE_DATA names them.

        `quick` is a first look: few repetitions, small grids. `workers` are processes
        as joblib counts them; but for timings no figure depends on it. `seed` is that
        of everything drawn: touches, poses, halves, partitions. `progress` shows a bar
        on standard error, by default where it is a terminal. `changes` are entries of
        the plan, such as the `protocol` of "liu2014"; a whole `plan` takes the place of
        `quick`, `seed` and `changes`.

        Returns `study`; `rows`, each with `name`, `paper` (or None), `ours`, `sd`,
        `data`, `table` and what else tells it from the others, in per cent unless
        `unit` says otherwise; `skipped`, a sentence for each kind of rows that is
        missing; what the study adds (`paired`, `duplicates`; `confusion`, `unseen`);
        `plan`; `seconds`.

        Raises ValueError for an option that the study does not have, a size that makes
        no sense, or a folder without the recorded touches.
        """
        if plan is None:
            plan_class: type[Plan] = self._subpackage.PLAN
            options = ["data", "quick", "workers", "progress", "plan"]
            options += [field.name for field in fields(plan_class)]
            for option in changes:
                if option not in options:
                    raise ValueError(
                        f"options of the study {self.name} must be among "
                        f"{', '.join(options)}, got {option!r}. Leave it out."
                    )
            changes["seed"] = seed
            plan = plan_class.quick(**changes) if quick else plan_class(**changes)
        if workers != -1:
            check_count("workers", workers)
        started = time.perf_counter()
        measured = self._subpackage.measure(plan, data, Work(workers, progress))
        return {
            "study": self.name,
            **measured,
            "plan": asdict(plan),
            "seconds": time.perf_counter() - started,
        }

    def tables(self, result: dict[str, Any]) -> list[Table]:
        """Return what a person reads of a result: (title, columns, rows of text)."""
        return [table for table in self._subpackage.tables(result) if table[2]]

    def write_report(self, path: str | Path, result: dict[str, Any]) -> Path:
        """Write tables and pictures as one `.html` that loads nothing else."""
        from .._page import check_report_path, html_table, report_page, svg

        subpackage = self._subpackage
        target = check_report_path(path)
        sections = [f"<h1>{escape(subpackage.TITLE)}</h1>"]
        sections.append(f"<p>{escape(subpackage.introduction(result))}</p>")
        for name, figure in subpackage.pictures(result).items():
            what, _, more = subpackage.CAPTIONS[name].partition("\n")
            drawn = f"<div>{svg(figure, what)}</div>"
            below = f"<figcaption><b>{escape(what)}.</b> {escape(more)}</figcaption>"
            inches = f"style='--inches:{figure.get_figwidth():g}'"
            sections.append(f"<figure {inches}>{drawn}{below}</figure>")
        sections += [html_table(*table) for table in self.tables(result)]
        write_text(target, report_page(subpackage.TITLE, sections))
        return target

    def write_pictures(self, folder: str | Path, result: dict[str, Any]) -> list[Path]:
        """Write the pictures as `<study>-<name>.png` into an existing folder."""
        written = []
        for name, figure in self._subpackage.pictures(result).items():
            written.append(Path(folder) / f"{self.name}-{name}.png")
            with replacing(written[-1]) as file:
                figure.savefig(file, format="png", dpi=100)
        return written

    @property
    def _subpackage(self) -> Any:
        return import_module(f"{__package__}.{self.name}")


STUDIES: dict[str, Study] = {
    "corradi2014": Study("corradi2014", "seven shapes before a dome camera"),
    "corradi2015": Study("corradi2015", "ten objects before a dome camera"),
    "liu2014": Study("liu2014", "twelve metal parts on a 10 x 10 pressure array"),
    "sessions": Study("sessions", "taught in some sessions, asked in another"),
}


def run_study(name: str, **options: Any) -> dict[str, Any]:
    """Run the study called `name`, with `options` as `Study.run` has them.

    Raises
    ------
    ValueError
        There is no such study, or it has no such option; the message lists them.
    """
    study: Study = STUDIES[check_option("study", name, STUDIES)]
    return study.run(**options)


class Archive(NamedTuple):
    """Recorded touches: their place in the folder (of a set of that name), and what."""

    place: Path
    what: str


BATHTIP = Archive(Path("bathtip") / "bathtip50.npz", "a real dome camera")


def recorded_touches(data: str | Path | None, archive: Archive) -> Touches | str:
    """Return the touches of an archive, or the sentence that says what is left out.

    They are in `palpate.datasets.where(data)`; a ValueError says that a folder given by
    name does not hold them.
    """
    place, what = archive
    path = where(data) / place
    if path.is_file():
        return Touches.load(path)
    name = archive.place.parts[0]
    if data is not None:
        raise ValueError(
            f"data must name a folder that holds {place}, got {data}. Call "
            f"`fetch({name})` with that folder, or leave `data` out."
        )
    return (
        f"The rows of {what} ({place.stem}) are left out: {where()} has no {place}. "
        f"Call `fetch({name})`, or name their folder with `data` or PALPATE_DATA."
    )


def labels(touches: Touches, column: str = "object") -> NDArray[np.str_]:
    """Return the object, or category, of every touch; refuse touches without."""
    column_labels: NDArray[np.str_] | None = getattr(touches, column)
    if column_labels is None:
        raise ValueError(
            f"The touches must have a column {column!r}, got {touches!r}. Label them."
        )
    return column_labels


def coded(touches: Touches, column: str = "object") -> Codes:
    """Return labels as numbers, in the order of their names, shape (n_touches,)."""
    return np.unique(labels(touches, column), return_inverse=True)[1]


def held(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Return the rows that have these entries."""
    return [r for r in rows if all(r.get(k) == v for k, v in wanted.items())]


def pick(rows: Iterable[Row], **wanted: Any) -> Row | None:
    """Return the first row that has these entries, or None."""
    return next(iter(held(rows, **wanted)), None)


def unique(values: Iterable[Value]) -> list[Value]:
    """Return different values in the order in which they come first."""
    return list(dict.fromkeys(values))


def different(rows: Iterable[Row], *keys: str) -> list[tuple[Any, ...]]:
    """Return the different combinations of these entries, in their order."""
    return unique(tuple(row[key] for key in keys) for row in rows)


def spread(values: Any) -> float | None:
    """Return the standard deviation (n - 1) of an array; None for a single value."""
    return float(values.std(ddof=1)) if len(values) > 1 else None


def row(
    name: str,
    ours: float,
    sd: float | None = None,
    paper: float | None = None,
    **facts: Any,
) -> Row:
    """Return what every row has, then `facts` that tell it from the others."""
    return {"name": name, "paper": paper, "ours": float(ours), "sd": sd, **facts}


def mean_row(name: str, values: Any, paper: float | None = None, **facts: Any) -> Row:
    """Return `row` of an array's mean and standard deviation."""
    return row(name, values.mean(), spread(values), paper, **facts)


def cell(row: Row | None, digits: int = 1, between: str = " ± ") -> str:
    """Return mean and, unless `between` is empty, standard deviation; or a dash."""
    if row is None:
        return "-"
    shown = [row[key] for key in ("ours", "sd") if row[key] is not None]
    shown = shown if between else shown[:1]
    return between.join(f"{value:.{digits}f}" for value in shown)


def paper(row: Row | None, frame: str = "{}") -> str:
    """Return the paper's figure in a frame such as " ({})", or nothing."""
    figure = None if row is None else row["paper"]
    return "" if figure is None else frame.format(f"{figure:g}")


def with_paper(row: Row | None, digits: int = 1) -> str:
    """Return mean and standard deviation, the paper's figure in brackets."""
    return cell(row, digits) + paper(row, " ({})")


def pivot(
    rows: Iterable[Row],
    keys: Sequence[str],
    columns: Iterable[Row],
    show: Callable[[Row | None], str],
    names: Mapping[str, str] = MappingProxyType({}),
) -> list[list[str]]:
    """Return lines: a combination of the entries `keys`, then a cell per column."""
    rows, columns, lines = list(rows), list(columns), []
    for values in different(rows, *keys):
        rows_of_line = held(rows, **dict(zip(keys, values, strict=True)))
        cells = [show(pick(rows_of_line, **column)) for column in columns]
        lines.append([*(names.get(key, key) for key in values), *cells])
    return lines


__all__ = ["run_study"]
