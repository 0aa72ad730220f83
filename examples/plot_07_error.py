"""
Choose an error rate
====================

`belief.decide(error=...)` names a thing when the accepted share of wrong names is met.
A smaller error costs more touches, and some episodes stay undecided. Each part was
taught with four presses; with more, fewer touches are needed.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_presses

recogniser = ObjectRecogniser().fit(
    simulate_presses(None, 4, load_kgf=(2, 5), random_state=1)
)
test = simulate_presses(None, 10, load_kgf=(2, 5), random_state=2)
errors = [0.2, 0.1, 0.05, 0.02, 0.01]
outcome = np.zeros((len(errors), 3))  # right, wrong or refused, undecided
used = np.zeros(len(errors))
for name, _, rows in test.episodes():
    belief = recogniser.start()
    decisions = [None] * len(errors)
    for touch in test[rows]:
        used += [decision is None for decision in decisions]
        belief.update(touch)
        decisions = [
            decision or belief.decide(error=error)
            for decision, error in zip(decisions, errors, strict=True)
        ]
    for row, decision in enumerate(decisions):
        outcome[row, 2 if decision is None else int(decision != name)] += 1
shares = 100 * outcome / outcome.sum(axis=1, keepdims=True)

figure, axes = plt.subplots()
left = np.zeros(len(errors))
for share, what in zip(
    shares.T, ["right", "wrong or refused", "undecided"], strict=True
):
    axes.bar([f"{100 * e:g} %" for e in errors], share, bottom=left, label=what)
    left += share
for place, mean in enumerate(used / outcome.sum(axis=1)):
    axes.text(place, 4, f"{mean:.1f} touches", ha="center", color="white", size=9)
axes.set(xlabel="accepted error", ylabel="episodes, %")
axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
