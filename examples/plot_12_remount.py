"""
After the sensor was mounted anew
=================================

A pressure array is taught; then it is mounted anew: other gains, another baseline, and
some taxels stuck. `remount` gets the model used to it, with twenty touches without
labels, or with one confirmed touch of each part.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, Touches, simulate_presses

taught = simulate_presses(None, 16, random_state=0)
today = simulate_presses(None, 12, random_state=1)
rng = np.random.default_rng(1)
images = 40 + 0.6 * today.images.astype(float)
images[:, rng.integers(0, 10, 4), rng.integers(0, 10, 4)] = 255  # stuck at the most
changed = Touches(images.clip(0, 255), **today.columns, geometry="array")
first = np.isin(np.arange(len(changed)), np.arange(0, len(changed), 12))
rows = rng.permutation(len(changed))[:20]

right = {}
for what in ["as it is", "20 touches, no labels", "1 confirmed each"]:
    recogniser = ObjectRecogniser().fit(taught)
    if "labels" in what:
        recogniser.remount(Touches(changed.images[rows], geometry="array"))
    if "confirmed" in what:
        recogniser.remount(changed[first])
    right[what] = 100 * recogniser.score(changed.images[~first], changed.object[~first])
    print(f"{what:24} {right[what]:.0f} %")
right["nothing had changed"] = 100 * ObjectRecogniser().fit(taught).score(
    today.images[~first], today.object[~first]
)

figure, axes = plt.subplots()
bars = axes.barh(
    [*right][::-1], [*right.values()][::-1], color=["C4", "C0", "C0", "C1"]
)
axes.bar_label(bars, fmt="%.0f %%", padding=3)
axes.set(xlabel="right after one press, %", xlim=(0, 112))
