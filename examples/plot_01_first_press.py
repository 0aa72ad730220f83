"""
The first press
===============

What a sensor gives: one image of each touch. Here a simulated dome camera is pressed on
four things; no hardware is needed. The second picture shows what changed against the
baseline, the picture of touching nothing.
"""

import matplotlib.pyplot as plt

from palpate import simulate_touches

names = ["mug", "ball", "pen", "box"]
touches = simulate_touches(names, 1, random_state=3)
print(touches)

axes = touches.plot()

figure, below = plt.subplots(1, 4, figsize=(6.4, 1.8), layout="constrained")
changes = touches.images.astype(float) - touches.no_contact
for axis, change in zip(below, changes, strict=True):
    axis.imshow(change, cmap="PuOr", vmin=-80, vmax=80)
    axis.axis("off")
