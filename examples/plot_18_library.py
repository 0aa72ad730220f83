"""
Keep touches, find them again
=============================

A library is a folder that loses no touch. Filters find touches; an archive takes them
elsewhere; adding the same touches twice adds them once.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from palpate import Touches, TouchLibrary, simulate_presses

folder = Path(tempfile.mkdtemp())
with TouchLibrary.open(folder / "lab", create=True) as library:
    for day, load in {"monday": 2.0, "tuesday": 4.0}.items():
        presses = simulate_presses(
            ["bar10", "disc13"], 10, load_kgf=load, random_state=0
        )
        library.add(presses, session=day)
        library.add(presses, session=day)
    n_touches = len(library)
    print(n_touches, "touches, although each was added twice")
    discs = library.touches("object = disc13 and session = tuesday")
    everything = library.touches("object = disc13")
discs.save(folder / "discs.npz")
back = Touches.load(folder / "discs.npz")

figure, axes = plt.subplots(2, 5, figsize=(6.4, 3))
for row, session in zip(axes, ("monday", "tuesday"), strict=True):
    these = everything[everything.session == session]
    for axis, image in zip(row, these.images, strict=False):
        axis.imshow(image, vmin=0, vmax=100)
        axis.set(xticks=[], yticks=[])
    row[0].set_ylabel(session)
figure.suptitle(f"disc13, read back from the library; {len(back)} went into an archive")
