"""Whether two revisions answer the same, to the bit: `same_figures.py BEFORE AFTER`.

    PALPATE_DATA=../data python benchmarks/same_figures.py v0.1.0 HEAD --json moved.json

The sets are `bathtip50` (10 objects, one of each category, learnt from 20 touches each;
the last 31 of each recording are asked; 5 objects unknown), `taxel10x10` (17 objects,
re-posed here), `tactip4` (40 touches of each of 4 shapes), and what each revision
simulates itself: 6 parts on an array and 4 objects before a dome. With the presets that
fit are compared: the figures of `palpate evaluate --json` (5 random orders, after 1, 5
and 10 touches), the answers of `palpate recognise --json`, and the posterior of a
`Belief` after each of ten single touches of each object. Times are left out, and words
are counted apart from figures. About ten minutes of CPU.
"""

import argparse
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from revisions import check_where, checked_out, python

N_TOUCHES = 10
UNKNOWN = 5
LAST = 31
SIMULATED = {
    "array": ["bar10", "hexagon13", "square13-hole8", "disc13", "hexagon10", "bar35"],
    "dome": ["mug", "box", "ball", "stapler"],
}
# name: presets, and the options of `palpate evaluate`.
SETS = {
    "bathtip50": (("default", "corradi2015"), ["--train-touches", "20"]),
    "taxel10x10": (("default", "liu2014"), ["--split", "between"]),
    "tactip4": (("default", "corradi2015"), ["--split", "between"]),
    "array": (("default", "liu2014"), ["--split", "between"]),
    "dome": (("default", "corradi2015"), ["--split", "between"]),
}
EVALUATE = ["--touches", "1,5,10", "--orders", "5", "--seed", "3", "--json"]


def main() -> None:
    """Run both, and print what moved; exit 1 when a figure did."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before")
    parser.add_argument("after", nargs="?", help="default: the tree as it is")
    parser.add_argument("--sets", help=f"of {','.join(SETS)}; default: all there are")
    parser.add_argument("--json", type=Path, help="write all that moved here")
    options = parser.parse_args()
    names = options.sets.split(",") if options.sets else list(SETS)
    figures = []
    for revision in (options.before, options.after):
        with tempfile.TemporaryDirectory() as folder, checked_out(revision) as root:
            check_where(root)
            figures.append(dict(flat(figures_of(root, Path(folder), names))))
    moved = compared(*figures)
    report(moved, len(figures[0]))
    if options.json:
        options.json.write_text(json.dumps(moved, indent=1) + "\n")
    sys.exit(1 if moved["figures"] else 0)


def figures_of(root: Path, folder: Path, names: list[str]) -> dict[str, Any]:
    """Return every figure of one revision, by set and preset."""
    figures: dict[str, Any] = {}
    for name in names:
        print(f"{name}...", file=sys.stderr, flush=True)
        if not (write_recorded(name, folder) or simulated(name, folder, root)):
            print(f"{name}: PALPATE_DATA does not hold it", file=sys.stderr)
            continue
        figures[name] = {"images": digest(folder / f"{name}.npz")}
        for preset in SETS[name][0]:
            figures[name][preset] = answers(name, preset, folder, root)
    return figures


def answers(name: str, preset: str, folder: Path, root: Path) -> dict[str, Any]:
    """Evaluate, learn, recognise, and ask a belief touch by touch."""
    train, model = f"{name}.npz", f"{name}-{preset}.palpate"
    options = ["--preset", preset, "--seed", "3"]
    test_options = ["--test", f"{name}-test.npz"] if made_apart(name, folder) else []
    unknown = ["--unknown", f"{name}-unknown.npz"] if test_options else []

    def palpate(*arguments: str) -> Any:
        output = python(root, "-m", "palpate", *arguments, "--json", folder=folder)
        return json.loads(output)

    evaluated = palpate(
        *["evaluate", "--train", train, *test_options, *unknown, *SETS[name][1]],
        *["--preset", preset, *EVALUATE[:-1]],
    )
    evaluated.pop("seconds")
    palpate("learn", train, "-o", model, *options)
    few = f"{name}-few.npz"
    write_few(folder / (test_options[1] if test_options else train), folder / few)
    episodes = palpate("recognise", model, few)["episodes"]
    output = python(
        root, Path(__file__).resolve(), "--beliefs", model, few, folder=folder
    )
    kept = ("object", "decision", "touches_used", "reasons")
    return {
        "evaluate": evaluated,
        "recognise": [
            {**{key: episode[key] for key in kept}, "beliefs": beliefs(episode)}
            for episode in episodes
        ],
        "belief": json.loads(output),
    }


def beliefs(episode: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the posterior and the unknown score after every touch."""
    return [
        {"posterior": belief["posterior"], "unknown": belief["unknown"]}
        for belief in episode["beliefs"]
    ]


def posteriors(model: str, archive: str) -> list[Any]:
    """Update a new belief with one touch at a time, for every object; no batches."""
    from palpate import Touches
    from palpate.recognition import ObjectRecogniser

    recogniser = ObjectRecogniser.load(model)
    touches = Touches.load(archive)
    objects = np.asarray(touches.columns["object"])
    updates = []
    for name in sorted(set(objects)):
        belief = recogniser.start()
        for row in np.flatnonzero(objects == name):
            belief.update(touches[int(row) : int(row) + 1])
            updates.append({"posterior": belief.posterior, "unknown": belief.unknown})
    return updates


def write_recorded(name: str, folder: Path) -> bool:
    """Write the archives of a recorded set; return False for another set."""
    data = Path(os.environ.get("PALPATE_DATA", "no-such-folder"))
    source = data / {"bathtip50": "bathtip"}.get(name, name) / f"{name}.npz"
    if not source.exists():
        return False
    with np.load(source) as archive:
        arrays = dict(archive)
    {"bathtip50": bathtip, "taxel10x10": taxels, "tactip4": tactip}[name](
        arrays, folder
    )
    return True


def bathtip(arrays: dict[str, Any], folder: Path) -> None:
    """Write 10 objects, one of each category; last touches and unknown ones apart."""
    objects, categories = arrays["object"], arrays["category"]
    by_kind = {kind: sorted(set(objects[categories == kind])) for kind in categories}
    learnt = [names[0] for _, names in sorted(by_kind.items())]
    strangers = [names[1] for _, names in sorted(by_kind.items())][:UNKNOWN]
    later = np.zeros(len(objects), bool)
    for name in learnt:
        rows = np.flatnonzero(objects == name)
        later[rows[np.argsort(arrays["order"][rows])][-LAST:]] = True
    is_learnt = np.isin(objects, learnt)
    parts = {
        "": is_learnt & ~later,
        "-test": later,
        "-unknown": np.isin(objects, strangers),
    }
    for suffix, chosen in parts.items():
        np.savez(
            folder / f"bathtip50{suffix}.npz",
            **{key: arrays[key][chosen] for key in ("images", "object", "category")},
            no_contact=arrays["no_contact"],
        )


def taxels(arrays: dict[str, Any], folder: Path) -> None:
    """Write the presses turned by any angle and shifted by up to two taxels."""
    rng = np.random.default_rng(10)
    posed = []
    for image in arrays["images"].astype(float):
        turned = ndimage.rotate(image, rng.uniform(0, 360), reshape=False, order=1)
        posed.append(ndimage.shift(turned, rng.uniform(-2, 2, 2), order=1))
    np.savez(
        folder / "taxel10x10.npz",
        images=np.stack(posed),
        object=arrays["object"],
        geometry="array",
    )


def tactip(arrays: dict[str, Any], folder: Path) -> None:
    """Write the first 40 touches of each shape."""
    objects = arrays["object"]
    chosen = [np.flatnonzero(objects == name)[:40] for name in sorted(set(objects))]
    rows = np.concatenate(chosen)
    np.savez(
        folder / "tactip4.npz", images=arrays["images"][rows], object=objects[rows]
    )


def simulated(name: str, folder: Path, root: Path) -> bool:
    """Let the revision itself simulate touches; False where it cannot."""
    if name not in SIMULATED:
        return False
    count = ["--presses", "16"] if name == "array" else ["--touches", "16"]
    common = ["-o", f"{name}.npz", *count, "--workers", "1", "--seed", "5"]
    python(
        root,
        "-m",
        "palpate",
        "simulate",
        name,
        *SIMULATED[name],
        *common,
        folder=folder,
    )
    return True


def made_apart(name: str, folder: Path) -> bool:
    """Whether test touches lie in an archive of their own."""
    return (folder / f"{name}-test.npz").exists()


def write_few(source: Path, target: Path) -> None:
    """Write the first ten touches of each object of an archive."""
    with np.load(source) as archive:
        arrays = dict(archive)
    objects = arrays["object"]
    firsts = [np.flatnonzero(objects == o)[:N_TOUCHES] for o in sorted(set(objects))]
    rows = np.concatenate(firsts)
    whole = {"no_contact", "geometry", "frame_index"}
    np.savez(
        target,
        **{
            key: value
            if key in whole
            or key.startswith("set_")
            or value.shape[:1] != objects.shape
            else value[rows]
            for key, value in arrays.items()
        },
    )


def digest(archive: Path) -> str:
    """Return a fingerprint of an archive's images."""
    with np.load(archive) as arrays:
        return hashlib.sha256(arrays["images"].tobytes()).hexdigest()


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, leaf) of nested dicts and lists."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from flat(inner, f"{name} / {key}" if name else str(key))
    else:
        yield name, value


def compared(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return the differences: figures, words, and names of one revision alone."""
    both = [name for name in before if name in after]
    moved = {name: [before[name], after[name]] for name in both}
    moved = {name: pair for name, pair in moved.items() if pair[0] != pair[1]}
    words = {name for name, pair in moved.items() if is_words(name, pair)}
    return {
        "figures": {name: pair for name, pair in moved.items() if name not in words},
        "words": {name: moved[name] for name in moved if name in words},
        "only before": sorted(set(before) - set(after)),
        "only after": sorted(set(after) - set(before)),
    }


def is_words(name: str, pair: list[Any]) -> bool:
    """Whether text differs that is no answer."""
    answer = name.endswith(("decision", "object", "images"))
    return not answer and all(isinstance(value, str) for value in pair)


def report(moved: dict[str, Any], n_compared: int) -> None:
    """Print the differences."""
    for kind in ("figures", "words"):
        for name, (old, new) in moved[kind].items():
            print(f"{name}: {old!r} -> {new!r}")
    for kind in ("only before", "only after"):
        if moved[kind]:
            print(f"{kind}: {len(moved[kind])}, such as {moved[kind][:5]}")
    n = len(moved["figures"])
    same = "the same to the bit" if n == 0 else f"{n} of them moved"
    print(f"{n_compared} values before: {same}; {len(moved['words'])} texts differ.")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--beliefs"]:
        print(json.dumps(posteriors(*sys.argv[2:])))
    else:
        main()
