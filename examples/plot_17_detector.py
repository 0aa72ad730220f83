"""
Touches in a stream of frames
=============================

A sensor gives frames all the time. `TouchDetector` says when a touch begins and ends,
and keeps the frame of greatest change of each.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import Touches, simulate_presses
from palpate.sensors import TouchDetector

presses = simulate_presses(["disc13", "bar35", "square13"], 1, random_state=0)
rng = np.random.default_rng(0)
rest = np.full((12, 10, 10), 20.0)
film = [rest]
for image in presses.images:
    strength = np.sin(np.linspace(0, np.pi, 9))[:, None, None]
    film += [20 + strength * image, np.full((8, 10, 10), 20.0)]
frames = np.concatenate(film) + rng.normal(
    scale=1.0, size=(sum(map(len, film)), 10, 10)
)

detector = TouchDetector()
touches = detector.touches_in(Touches(frames))  # its first ten frames are the baseline
print(touches)
change = np.sqrt(((frames - detector.baseline) ** 2).mean(axis=(1, 2)))

figure, axes = plt.subplots(figsize=(6.4, 3))
axes.plot(change, label="change from the baseline")
axes.axhline(detector.begin, color="C1", ls="--", label="a touch begins")
axes.axhline(detector.end, color="C2", ls=":", label="a touch ends")
peaks = [
    int(np.argmin(abs(frames - image).sum(axis=(1, 2)))) for image in touches.images
]
axes.plot(peaks, change[peaks], "v", color="C3", ms=9, label="touch")
axes.set(xlabel="frame", ylabel="change, counts")
axes.set_ylim(0, 17)
axes.legend(fontsize=8, loc="upper center", ncols=2)
