"""
Encodings side by side
======================

An encoding turns an image into numbers. Which one is good depends on the sensor and on
how things come to it. Here parts are laid on a pressure array at any angle: those
blind to turns are right more often, but for Hu's moments, which leave out much.
"""

import matplotlib.pyplot as plt
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import simulate_presses
from palpate.encodings import encoder_named

touches = simulate_presses(None, 20, random_state=0)
names = ["taxels", "grid-levels", "edge-histograms", "ring-quantiles", "hu", "zernike"]
names += ["oriented-pca", "centroid-moments"]
right = {}
for name in names:
    model = make_pipeline(encoder_named(name), StandardScaler(), SVC(C=10))
    right[name] = 100 * cross_val_score(model, touches.images, touches.object, cv=4)
    print(f"{name:18} {right[name].mean():.0f} % ({right[name].std():.0f})")

figure, axes = plt.subplots()
means = [values.mean() for values in right.values()]
spread = [values.std() for values in right.values()]
blind = ["C0" if encoder_named(n).blind_to else "C4" for n in names]
axes.barh(names[::-1], means[::-1], xerr=spread[::-1], color=blind[::-1])
axes.set(xlabel="right after one press, % (spread over four folds)", xlim=(0, 100))
axes.set_title("Twelve parts at any angle; teal: blind to something")
