"""
Classifiers side by side
========================

The same features, six classifiers. All but the support vector machines give likelihoods
that a belief can add up.
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
figure, axes = plt.subplots()
for name, classifier in classifiers.items():
    model = make_pipeline(CentroidMoments(), StandardScaler(), classifier)
    begun = time.process_time()
    scores = 100 * cross_val_score(model, touches.images, touches.object, cv=5)
    seconds = time.process_time() - begun
    axes.errorbar(
        scores.mean(), name, xerr=scores.std(), fmt="o", capsize=4, color="C0"
    )
    print(f"{name:18} {scores.mean():.0f} % ({scores.std():.0f}), {seconds:.1f} s")
axes.set(xlabel="right after one press, % (spread over five folds)")
axes.set_title("Ten presses of each of twelve parts, 1 to 5 kgf")
