"""What the papers' studies have in common: a plan, a run, and what is made of it.

A study's subpackage has an `EXPERIMENT` that says what differs from paper to paper;
it is imported when the study is first used.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Self

from threadpoolctl import threadpool_limits

from .._checks import check_count
from .._durable import replacing
from .._parallel import in_parallel
from ._report import Figures, Table, write_page


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
    """How the tasks of a study are done: by so many processes, with a bar or not."""

    workers: int = -1
    progress: bool | None = None

    def done(
        self, function: Callable[..., Any], tasks: Sequence[Iterable[Any]], what: str
    ) -> list[Any]:
        """Return `function(*task)` of each, on one thread so that sums round alike."""
        alone = [(function, *task) for task in tasks]
        return in_parallel(
            on_one_thread, alone, what, n_jobs=self.workers, show=self.progress
        )


def fitted(model: Any, *known: Any) -> Any:
    """Return `model.fit(*known)`, converged or not."""
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(*known)


def on_one_thread(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return `function(*arguments)`, its linear algebra on one thread."""
    with threadpool_limits(limits=1):
        return function(*arguments)


@dataclass(frozen=True)
class Experiment:
    """What a paper's subpackage brings; `captions` are those of the pictures, by name.

    `measure(plan, data, work)` returns `rows`, `skipped` and what else the result
    holds; `tables`, `pictures` and the `introduction` of its page are made of it.
    """

    plan: type[Plan]
    measure: Callable[[Any, str | Path | None, Work], dict[str, Any]]
    tables: Callable[[dict[str, Any]], list[Table]]
    pictures: Callable[[dict[str, Any]], Figures]
    introduction: Callable[[dict[str, Any]], str]
    title: str
    captions: Mapping[str, str]


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
        settled = self._plan(quick, {"seed": seed, **changes}) if plan is None else plan
        if workers != -1:
            check_count("workers", workers)
        started = time.perf_counter()
        measured = self._experiment.measure(settled, data, Work(workers, progress))
        return {
            "study": self.name,
            **measured,
            "plan": asdict(settled),
            "seconds": time.perf_counter() - started,
        }

    def tables(self, result: dict[str, Any]) -> list[Table]:
        """Return what a person reads of a result: (title, columns, rows of text)."""
        return self._experiment.tables(result)

    def write_report(self, path: str | Path, result: dict[str, Any]) -> Path:
        """Write tables and pictures as one `.html` that loads nothing else."""
        from ..evaluation import check_report_path

        one = self._experiment
        target = check_report_path(path)
        figures = {
            one.captions[name]: figure for name, figure in one.pictures(result).items()
        }
        words = (one.title, one.introduction(result))
        return write_page(target, *words, one.tables(result), figures)

    def write_pictures(self, folder: str | Path, result: dict[str, Any]) -> list[Path]:
        """Write the pictures as `<study>-<name>.png` into an existing folder."""
        from ..evaluation import plots

        plots.require_matplotlib()
        written = []
        for name, figure in self._experiment.pictures(result).items():
            written.append(Path(folder) / f"{self.name}-{name}.png")
            with replacing(written[-1]) as file:
                figure.savefig(file, format="png", dpi=100)
        return written

    @property
    def _experiment(self) -> Experiment:
        found: Experiment = import_module(f"{__package__}.{self.name}").EXPERIMENT
        return found

    def _plan(self, quick: bool, changes: dict[str, Any]) -> Plan:
        plan = self._experiment.plan
        known = ["data", "quick", "workers", "progress", "plan"]
        known += [field.name for field in fields(plan)]
        for option in changes:
            if option not in known:
                raise ValueError(
                    f"options of the study {self.name} must be among "
                    f"{', '.join(known)}, got {option!r}. Leave it out."
                )
        return plan.quick(**changes) if quick else plan(**changes)
