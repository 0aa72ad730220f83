"""Draw speed beside peers, and cost against size: `speed_picture.py [--output DIR]`.

From `results.json`, which `make bench` measures. Left: how many times the CPU time of
ours a peer takes, in one run. Right: milliseconds of what a library does, over the
touches that are in it; the likelihoods are those of 71 features, one touch at a time.
"""

import argparse
import json
import re
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
# Of the rows of `palpate bench NAME`: the name's beginning, the peer, what is shown.
PEERS = [
    ("zernike", "300 x 300 float64 exact single", "mahotas", "Zernike: mahotas"),
    ("zernike", "300 x 300 float64 exact single", "centrosome", "Zernike: centrosome"),
    ("zernike", "300 x 300 float64 exact batch", "dense basis", "Zernike, 64: basis"),
    ("likelihood", "50 objects x 94", "scikit-learn", "densities: scikit-learn"),
    ("mkl", "12 x 10 touches 22 kernels", "MKLpy", "MKL: EasyMKL"),
    ("mkl", "12 x 10 touches 22 kernels", "22 SVC fits", "MKL: 22 SVC fits"),
    ("learning", "learning 10 objects", "scikit-learn", "learning 600: PCA + SVC"),
    ("learning", "learning 50 objects", "scikit-learn", "learning 4,500: PCA + SVC"),
    ("learning", "adding ten", "learning", "adding ten: learning all"),
    ("decode", "772", "Pillow", "reading JPEGs: Pillow"),
    ("library", "one touch added to 10,000", "numpy", "one touch stored: fsync"),
]
# What a library does: the end of a row's name, what is shown.
STORED = {
    "touches added, per touch (wall)": "adding many, a touch",
    "one touch added (wall)": "adding one, on the disk",
    "touches opened, 50 listed (wall)": "opening, listing 50",
    "touches opened, filtered by force (wall)": "opening, filtering all",
    "71 features, exact single": "likelihood, exact",
    "71 features, index single": "likelihood, index",
}


def main() -> None:
    """Draw both panels into `speed.png`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=HERE.parent / "docs" / "images")
    options = parser.parse_args()
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    plt.style.use(str(HERE.parent / "docs" / "palpate.mplstyle"))
    results = json.loads((HERE / "results.json").read_text(encoding="utf-8"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10.8, 4.4), layout="constrained"
    )
    draw_peers(left, results)
    draw_sizes(right, results)
    figure.savefig(options.output / "speed.png", dpi=120)


def draw_peers(place: Any, results: dict[str, Any]) -> None:
    """Draw the ratio of each peer; where a bench has several rows, the first."""
    ratios = {
        label: next(
            row["ratio"]
            for row in results[bench]["rows"]
            if row["name"].startswith(start) and row["peer"].startswith(peer)
        )
        for bench, start, peer, label in PEERS
    }
    lines = range(len(ratios), 0, -1)
    place.hlines(lines, 1, ratios.values(), lw=2)
    place.plot(ratios.values(), lines, "o")
    for line, ratio in zip(lines, ratios.values(), strict=True):
        place.annotate(
            f"{ratio:.2g}" if ratio < 100 else f"{ratio:,.0f}",
            (max(ratio, 1), line),
            (8, -4),
            textcoords="offset points",
            fontsize="small",
        )
    place.axvline(1, color="#5a6572", lw=1)
    place.set_yticks(lines, ratios)
    place.set(xscale="log", xlim=(0.5, 1e4), title="peer, times the CPU time of ours")


def draw_sizes(place: Any, results: dict[str, Any]) -> None:
    """Draw milliseconds over the number of touches in the library."""
    times: dict[str, dict[int, float]] = {label: {} for label in STORED.values()}
    for bench in ("library", "library-large"):
        for row in results[bench]["rows"]:
            size = int(re.findall(r"\d[\d,]+", row["name"])[0].replace(",", ""))
            name = re.sub(r" to [\d,]+", "", row["name"])
            for end, label in STORED.items():
                if name.endswith(end):
                    times[label][size] = row["ours_ms"]
    for (label, by_size), marker in zip(times.items(), "os^Dvx", strict=True):
        place.plot([*by_size], [*by_size.values()], marker=marker, label=label)
    place.set(xscale="log", yscale="log", xlabel="touches in the library", title="ms")
    place.set_ylim(1e-2, 3e6)
    place.legend(fontsize="small", loc="upper left", ncols=2)


if __name__ == "__main__":
    main()
