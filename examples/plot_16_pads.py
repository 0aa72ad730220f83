"""
A hand with several pads
========================

Arrays of a hand lie side by side in one picture; the gaps are NaN, and `pads` says
where each one is. `PadShapes` gives numbers of each pad and of how pads differ.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import Touches, simulate_presses
from palpate.encodings import PadShapes
from palpate.simulation import PressureArray

thumb = simulate_presses(None, 24, random_state=0)
device = PressureArray(
    random_state=1
)  # another array: its taxels have gains of their own
finger = simulate_presses(None, 24, array=device, load_kgf=2, random_state=1)
gap = np.full((len(thumb), 10, 2), np.nan)
picture = np.concatenate([thumb.images, gap, finger.images], axis=2)
pads = [[0, 0, 10, 10], [0, 12, 10, 10]]
hand = Touches(picture, object=thumb.object, pads=pads, pad_names=["thumb", "finger"])
print(hand)

right = {}
for name, boxes in {"thumb": pads[:1], "finger": pads[1:], "both pads": pads}.items():
    model = make_pipeline(PadShapes(boxes), StandardScaler(), SVC(C=10))
    right[name] = 100 * cross_val_score(model, hand.images, hand.object, cv=4).mean()

figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.8))
axes[0].imshow(hand.images[0])
axes[0].set(title=f"one grasp of {hand.object[0]}", xticks=[5, 17], yticks=[])
axes[0].set_xticklabels(hand.pad_names)
bars = axes[1].bar([*right], [*right.values()])
axes[1].bar_label(bars, fmt="%.0f %%")
axes[1].set(ylabel="right after one grasp, %", ylim=(0, 112))
