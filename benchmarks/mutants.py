"""Make one small fault at a time in a module and see whether its tests find it.

`python benchmarks/mutants.py [-n 40] [--seed 0] [MODULE ...]`, modules by the names of
`CORE`. A mutant lives in a copy of the sources that only its tests import.
"""

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Each file and the tests that are asked to find a fault in it.
CORE = {
    "recognition/_belief.py": "recognition/test_sequence.py",
    "recognition/_memory.py": "recognition/test_memory.py",
    "recognition/_model_checks.py": "recognition/test_hostile_models.py",
    "classifiers/_kernel_ridge.py": "classifiers/test_kernel_ridge.py "
    "classifiers/test_growth.py",
    "touches/_pictures.py": "touches/test_touch_pictures.py",
    "touches/_columns.py": "touches/test_touches_set.py touches/test_touch_archive.py",
    "exploration/_guarded.py": "exploration/test_guarded_touch.py "
    "exploration/test_force_limit.py",
}
_SWAPS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
TIME_LIMIT_S = 90


def faults(tree):
    """Yield functions that make one fault each in a copy of a tree, by node number."""
    for number, node in enumerate(ast.walk(tree)):
        if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in _SWAPS:
            yield number, "operator"
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPS:
            yield number, "comparison"
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
            yield number, "constant"
        elif isinstance(node, ast.If | ast.IfExp):
            yield number, "condition"
        elif isinstance(node, ast.Return) and node.value is not None:
            yield number, "answer"


def with_fault(tree, number, kind):
    """Return a copy of the tree with one fault, and where it is, in words."""
    tree = copy.deepcopy(tree)
    node = next(n for k, n in enumerate(ast.walk(tree)) if k == number)
    before = ast.unparse(node).splitlines()[0]
    if kind == "operator":
        node.op = _SWAPS[type(node.op)]()
    elif kind == "comparison":
        node.ops[0] = _SWAPS[type(node.ops[0])]()
    elif kind == "constant":
        flipped = isinstance(node.value, bool)
        node.value = not node.value if flipped else node.value + 1
    elif kind == "condition":
        node.test = ast.UnaryOp(ast.Not(), node.test)
    else:
        node.value = ast.Constant(None)
    after = ast.unparse(ast.fix_missing_locations(tree)) and ast.unparse(node)
    return tree, f"{node.lineno}: {before} -> {after.splitlines()[0]}"


def is_found(source, tests):
    """Whether tests fail, or take too long, with the sources in a folder."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-m",
        "not slow and not realdata",
    ]
    command += ["-p", "no:cacheprovider", *(f"tests/{name}" for name in tests.split())]
    env = {**os.environ, "PYTHONPATH": str(source)}
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=env, capture_output=True, timeout=TIME_LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def tried(name, n_mutants, chance):
    """Return how many faults of one file were tried and found; print the others."""
    text = (ROOT / "src/palpate" / name).read_text()
    tree = ast.parse(text)
    listed = list(faults(tree))
    chosen = chance.sample(listed, min(n_mutants, len(listed)))
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "src", Path(folder) / "src")
        file = Path(folder) / "src/palpate" / name
        if is_found(Path(folder) / "src", CORE[name]):
            raise SystemExit(f"The tests of {name} must pass without a fault.")
        for number, kind in chosen:
            mutant, where = with_fault(tree, number, kind)
            file.write_text(ast.unparse(mutant))
            if is_found(Path(folder) / "src", CORE[name]):
                found += 1
            else:
                print(f"  not found: {name}:{where}", flush=True)
    print(f"{name}: {found} of {len(chosen)}", flush=True)
    return len(chosen), found


def main():
    """Try faults in the modules that were named, or in all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=list(CORE), metavar="MODULE")
    parser.add_argument("-n", type=int, default=8, help="faults in each module")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    results = [
        tried(name, given.n, random.Random(f"{given.seed} {name}"))
        for name in given.modules
    ]
    n_tried, n_found = map(sum, zip(*results, strict=True))
    print(f"found {n_found} of {n_tried} ({n_found / n_tried:.0%})")


if __name__ == "__main__":
    main()
