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
for column, touch in zip(axes.T, touches, strict=True):
    image = touch.images[0].astype(float)
    column[0].imshow(image, cmap="gray")
    column[1].imshow(image - touches.no_contact, cmap="PuOr", vmin=-80, vmax=80)
    column[0].set_title(touch.object[0])
    for axis in column:
        axis.axis("off")
figure.suptitle("A press on four things, and what it changed")
