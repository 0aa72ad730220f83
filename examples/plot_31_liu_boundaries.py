"""
Liu 2014, Figs 10 and 11: the boundaries of the shapes
======================================================

The paper follows the outline of each cleaned image (Figs 10 and 11) and describes it by
Fourier descriptors. Ours: the outlines of twelve simulated presses, and what is left of
them when only the first few frequencies are kept. Outlines of 10 x 10 taxels are short;
this is why the descriptors alone are poor, in the paper (43 %) and here (40 to 48 %).
"""

import cv2
import matplotlib.pyplot as plt
import numpy as np

from palpate import simulate_presses
from palpate.images import ArrayCleanUp

touches = simulate_presses(None, 1, random_state=5)
images = ArrayCleanUp().fit_transform(touches.images).astype(np.uint8)

figure, axes = plt.subplots(3, 4, figsize=(7.2, 5.8))
for axis, image, name in zip(axes.flat, images, touches.object, strict=True):
    outlines, _ = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = max(outlines, key=len)[:, 0, :]
    line = points[:, 0] + 1j * points[:, 1]
    waves = np.fft.fft(line)
    axis.imshow(image, cmap="gray", alpha=0.25)
    axis.plot(line.real, line.imag, color="C0", lw=2)
    kept = np.where(abs(np.fft.fftfreq(len(line)) * len(line)) <= 3, waves, 0)
    smooth = np.fft.ifft(kept)
    axis.plot(smooth.real, smooth.imag, color="C1", lw=1)
    axis.set_title(f"{name}: {len(line)} points", size=8)
    axis.set(xticks=[], yticks=[])
figure.suptitle("Outlines (teal) and their first three frequencies (orange)")
