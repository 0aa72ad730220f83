"""
A belief that moves
===================

One touch says little. The belief adds up what touches say: watch the probability of
each thing after every touch of a mug. The sensor was mounted three times while it was
taught, so that a fourth mounting, the one asked, is no surprise.
"""

from palpate import ObjectRecogniser, simulate_touches

names = ["mug", "ball", "pen", "box", "stapler"]
touches = simulate_touches(names, 24, n_sessions=4, random_state=0)
taught = touches[touches.session != touches.session[-1]]
recogniser = ObjectRecogniser().fit(taught)

episode = recogniser.episode(error=0.05)
test = touches[(touches.session == touches.session[-1]) & (touches.object == "mug")]
for touch in test:
    print(episode.add(touch))

axes = episode.plot()
