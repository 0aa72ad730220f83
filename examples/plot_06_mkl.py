"""
MKL in one picture: which kernels were chosen
=============================================

`MKLSVC` learns a weight for every kernel of a bank, one set of weights for each pair of
classes. Dividing kernels by their trace, as the literature does, makes narrow Gaussians
cheap; dividing by their variance makes kernels comparable.
"""

import matplotlib.pyplot as plt
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from palpate import simulate_presses
from palpate.classifiers import MKLSVC, GaussianKernel, LinearKernel
from palpate.encodings import CentroidMoments

touches = simulate_presses(
    ["bar10", "hexagon13", "square13", "disc13"], 20, random_state=0
)
bank = [LinearKernel(), *(GaussianKernel(2.0**k) for k in range(-2, 6))]
labels = ["linear", *(f"{2.0**k:g}" for k in range(-2, 6))]

figure, axes = plt.subplots(1, 2, sharey=True, figsize=(7.2, 3.6))
for axis, (normalize, C) in zip(
    axes, {"trace": 100, "variance": 3}.items(), strict=True
):
    svc = MKLSVC(C, kernels=bank, normalize=normalize, probability=False)
    model = make_pipeline(CentroidMoments(), StandardScaler(), svc)
    right = 100 * cross_val_score(model, touches.images, touches.object, cv=4)
    weights = model.fit(touches.images, touches.object)[-1].weights_
    axis.bar(labels, 100 * weights.mean(axis=0))
    axis.set(
        xlabel="kernel: width of the Gaussian",
        title=f"{normalize}: {right.mean():.0f} % right",
    )
    axis.tick_params(axis="x", rotation=60)
axes[0].set_ylabel("weight, %, mean over pairs")
