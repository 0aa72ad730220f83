"""
A belief that moves
===================

One touch says little. The belief adds up what touches say: watch the probability of
each thing after every touch of a mug. The sensor was mounted three times while it was
taught, so that a fourth mounting, the one asked, is no surprise.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_touches

names = ["mug", "ball", "pen", "box", "stapler"]
touches = simulate_touches(names, 24, n_sessions=4, random_state=0)
taught = touches[touches.session != touches.session[-1]]
recogniser = ObjectRecogniser().fit(taught)

belief = recogniser.start()
steps = [[belief.posterior[name] for name in names]]
asked = touches[(touches.session == touches.session[-1]) & (touches.object == "mug")]
for touch in asked[:8]:
    belief.update(touch)
    steps.append([belief.posterior[name] for name in names])
print(belief.reason())

figure, axes = plt.subplots()
axes.plot(100 * np.array(steps), marker="o", label=names)
axes.set(xlabel="touches", ylabel="belief, %", ylim=(-2, 102), title="Touching a mug")
axes.legend()
