"""
What a turn does
================

The same press, turned step by step. How far do the features move from those of the
upright press, in units of the distance to another part? An encoding that is blind to
turns should stay near 0; on taxels as coarse as these it reaches a quarter.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import simulate_presses
from palpate.encodings import encoder_named
from palpate.images import repose

touches = simulate_presses(["bar10", "square13"], 1, random_state=4)
bar, square = touches.images.astype(float)
angles = np.arange(0, 181, 10)
turned = np.concatenate([repose(bar[None], angle_deg=float(a)) for a in angles])

figure, axes = plt.subplots()
for name in ["taxels", "grid-levels", "ring-quantiles", "zernike", "centroid-moments"]:
    encoder = encoder_named(name).fit(touches.images)
    features = encoder.transform(np.concatenate([turned, square[None]]))
    away = np.linalg.norm(features - features[0], axis=1)
    axes.plot(angles, 100 * away[:-1] / away[-1], label=name)
    print(f"{name:18} up to {100 * away[:-1].max() / away[-1]:.0f} %")
axes.set(xlabel="turn, degrees", ylabel="change, % of the way to another part")
axes.set(title="A bar that is turned on 10 x 10 taxels", ylim=(0, None))
axes.legend()
