"""
A hand with several pads
========================

Arrays of a hand lie side by side in one picture; gaps are NaN, `pads` says where each
one is. `PadShapes` gives numbers of each pad and of how pads differ. Four things
here differ in what the thumb and the finger meet: each pad alone sees half of it.
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

n = 20
sides = {"bar": ("bar10", "bar10"), "coin": ("disc13", "disc13")}
sides |= {"key": ("bar10", "disc13"), "pin": ("disc13", "bar10")}
device = PressureArray(random_state=1)  # another array: its taxels have other gains
images = {}
for seed, array in enumerate([None, device]):
    for part in ("bar10", "disc13"):
        presses = simulate_presses(part, 2 * n, array=array, random_state=seed)
        images[seed, part] = iter(presses.images)
names = np.repeat([*sides], n)
thumb = np.stack([next(images[0, sides[name][0]]) for name in names])
finger = np.stack([next(images[1, sides[name][1]]) for name in names])
gap = np.full((len(names), 10, 2), np.nan)
picture = np.concatenate([thumb, gap, finger], axis=2)
pads = [[0, 0, 10, 10], [0, 12, 10, 10]]
hand = Touches(picture, object=names, pads=pads, pad_names=["thumb", "finger"])
print(hand)

right = {}
for name, boxes in {"thumb": pads[:1], "finger": pads[1:], "both": pads}.items():
    model = make_pipeline(PadShapes(boxes), StandardScaler(), SVC(C=10))
    right[name] = 100 * cross_val_score(model, hand.images, hand.object, cv=4).mean()

figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.8))
axes[0].imshow(hand[hand.object == "key"].images[0])
axes[0].set(title="one grasp of the key", xticks=[5, 17], yticks=[])
axes[0].set_xticklabels(hand.pad_names)
bars = axes[1].bar([*right], [*right.values()])
axes[1].bar_label(bars, fmt="%.0f %%")
axes[1].set(ylabel="right after one grasp, %", ylim=(0, 112))
