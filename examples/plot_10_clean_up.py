"""
Cleaning up a pressure image
============================

The chain of Liu et al. 2014: enlarge, raise low levels, set to zero what lies two
standard deviations below the mean, and decide pixel by pixel what was pressed. In these
images that is below zero, so the third step changes nothing; the last takes off the
noise that the second raised.
"""

import matplotlib.pyplot as plt

from palpate import simulate_presses
from palpate.images import ArrayCleanUp

names = ["bar35", "hexagon13-hole8", "square13", "disc13-hole8"]
touches = simulate_presses(names, 1, random_state=7)
stages = {"as read, 10 x 10": touches.images.astype(float)}
for output in ["resized", "gamma", "filtered", "binary"]:
    stages[output] = ArrayCleanUp(output=output).fit_transform(touches.images)

figure, axes = plt.subplots(len(names), len(stages), figsize=(7.2, 5.8))
for column, (stage, images) in zip(axes.T, stages.items(), strict=True):
    column[0].set_title(stage, size=10)
    for axis, image in zip(column, images, strict=True):
        axis.imshow(image)
        axis.set(xticks=[], yticks=[])
for axis, name in zip(axes[:, 0], touches.object, strict=True):
    axis.set_ylabel(name, size=8)
