"""Damage JPEGs by chance and count the outcomes of reading them.

`python benchmarks/jpeg_damage.py [-n 3000] [--seed 0]` alters pictures of the dome as
its camera wrote them, anywhere in the file, and reads each with `decode_bytes`.
"""

import argparse
import os
import random
from collections import Counter
from pathlib import Path

import numpy as np

from palpate.touches import TouchesError, decode_bytes

KINDS = ("bit", "byte", "bytes changed", "bytes doubled", "bytes left out", "end cut")


def damaged(data, kind, chance):
    """Return a file with one damage; runs of bytes have 2 to 300."""
    at = chance.randrange(len(data))
    end = at + (1 if kind == "byte" else chance.randint(2, 300))
    if kind == "bit":
        return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
    if kind in ("byte", "bytes changed"):
        changed = bytes(b ^ chance.randrange(1, 256) for b in data[at:end])
        return data[:at] + changed + data[end:]
    if kind == "bytes doubled":
        return data[:end] + data[at:]
    return data[:at] + (data[end:] if kind == "bytes left out" else b"")


def outcome(data, whole):
    """Return the outcome of reading a damaged file, given the levels of the whole."""
    try:
        levels = decode_bytes(data)
    except TouchesError:
        return "refused"
    return "as before" if np.array_equal(levels, whole) else "read differently"


def main():
    """Print a line for each kind of damage and one for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    folder = Path(os.environ["PALPATE_DATA"]) / "bathtip/originals"
    paths, chance = sorted(folder.rglob("*.jpg")), random.Random(options.seed)
    counts = {kind: Counter() for kind in KINDS}
    for number in range(options.n):
        data, kind = chance.choice(paths).read_bytes(), KINDS[number % len(KINDS)]
        broken = damaged(data, kind, chance)
        counts[kind][outcome(broken, decode_bytes(data))] += 1
    counts["all"] = sum(counts.values(), Counter())
    print("kind: refused, as before, read differently")
    for kind, n in counts.items():
        print(f"{kind}: {n['refused']}, {n['as before']}, {n['read differently']}")


if __name__ == "__main__":
    main()
