"""
Which part, where, and how is it turned?
========================================

For a gripper a name is not enough. `PressPose` learns a template of each part and gives
place and angle of a press, with standard deviations.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import simulate_presses
from palpate.images import PressPose

taught = simulate_presses(["bar35", "hexagon13-hole8", "square13"], 20, random_state=0)
pose = PressPose(pitch_mm=2.0).fit(taught.images, taught.object)
presses = simulate_presses(["bar35", "hexagon13-hole8", "square13"], 2, random_state=1)
poses = pose.estimate(presses.images, presses.object)

figure, axes = plt.subplots(2, 3, figsize=(5.4, 3.9))
for number, axis in enumerate(axes.flat):
    axis.imshow(presses.images[number], extent=(-10, 10, 10, -10))
    x, y, angle = (
        poses.x_mm[number],
        poses.y_mm[number],
        np.deg2rad(poses.angle_deg[number]),
    )
    along = 6 * np.array([np.cos(angle), np.sin(angle)])
    axis.plot(
        [x - along[0], x + along[0]], [y - along[1], y + along[1]], color="C1", lw=2
    )
    axis.plot(x, y, "o", color="C1")
    axis.set(xticks=[], yticks=[])
    axis.set_title(
        f"{poses.angle_deg[number]:.0f} ± {poses.sd_deg[number]:.0f} deg", size=8
    )
    print(
        presses.object[number],
        f"{x:.1f} mm, {y:.1f} mm, {poses.angle_deg[number]:.0f} deg",
    )
