"""
The rim of a dome
=================

A camera behind a dome is never mounted twice in the same way. The rim of the dome is
found in every picture, and the disc is cut about it, so that a shifted camera changes
nothing afterwards.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import simulate_touches
from palpate.images import DomeCrop, find_rims

touches = simulate_touches("mug", 1, drift=False, random_state=3)
image = touches.images[0]
moved = np.stack(
    [np.roll(image, shift, axis=(0, 1)) for shift in [(0, 0), (7, -9), (-8, 6)]]
)
rims = find_rims(moved, no_contact=touches.no_contact)
discs = DomeCrop().fit(moved).transform(moved)

figure, axes = plt.subplots(2, 3, figsize=(6.4, 4.4))
for number, (top, bottom) in enumerate(axes.T):
    top.imshow(moved[number], cmap="gray")
    place = (rims.col[number], rims.row[number])
    top.add_patch(plt.Circle(place, rims.radius[number], fill=False, color="C2", lw=2))
    top.set_title(f"rim at {place[0]:.1f}, {place[1]:.1f}", size=9)
    bottom.imshow(discs[number], cmap="gray")
    alike = np.corrcoef(discs[0].ravel(), discs[number].ravel())[0, 1]
    print(f"disc {number}: correlation with the first {alike:.3f}")
for axis in axes.flat:
    axis.axis("off")
figure.suptitle("One press, three places of the camera, one disc")
