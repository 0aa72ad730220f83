"""
Classifiers side by side
========================

The same features, six classifiers. The last three, densities and kernel ridge, give
likelihoods that a belief can add up; the first three name an object, or give shares.
With so few presses no classifier stands out: each is within its spread of the next.
"""

import time

import matplotlib.pyplot as plt
from sklearn.model_selection import cross_val_score
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import simulate_presses
from palpate.classifiers import (
    MKLSVC,
    KernelDensityBayes,
    KernelDensityNaiveBayes,
    KernelRidgeClassifier,
)
from palpate.encodings import CentroidMoments

touches = simulate_presses(None, 10, load_kgf=(1, 5), random_state=0)
classifiers = {
    "3 nearest": KNeighborsClassifier(3),
    "one SVM": SVC(C=10),
    "MKLSVC": MKLSVC(10, normalize="variance"),
    "kernel density": KernelDensityBayes(),
    "density a feature": KernelDensityNaiveBayes(),
    "kernel ridge": KernelRidgeClassifier(),
}
means, spreads = [], []
figure, axes = plt.subplots()
for name, classifier in classifiers.items():
    model = make_pipeline(CentroidMoments(), StandardScaler(), classifier)
    begun = time.process_time()
    scores = 100 * cross_val_score(model, touches.images, touches.object, cv=5)
    seconds = time.process_time() - begun
    means.append(scores.mean())
    spreads.append(scores.std())
    print(f"{name:18} {means[-1]:.0f} % ({spreads[-1]:.0f}), {seconds:.1f} s")
axes.errorbar(means, [*classifiers], xerr=spreads, fmt="o", capsize=4)
axes.set(xlabel="right after one press, % (spread over five folds)")
axes.set_title("Ten presses of each of twelve parts, 1 to 5 kgf")
