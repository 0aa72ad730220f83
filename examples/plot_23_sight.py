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

asked = simulate_presses("hexagon13-hole8", 1, load_kgf=1.5, random_state=8)
beliefs = {"touch": recogniser.start(), "sight": recogniser.start()}
beliefs["both"] = recogniser.start()
for what, belief in beliefs.items():
    if what != "sight":
        belief.update(asked)
    if what != "touch":
        belief.update_sense("sight", [0.55])
    print(what, {name: round(share, 2) for name, share in belief.posterior.items()})

figure, axes = plt.subplots()
for number, (what, belief) in enumerate(beliefs.items()):
    shares = [100 * belief.posterior[name] for name in names]
    axes.bar(np.arange(4) + 0.25 * (number - 1), shares, 0.23, label=what)
axes.set(
    ylabel="belief, %", xticks=range(4), title="One light press of hexagon13-hole8"
)
axes.set_xticklabels(names)
axes.legend()
