"""Count what the house is made of: `structure.py [REVISION] [--json FILE]`.

Files, lines, docstrings, names (public, re-exported, vague), messages below `cli` that
speak its language, private imports of tests, import circles, and what one
`Belief.update`, `fit`, frame of a sensor and `TouchLibrary.add` go through. Without a
revision the tree is counted as it is.
"""

import argparse
import ast
import json
import re
import statistics
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path

from revisions import check_where, checked_out, python

# Words that say nothing of what they name: a reader must find out each time.
VAGUE = {
    *("found", "known", "one", "some", "said", "told", "mine", "own", "asked", "made"),
    *("every", "apart", "given"),
}
# What belongs on a command line: an option, or the command with a verb.
VERBS = (
    "learn|recognise|evaluate|study|simulate|explore|demo|serve|bench|doctor|benchmark|"
)
VERBS += "remount|sensor|data|check|library|live|record"
OF_COMMAND_LINE = re.compile(rf"(?<![\w'(-])--[a-z][a-z-]+|\bpalpate ({VERBS})\b")


def main() -> None:
    """Print the table, then the same as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("revision", nargs="?", help="default: the tree as it is")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--details", action="store_true", help="say which files")
    options = parser.parse_args()
    with checked_out(options.revision) as root:
        figures = {**counted(root), **calls_counted(root)}
        details = named(root)
    for name, value in figures.items():
        print(f"{name:40s} {value:>10}")
    if options.details:
        for name, lines in details.items():
            print(f"\n{name}:", *lines, sep="\n  ")
    print(json.dumps(figures))
    if options.json:
        options.json.write_text(json.dumps({**figures, **details}, indent=1) + "\n")


def counted(root: Path) -> dict[str, float]:
    """Return the counts that need nothing but the files."""
    files = sorted((root / "src").rglob("*.py"))
    lines = [len(path.read_text().splitlines()) for path in files]
    docstrings = sum(docstring_lines(path) for path in files)
    tests = list((root / "tests").rglob("*.py"))
    return {
        "files under src": len(files),
        "lines under src": sum(lines),
        "median lines of a file": statistics.median(lines),
        "docstrings, % of lines": round(100 * docstrings / sum(lines), 1),
        "public names": sum(map(len, public_names(root / "src" / "palpate").values())),
        "names re-exported without __all__": sum(
            map(len, reexported(root / "src" / "palpate").values())
        ),
        **words_counted(root / "src" / "palpate"),
        "test files": len(tests),
        "test files that import private modules": sum(map(imports_private, tests)),
        "import circles": len(import_circles(root / "src")),
        "import circles, imports in functions too": len(
            import_circles(root / "src", deferred=True)
        ),
    }


def named(root: Path) -> dict[str, list[str]]:
    """Return which files are behind the counts that should fall."""
    tests = sorted((root / "tests").rglob("*.py"))
    subpackages = public_names(root / "src" / "palpate")
    return {
        "private imports in": [
            str(path.relative_to(root)) for path in tests if imports_private(path)
        ],
        "circles": [
            " <-> ".join(circle)
            for circle in import_circles(root / "src", deferred=True)
        ],
        "public names of": [
            f"{subpackage}: {len(names)}" for subpackage, names in subpackages.items()
        ],
        "re-exported without __all__ by": [
            f"{subpackage}: {', '.join(names)}"
            for subpackage, names in reexported(root / "src" / "palpate").items()
        ],
        **words_named(root / "src" / "palpate"),
    }


def words_counted(package: Path) -> dict[str, float]:
    """Return how many names are vague, and how many messages name options or verbs."""
    names = [name for path in package.rglob("*.py") for name, _ in bound_names(path)]
    n_vague = sum(map(is_vague, names))
    return {
        "bound names": len(names),
        "vague names": n_vague,
        "vague names, % of bound ones": round(100 * n_vague / len(names), 2),
        "messages outside cli that name options": sum(
            len(list(messages_of_cli(path))) for path in outside_cli(package)
        ),
    }


def words_named(package: Path) -> dict[str, list[str]]:
    """Return where vague names are bound, by subpackage and file, and the messages."""
    subpackages: Counter[str] = Counter()
    files = []
    for path in sorted(package.rglob("*.py")):
        vague = [f"{n} {line}" for n, line in bound_names(path) if is_vague(n)]
        parts = path.relative_to(package).parts
        subpackages[parts[0] if len(parts) > 1 else "root"] += len(vague)
        if vague:
            files.append(f"{'/'.join(parts)}: {len(vague)}: {', '.join(vague)}")
    return {
        "vague names of": [
            f"{subpackage}: {n}" for subpackage, n in subpackages.most_common()
        ],
        "vague names, with their lines, in": files,
        "messages that name options or verbs in": [
            f"{path.relative_to(package)}:{line}: {' '.join(text.split())[:150]}"
            for path in outside_cli(package)
            for line, text in messages_of_cli(path)
        ],
    }


def outside_cli(package: Path) -> list[Path]:
    """Return the files of every subpackage but `cli`, in order."""
    return [
        path
        for path in sorted(package.rglob("*.py"))
        if path.relative_to(package).parts[0] != "cli"
    ]


def is_vague(name: str) -> bool:
    """Whether a name is one of the vague words, underscores aside."""
    return name.strip("_") in VAGUE


def bound_names(path: Path) -> Iterator[tuple[str, int]]:
    """Yield each name that a file binds, with its line; imports bind no new word."""
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Name(id=name, ctx=ast.Store()):
                yield name, node.lineno
            case ast.Attribute(attr=name, ctx=ast.Store()):
                yield name, node.lineno
            case ast.arg(arg=name) | ast.ExceptHandler(name=str(name)):
                yield name, node.lineno
            case (
                ast.FunctionDef(name=name)
                | ast.AsyncFunctionDef(name=name)
                | ast.ClassDef(name=name)
            ):
                yield name, node.lineno


def messages_of_cli(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the texts of a file, docstrings aside, that name an option or a verb."""
    tree = ast.parse(path.read_text())
    docstrings, parts = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            docstrings.add(node.value)
        elif isinstance(node, ast.JoinedStr):
            parts |= set(node.values)
    for node in ast.walk(tree):
        if node in docstrings or node in parts:
            continue
        if isinstance(node, ast.JoinedStr):
            text = "".join(getattr(part, "value", "{}") or "" for part in text_of(node))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        else:
            continue
        if OF_COMMAND_LINE.search(text):
            yield node.lineno, text


def text_of(node: ast.JoinedStr) -> Iterator[ast.Constant]:
    """Yield the parts of an f-string, "{}" for each value in it."""
    for part in node.values:
        yield part if isinstance(part, ast.Constant) else ast.Constant("{}")


def reexported(package: Path) -> dict[str, list[str]]:
    """Return what each subpackage re-exports from its files beside `__all__`."""
    public = public_names(package)
    subpackages = {}
    for path in sorted(package.glob("*/__init__.py*")):
        if path.suffix not in (".py", ".pyi"):
            continue
        names = [
            alias.asname or alias.name
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.ImportFrom) and node.level == 1
            for alias in node.names
            if not (alias.asname or alias.name).startswith("_")
        ]
        subpackage = path.parent.name
        hidden = sorted(
            {*names, *subpackages.get(subpackage, [])} - {*public.get(subpackage, [])}
        )
        if hidden:
            subpackages[subpackage] = hidden
    return subpackages


def docstring_lines(path: Path) -> int:
    """Count the lines of a file's docstrings."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return sum(
        node.body[0].end_lineno - node.body[0].lineno + 1
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, owners) and ast.get_docstring(node) is not None
    )


def public_names(package: Path) -> dict[str, list[str]]:
    """Return `__all__` of every subpackage, as it is written, without the root."""
    subpackages = {}
    for path in sorted(package.glob("*/__init__.py")):
        subpackage = ".".join(path.parent.relative_to(package).parts)
        for node in ast.parse(path.read_text()).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            if subpackage and any(getattr(t, "id", None) == "__all__" for t in targets):
                subpackages[subpackage] = list(ast.literal_eval(node.value))
    return subpackages


def imports_private(path: Path) -> bool:
    """Whether a test imports a module of palpate whose name starts with `_`.

    Or names one in a text, which is how one replaces what is inside.
    """
    nodes = [*ast.walk(ast.parse(path.read_text()))]
    texts = [n.value for n in nodes if isinstance(n, ast.Constant)]
    names = [text for text in texts if isinstance(text, str) and " " not in text]
    return any(
        part.startswith("_") and not part.startswith("__")
        for name in [*imported(nodes), *names]
        if name.split(".")[0] == "palpate"
        for part in name.split(".")
    )


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the full names that absolute imports bring, `from a import b` as a.b."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def import_circles(source: Path, *, deferred: bool = False) -> list[list[str]]:
    """Return the groups of modules that import each other, each group in order.

    Imports under `if TYPE_CHECKING:` do not count; those inside functions, and those
    that a stub has made when a name is first used, only if `deferred`; the stub of the
    root, which offers what imports it, never. `from . import x` is an import of x where
    x is a module.
    """
    modules = {module_name(path, source): path for path in source.rglob("*.py")}
    graph = {
        name: {
            target
            for part in (path, path.with_suffix(".pyi"))[
                : 1 + (deferred and "." in name)
            ]
            if part.is_file()
            for node in running(ast.parse(part.read_text()), deferred)
            for target in targets_of(node, name, path, modules)
            if target != name
        }
        for name, path in modules.items()
    }
    return sorted(sorted(group) for group in strongly_connected(graph))


def module_name(path: Path, source: Path) -> str:
    """Return the dotted name of a file; a package's is that of its folder."""
    parts = path.relative_to(source).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def running(node: ast.AST, deferred: bool) -> Iterator[ast.AST]:
    """Yield the imports below a node that run when the module is imported."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from running(ast.Module(child.orelse, []), deferred)
        elif deferred or not isinstance(child, functions):
            yield from running(child, deferred)


def targets_of(
    node: ast.AST, name: str, path: Path, modules: dict[str, Path]
) -> Iterator[str]:
    """Yield the modules of the package that one import statement runs."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in modules)
        return
    base = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    base = base[: len(base) - node.level + 1] if node.level else []
    module = ".".join([*base, *((node.module or "").split(".") if node.module else [])])
    for alias in node.names:
        inner = f"{module}.{alias.name}"
        if inner in modules:
            yield inner
        elif module in modules:
            yield module


def strongly_connected(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of two or more nodes that all reach each other."""
    reached = {node: reachable(node, graph) for node in graph}
    groups = {
        frozenset(other for other in reached[node] if node in reached[other])
        for node in graph
        if node in reached[node]
    }
    return [list(group) for group in groups]


def reachable(node: str, graph: dict[str, set[str]]) -> set[str]:
    """Return what can be reached from a node in one or more steps."""
    reached: set[str] = set()
    waiting = [node]
    while waiting:
        for other in graph[waiting.pop()] - reached:
            reached.add(other)
            waiting.append(other)
    return reached


def calls_counted(root: Path) -> dict[str, float]:
    """Return calls and files of what is called most, in a revision."""
    check_where(root)
    return json.loads(python(root, Path(__file__).resolve(), "--calls"))


def calls_profiled() -> dict[str, int]:
    """Count what one update, fit, frame of a sensor and add go through, each warm."""
    from palpate import Touches
    from palpate.library import TouchLibrary
    from palpate.recognition import ObjectRecogniser
    from palpate.sensors import Frame, TouchDetector

    touches = drawn(Touches)
    update = update_passed()
    fit = passed_through(lambda: ObjectRecogniser("default").fit(touches))
    detector = TouchDetector()
    detector.take_baseline([touches.images[0]] * 3)
    detector.update(Frame(touches.images[1], time_s=0.0, number=0))
    touching = Frame(touches.images[1], time_s=0.03, number=1)
    frame = passed_through(lambda: detector.update(touching))
    with (
        tempfile.TemporaryDirectory() as folder,
        TouchLibrary.open(folder, create=True) as library,
    ):
        library.add(touches[0:1])
        touch = touches[1:2]
        add = passed_through(lambda: library.add(touch))
    named = {"one update": update, "one fit": fit, "one live frame": frame}
    return {
        **{f"calls of {name}": len(files) for name, files in named.items()},
        **{f"files of {name}": len(set(files)) for name, files in named.items()},
        "calls of one add": len(add),
        "files of one add": len(set(add)),
        "changes of file of one update": sum(a != b for a, b in pairwise(update)),
    }


def update_passed() -> list[str]:
    """Return the file of each call of the second `Belief.update` of an episode."""
    from palpate import Touches
    from palpate.recognition import ObjectRecogniser

    touches = drawn(Touches)
    belief = ObjectRecogniser("default").fit(touches).start()
    belief.update(touches[0:1])
    touch = touches[1:2]
    return passed_through(lambda: belief.update(touch))


def passed_through(do: Callable[[], object]) -> list[str]:
    """Return the file of every function of palpate that is called on the way."""
    import palpate

    inside = str(Path(palpate.__file__).parent)
    files: list[str] = []

    def note(frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(inside):
            files.append(name)

    sys.setprofile(note)
    do()
    sys.setprofile(None)
    return files


def drawn(kind):
    """Draw touches of three objects: a bright disc with dents at wandering places."""
    import numpy as np

    rng = np.random.default_rng(0)
    row, col = np.mgrid[:60, :60] - 29.5
    disc = np.hypot(row, col) < 27
    images = []
    for number in range(36):
        y, x = rng.uniform(-8, 8, 2)
        width = 3 + 3 * (number % 3)
        dent = np.exp(-((row - y) ** 2 + (col - x) ** 2) / (2 * width**2))
        images.append(disc * (120 + 100 * dent) + rng.normal(0, 2, disc.shape) + 10)
    labels = [f"object {number % 3}" for number in range(36)]
    images = np.clip(images, 0, 255).astype(np.uint8)
    return kind(images, object=labels, geometry="dome")


if __name__ == "__main__":
    if sys.argv[1:] == ["--calls"]:
        print(json.dumps(calls_profiled()))
    else:
        main()
