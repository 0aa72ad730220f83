"""
A thing that was never taught
=============================

The probability of nothing learnt falls while a known thing is touched. For the long
bar, which resembles nothing that was taught, it stays up. The disc is taken for a
hexagon of its width: a new thing is found out as far as it differs from all others.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_presses

strangers = ["bar35", "disc13"]
touches = simulate_presses(None, 16, random_state=0)
recogniser = ObjectRecogniser().fit(touches[~np.isin(touches.object, strangers)])

figure, axes = plt.subplots()
test = simulate_presses(None, 8, random_state=1)
curves, decisions = {}, {}
for name, _, rows in test.episodes():
    belief = recogniser.start(strangers=0.2)
    scores = [belief.update(touch).unknown for touch in test[rows]]
    never = name in strangers
    axes.plot(
        range(1, 9), scores, color="C1" if never else "C0", alpha=1 if never else 0.4
    )
    if never:
        axes.annotate(name, (8, scores[-1]), (4, 0), textcoords="offset points")
    curves[name], decisions[name] = scores, belief.decide(error=0.05)
    print(f"{name:16} {decisions[name]}")
axes.plot([], [], "C1", label="never taught")
axes.plot([], [], "C0", label="known")
axes.set(xlabel="touches", ylabel="probability of nothing learnt", ylim=(0, 1))
axes.set_title("Twelve parts on a pressure array, two of them never taught")
axes.legend()
