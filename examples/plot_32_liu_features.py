"""
Liu 2014, Figs 12 to 14: descriptors, geometry, both
====================================================

Three nearest neighbours on Fourier descriptors (FD), on geometry (GE) and on both. The
paper's bars: all classes 43, 63.3 and 68.7 %; solid parts 60.8, 74.5 and 84.3 %. Ours,
here with ten runs of twofold cross-validation on z-scored features: geometry is easier
on simulated presses, and forty descriptors outvote the two numbers of geometry. The
page of the study says what was tried to explain it.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import RepeatedStratifiedKFold, cross_val_score
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from palpate import simulate_presses
from palpate.encodings import EncodingUnion, FourierDescriptors, ShapeGeometry
from palpate.images import ArrayCleanUp

touches = simulate_presses(None, 20, random_state=0)
binary = ArrayCleanUp().fit_transform(touches.images)
solid = np.char.find(touches.object.astype(str), "hole") < 0
paper = {"all parts": (43.0, 63.3, 68.69), "solid parts": (60.8, 74.45, 84.3)}
encoders = {"FD": FourierDescriptors(), "GE": ShapeGeometry()}
encoders["FD+GE"] = EncodingUnion([encoders["FD"], encoders["GE"]])
folds = RepeatedStratifiedKFold(n_splits=2, n_repeats=10, random_state=0)

figure, axes = plt.subplots(1, 2, sharey=True, figsize=(7.2, 3.4))
for axis, (what, rows) in zip(
    axes, [("all parts", solid | ~solid), ("solid parts", solid)], strict=True
):
    for place, (name, encoder) in enumerate(encoders.items()):
        features = encoder.fit_transform(binary[rows])
        model = make_pipeline(StandardScaler(), KNeighborsClassifier(3))
        right = 100 * cross_val_score(model, features, touches.object[rows], cv=folds)
        axis.bar(place - 0.2, paper[what][place], 0.38, color="C4")
        axis.bar(place + 0.2, right.mean(), 0.38, yerr=right.std(), color="C0")
        print(f"{what}, {name}: {right.mean():.1f} ({right.std():.1f})")
    axis.set(title=what, xticks=range(3), ylim=(0, 105))
    axis.set_xticklabels(encoders)
axes[0].set_ylabel("right after one press, %")
axes[1].bar(0, 0, color="C4", label="paper")
axes[1].bar(0, 0, color="C0", label="ours, simulated")
axes[1].legend(loc="upper left", fontsize=8)
