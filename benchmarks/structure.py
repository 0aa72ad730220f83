"""Count what the house is made of: `structure.py [REVISION] [--json FILE]`.

Files, lines, docstrings, public names, private imports of tests, import circles, and
what one `Belief.update` goes through. Without a revision the tree is counted as it is.
"""

import argparse
import ast
import json
import statistics
import sys
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

from revisions import check_where, checked_out, python


def main() -> None:
    """Print the table, then the same as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("revision", nargs="?", help="default: the tree as it is")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--details", action="store_true", help="say which files")
    given = parser.parse_args()
    with checked_out(given.revision) as root:
        figures = {**counted(root), **update_counted(root)}
        details = named(root)
    for name, value in figures.items():
        print(f"{name:40s} {value:>10}")
    if given.details:
        for name, lines in details.items():
            print(f"\n{name}:", *lines, sep="\n  ")
    print(json.dumps(figures))
    if given.json:
        given.json.write_text(json.dumps({**figures, **details}, indent=1) + "\n")


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
    rooms = public_names(root / "src" / "palpate")
    return {
        "private imports in": [
            str(path.relative_to(root)) for path in tests if imports_private(path)
        ],
        "circles": [
            " <-> ".join(circle)
            for circle in import_circles(root / "src", deferred=True)
        ],
        "public names of": [f"{room}: {len(names)}" for room, names in rooms.items()],
    }


def docstring_lines(path: Path) -> int:
    """Count the lines of a file's docstrings."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return sum(
        node.body[0].end_lineno - node.body[0].lineno + 1
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, owners) and ast.get_docstring(node) is not None
    )


def public_names(package: Path) -> dict[str, list[str]]:
    """Return `__all__` of every room, as it is written; the root is no room."""
    rooms = {}
    for path in sorted(package.glob("*/__init__.py")):
        room = ".".join(path.parent.relative_to(package).parts)
        for node in ast.parse(path.read_text()).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            if room and any(getattr(t, "id", None) == "__all__" for t in targets):
                rooms[room] = list(ast.literal_eval(node.value))
    return rooms


def imports_private(path: Path) -> bool:
    """Whether a test imports a module of palpate whose name starts with `_`."""
    return any(
        part.startswith("_") and not part.startswith("__")
        for name in imported(ast.walk(ast.parse(path.read_text())))
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
    found: set[str] = set()
    waiting = [node]
    while waiting:
        for other in graph[waiting.pop()] - found:
            found.add(other)
            waiting.append(other)
    return found


def update_counted(root: Path) -> dict[str, float]:
    """Return calls, files and changes of file of one `Belief.update` of a revision."""
    check_where(root)
    return json.loads(python(root, Path(__file__).resolve(), "--update"))


def update_profiled() -> dict[str, int]:
    """Run the second `Belief.update` of an episode and count what is called."""
    import palpate
    from palpate import Touches
    from palpate.recognition import ObjectRecogniser

    inside = str(Path(palpate.__file__).parent)
    touches = drawn(Touches)
    belief = ObjectRecogniser("default").fit(touches).start()
    belief.update(touches[0:1])
    files: list[str] = []

    def note(frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(inside):
            files.append(name)

    one = touches[1:2]
    sys.setprofile(note)
    belief.update(one)
    sys.setprofile(None)
    changes = sum(a != b for a, b in pairwise(files))
    return {
        "calls of one update": len(files),
        "files of one update": len(set(files)),
        "changes of file of one update": changes,
    }


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
    if sys.argv[1:] == ["--update"]:
        print(json.dumps(update_profiled()))
    else:
        main()
