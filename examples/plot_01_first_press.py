"""
The first press
===============

What a sensor gives: one image of each touch. Here a simulated dome camera is pressed on
four things; no hardware is needed. The last row shows what changed against the
baseline, the picture of touching nothing.
"""

import matplotlib.pyplot as plt

from palpate import simulate_touches

names = ["mug", "ball", "pen", "box"]
touches = simulate_touches(names, 1, random_state=3)
print(touches)

figure, axes = plt.subplots(2, 4, figsize=(7.2, 3.8))
changes = touches.images.astype(float) - touches.no_contact
for column, touch, change in zip(axes.T, touches, changes, strict=True):
    column[0].imshow(touch.images[0], cmap="gray")
    column[1].imshow(change, cmap="PuOr", vmin=-80, vmax=80)
    column[0].set_title(touch.object[0])
    for axis in column:
        axis.axis("off")
figure.suptitle("A press on four things, and what it changed")
