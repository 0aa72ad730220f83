"""
Sight beside touch
==================

Another sense joins the same belief: a camera that sees the colour of a thing from afar.
Here each sense alone is unsure about other things.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_presses

names = ["disc13", "disc13-hole8", "hexagon13", "hexagon13-hole8"]
taught = simulate_presses(names, 12, load_kgf=(1, 5), random_state=0)
recogniser = ObjectRecogniser("liu2014").fit(taught)
rng = np.random.default_rng(0)
hue = dict(zip(names, [0.2, 0.2, 0.6, 0.6], strict=True))  # two greys, two coppers
seen = [name for name in names for _ in range(10)]
colours = [[hue[name] + rng.normal(scale=0.1)] for name in seen]
recogniser.learn_modality("sight", colours, seen)

press = simulate_presses("hexagon13-hole8", 1, load_kgf=1.5, random_state=8)
beliefs = {"touch": recogniser.start(), "sight": recogniser.start()}
beliefs["both"] = recogniser.start()
for what, belief in beliefs.items():
    if what != "sight":
        belief.update(press)
    if what != "touch":
        belief.update_sense("sight", [0.55])
    print(what, {name: round(share, 2) for name, share in belief.posterior.items()})

figure, axes = plt.subplots(3, sharex=True, figsize=(6.4, 5.6), layout="constrained")
for axis, (what, belief) in zip(axes, beliefs.items(), strict=True):
    belief.plot(axis).set(title=what, xlabel="")
axes[-1].set(xlabel="probability, after one light press of hexagon13-hole8")
