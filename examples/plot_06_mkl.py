"""
MKL in one picture: which kernels were chosen
=============================================

`MKLSVC` learns a weight for every kernel of a bank, one set of weights for each pair of
classes. Kernels must first be brought to one scale. Dividing by the trace, as the
literature does, favours narrow Gaussians, to which every touch is like itself alone;
dividing by the variance makes kernels comparable. Twelve parts, the features of Liu et
al. 2014.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.distance import pdist
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from palpate import simulate_presses
from palpate.classifiers import MKLSVC, GaussianKernel
from palpate.encodings import (
    EncodingUnion,
    FourierDescriptors,
    KernelPCA,
    ShapeGeometry,
)
from palpate.images import ArrayCleanUp

touches = simulate_presses(None, 20, random_state=0)
binary = ArrayCleanUp().fit_transform(touches.images)
encoder = EncodingUnion([FourierDescriptors(), ShapeGeometry()])
taught, tested = slice(0, None, 2), slice(1, None, 2)  # every other press
model = make_pipeline(encoder, StandardScaler(), KernelPCA(40))
X = model.fit(binary[taught]).transform(binary)
median = np.median(pdist(X[taught]))
widths = 2.0 ** np.arange(-5, 6)  # in median distances

figure, axes = plt.subplots(1, 2, sharey=True, figsize=(7.2, 3.6))
for axis, (normalize, C) in zip(
    axes, {"trace": 100, "variance": 3.16}.items(), strict=True
):
    bank = [GaussianKernel(width * median) for width in widths]
    svc = MKLSVC(C, kernels=bank, normalize=normalize, probability=False)
    svc.fit(X[taught], touches.object[taught])
    right = svc.score(X[tested], touches.object[tested])
    weights = 100 * svc.weights_.mean(axis=0)
    axis.bar(np.log2(widths), weights)
    axis.axvline(0, color="C1", ls="--", label="median distance")
    axis.set(xlabel="log2 (width / median distance)")
    axis.set_title(f"{normalize}: {right:.0%} right")
    narrow = weights[widths <= 0.5].sum()
    print(
        f"{normalize}: {right:.0%} right, {narrow:.0f} % of the weight on narrow ones"
    )
axes[0].set_ylabel("weight, %, mean over pairs")
axes[0].legend(fontsize=8)
