"""Make one small fault at a time in a subpackage and see whether its tests find it.

`python benchmarks/mutants.py [-n 24] [--seed 0] [SUBPACKAGE or MODULE ...]`, by the
names of `CORE`. A mutant lives in a copy of the sources that only its tests import.
Asked are the tests of its module alone; what others would find does not count.
"""

import argparse
import ast
import copy
import importlib
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Each file and the tests that should find a fault in it, fast ones first: those of its
# subpackage unless another is named.
CORE = {
    "recognition/_belief.py": "belief beside_touch recogniser",
    "recognition/_calibration.py": "calibration strangers beside_touch fair_weight",
    "recognition/_contact.py": "contact",
    "recognition/_evidence.py": "calibration belief beside_touch recogniser",
    "recognition/_memory.py": "memory belief recogniser",
    "recognition/_model_checks.py": "hostile_models model_file",
    "recognition/_remounting.py": "remounting",
    "recognition/_strangers.py": "strangers calibration recogniser",
    "classifiers/_encoding_pool.py": "encoding_pool touch_classifier",
    "classifiers/_landmarks.py": "kernel_ridge landmarks",
    "classifiers/_ridge.py": "kernel_ridge landmarks nearby",
    "classifiers/_kernel_density.py": "kernel_density touch_classifier",
    "classifiers/_kernel_density_index.py": "kernel_density_index",
    "classifiers/_kernel_ridge.py": "kernel_ridge landmarks touch_classifier",
    "classifiers/_touch_classifier.py": "touch_classifier",
    "library/_adding.py": "touch_library library_store library_reading",
    "library/_changes.py": "library_changes touch_library library_store",
    "library/_content.py": "touch_library library_store library_reading",
    "library/_exchange.py": "lerobot_contents library_export",
    "library/_migrating.py": "library_migrating",
    "library/_reading.py": "library_reading touch_library library_learning",
    "library/_rows.py": "touch_library library_store library_reading",
    "library/_store.py": "touch_library library_store library_changes "
    "library_durability",
    "library/_upkeep.py": "library_changes library_store library_altered "
    "library_durability",
    "library/_where.py": "library_where",
    "touches/_archive.py": "touch_archive touch_archive_hostile",
    "touches/_columns.py": "touches_set touch_archive touches_channels "
    "touch_archive_hostile",
    "touches/_folder.py": "touch_folder touch_labels",
    "touches/_parquet.py": "library/library_export",
    "touches/_pictures.py": "touch_pictures touch_folder",
    "touches/_touches.py": "touches_set touches_channels touch_archive",
    "exploration/_guarded.py": "guard_bounds guarded_touch force_limit faulty_arms",
    "exploration/_ways.py": "hemisphere explore faulty_arms",
    "exploration/_robot.py": "simulated_robot faulty_arms",
    "exploration/_record.py": "episode_log explore",
    "exploration/_strategies.py": "hemisphere next_touch",
    "exploration/_touch_map.py": "touch_map placed_belief next_touch",
    "sensors/_serial.py": "framing serial_array",
    "sensors/_detector.py": "touch_detector sensor_health films",
    "sensors/_health.py": "sensor_health",
    "sensors/_contract.py": "live_contract",
    "web/_request_guard.py": "web_limits web_guard",
    "web/_images.py": "web_images web_api web_session",
    "web/_teaching.py": "web_limits web_quality web_objects web_session",
    "web/_sensor_watch.py": "web_watching web_session",
    "evaluation/_trial.py": "metrics",
    "evaluation/_splits.py": "splits benchmark",
    "evaluation/_comparisons.py": "controls",
    "evaluation/_evaluate.py": "advice",
}
# Packages that take long to import: they are imported once, not for each mutant.
HEAVY = (
    "numpy",
    "scipy.stats",
    "sklearn.svm",
    "sklearn.utils.estimator_checks",
    "cv2",
    "PIL.Image",
    "pytest",
    "safetensors.numpy",
)
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
CPU_LIMIT_S = 90
TIME_LIMIT_S = 3600  # for a mutant that waits for ever; the machine may be busy


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
        elif isinstance(node, ast.Return) and not _is_none(node.value):
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


def is_found(source, name):
    """Whether the tests of a module fail, or take too long, with these sources."""
    child = os.fork()
    if child == 0:
        _try_tests(source, name)
    end = time.monotonic() + TIME_LIMIT_S
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return status != 0
        time.sleep(0.05)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def tests_of(name):
    """Return the files of tests that should find a fault in a file of `CORE`."""
    for test in CORE[name].split():
        folder, _, stem = test.rpartition("/")
        yield ROOT / "tests" / (folder or name.split("/")[0]) / f"test_{stem}.py"


def _try_tests(source, name):
    """Run the tests of a module, say by the exit code whether they passed, and end."""
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
    os.chdir(ROOT)
    silent = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silent, stream)
    os.environ["PYTHONPATH"] = str(source)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # they take 3 s to import
    sys.path.insert(0, str(source))
    options = ["-q", "-x", "-m", "not slow and not realdata", "-p", "no:cacheprovider"]
    try:
        code = sys.modules["pytest"].main([*options, *map(str, tests_of(name))])
    except BaseException:
        code = 1
    os._exit(int(code))


def tried(subpackage, n_mutants, chance):
    """Return how many faults were tried and how many found; print the others."""
    listed = [
        (name, number, kind)
        for name in CORE
        if name.startswith(subpackage)
        for number, kind in faults(ast.parse(_text(name)))
    ]
    chosen = chance.sample(listed, min(n_mutants, len(listed)))
    outcomes = Counter()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "src", Path(folder) / "src")
        for name in {name for name, _, _ in chosen}:
            if is_found(Path(folder) / "src", name):
                raise SystemExit(f"The tests of {name} must pass without a fault.")
        for name, number, kind in chosen:
            mutant, where = with_fault(ast.parse(_text(name)), number, kind)
            file = Path(folder) / "src/palpate" / name
            file.write_text(ast.unparse(mutant))
            is_there = is_found(Path(folder) / "src", name)
            file.write_text(_text(name))
            outcomes[is_there] += 1
            if not is_there:
                print(f"  not found: {name}:{where}", flush=True)
    print(f"{subpackage}: {outcomes[True]} of {len(chosen)}", flush=True)
    return len(chosen), outcomes[True]


def _is_none(node):
    return node is None or (isinstance(node, ast.Constant) and node.value is None)


def _text(name):
    return (ROOT / "src/palpate" / name).read_text()


def main():
    """Try faults in the subpackages or modules that were named, or in all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    subpackages = list(dict.fromkeys(name.split("/")[0] for name in CORE))
    parser.add_argument(
        "subpackages", nargs="*", default=subpackages, metavar="SUBPACKAGE"
    )
    parser.add_argument("-n", type=int, default=24, help="faults in each subpackage")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in HEAVY:
        importlib.import_module(name)
    results = [
        tried(subpackage, options.n, random.Random(f"{options.seed} {subpackage}"))
        for subpackage in options.subpackages
    ]
    n_tried, n_found = map(sum, zip(*results, strict=True))
    print(f"found {n_found} of {n_tried} ({n_found / n_tried:.0%})")


if __name__ == "__main__":
    main()
