"""
Liu 2014, Figs 5 and 6: load and cover
======================================

The paper presses a bar with 1 to 5 kgf (Fig. 5) and through covers of different
thickness (Fig. 6), and shows the touch images. Ours, of a simulated array: a light load
breaks the image up, a thick cover blurs it. The paper saw distorted images at its
greatest load; the simulated metal does not slip or bend, so ours stay whole. The scores
that belong to these pictures are on the page of the study.
"""

import matplotlib.pyplot as plt

from palpate import simulate_presses
from palpate.images import ArrayCleanUp
from palpate.simulation import PressureArray

loads, covers = [1, 2, 3, 4, 5], [0.3, 0.6, 0.9, 1.5, 3.0]
part = "bar10"
rows = {
    "load": [
        simulate_presses(part, 1, load_kgf=load, random_state=2) for load in loads
    ],
    "cover": [
        simulate_presses(part, 1, array=PressureArray(cover_mm=mm), random_state=2)
        for mm in covers
    ],
}
titles = [[f"{load} kgf" for load in loads], [f"{mm:g} mm" for mm in covers]]

figure, axes = plt.subplots(4, 5, figsize=(7.2, 6.2))
for number, (what, presses) in enumerate(rows.items()):
    for column, press in enumerate(presses):
        raw, clean = axes[2 * number, column], axes[2 * number + 1, column]
        raw.imshow(press.images[0], vmin=0, vmax=120)
        raw.set_title(titles[number][column], size=10)
        clean.imshow(ArrayCleanUp().fit_transform(press.images)[0])
    axes[2 * number, 0].set_ylabel(f"{what}: as read")
    axes[2 * number + 1, 0].set_ylabel("cleaned up")
for axis in axes.flat:
    axis.set(xticks=[], yticks=[])
