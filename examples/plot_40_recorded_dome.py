"""
Recorded touches: the place of the camera names the thing
=========================================================

This one needs recorded touches: the environment variable ``PALPATE_DATA`` names their
folder (see "Recorded touches" in the reference); without it the program is shown and
not run. Of fifty household things under a BathTip dome, the place of the disc in the
picture alone names many, since the camera shifted between recordings.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from palpate import Touches
from palpate.images import find_rims

folder = Path(os.environ["PALPATE_DATA"])
touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
names = np.unique(touches.object)[::5]
touches = touches[np.isin(touches.object, names)]
rims = find_rims(touches.images)

figure, axes = plt.subplots(figsize=(6.4, 4.2))
for number, name in enumerate(names):
    these = touches.object == name
    axes.plot(
        rims.col[these],
        rims.row[these],
        ".",
        color=plt.cm.cividis(number / 9),
        label=name,
    )
axes.set(xlabel="column of the disc's centre", ylabel="row of the disc's centre")
axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
axes.set_title("Ten recorded things: one cloud each")
