"""
The alarm: is this still the same mounting?
===========================================

`check_mounting` looks at some ten touches and says whether they come from a mounting
like those of training. Here the exposure of a simulated camera drifts away, step by
step.
"""

import matplotlib.pyplot as plt

from palpate import ObjectRecogniser, Touches, simulate_touches

touches = simulate_touches(["mug", "ball", "pen"], 24, random_state=0)
taught = touches[touches.order < 16]
test = touches[touches.order >= 20]
recogniser = ObjectRecogniser().fit(taught)

gammas = [1.0, 1.1, 1.2, 1.4, 1.7, 2.0]
away, usual = [], 0.0
for gamma in gammas:
    images = 255 * (test.images / 255) ** gamma
    check = recogniser.check_mounting(Touches(images, **test.whole))
    away.append(check.distance)
    usual = check.usual
    print(gamma, check.changed, *check.reasons[:1])

figure, axes = plt.subplots()
axes.plot(gammas, away, "o-")
axes.axhline(usual, color="C1", ls="--", label="limit: 95 % of draws from training")
axes.set(xlabel="gamma of the pictures", ylabel="how unlike training, sd")
axes.legend()
