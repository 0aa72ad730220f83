"""Draw how a touch becomes a belief, with the values of one simulated touch.

Writes docs/images/pipeline.png; takes half a minute:

    python benchmarks/pipeline_picture.py
"""

import textwrap
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from palpate import Belief, ObjectRecogniser, Touches, simulate_touches
from palpate.simulation import DomeCamera

OUTPUT = Path(__file__).parents[1] / "docs" / "images" / "pipeline.png"
OBJECTS = ("ball", "box", "mug", "pen", "stapler")
TRUTH = "mug"
N_TOUCHES = 5
PLACEMENTS = range(8)
BLUE, GREY, ORANGE = "#4c78a8", "#b8b8b8", "#f58518"


def main() -> None:
    """Learn five simulated objects, touch one of them, and draw each step."""
    camera = DomeCamera(image_shape=(120, 120), n_nodes=32)
    # Each object is put down several times, and once more to be asked about.
    train = Touches.concatenate(
        simulate_touches(OBJECTS, 10, camera, random_state=seed) for seed in PLACEMENTS
    )
    test = simulate_touches((TRUTH,), N_TOUCHES, camera, random_state=100)
    recogniser = ObjectRecogniser().fit(train)
    # In two rows, so that it can be read at the width of a page.
    figure, axes = plt.subplots(2, 3, figsize=(7.6, 5.4), layout="constrained")
    axes = axes.ravel()
    draw_images(axes[:2], recogniser, test)
    evidence = recogniser.evidence(test[0])
    draw_features(axes[2], evidence.features[0])
    draw_evidence(axes[3], evidence.log_likelihood[0])
    belief = draw_belief(axes[4], recogniser, test)
    axes[5].axis("off")
    axes[5].set_title("6 recognition/\ndecision")
    sentence = textwrap.fill(belief.reason(), 18)
    axes[5].text(0.5, 0.6, sentence, ha="center", va="center", size=14, color=ORANGE)
    OUTPUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUTPUT, dpi=110)
    print(OUTPUT)


def draw_images(axes, recogniser, touches) -> None:
    """Draw a touch as the camera saw it, and after the clean-up."""
    axes[0].imshow(touches.images[0], cmap="gray")
    axes[0].set_title("1 touches/\na touch: image, labels")
    axes[1].imshow(recogniser.encoder_.clean(touches[:1])[0], cmap="gray")
    axes[1].set_title("2 images/\ncleaned up: a disc")
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])


def draw_features(axis, features) -> None:
    """Draw the feature vector."""
    axis.bar(np.arange(len(features)), features, color=BLUE, width=1)
    axis.set_title(f"3 encodings/\na vector: {len(features)} features")
    axis.set_xticks([])
    axis.set_xlabel("feature")


def draw_evidence(axis, log_likelihood) -> None:
    """Draw the log-likelihood of the touch under each object."""
    colours = [ORANGE if name == TRUTH else GREY for name in OBJECTS]
    axis.barh(OBJECTS, log_likelihood - log_likelihood.min() + 0.05, color=colours)
    axis.invert_yaxis()
    axis.set_title("4 classifiers/\nevidence of this touch")
    axis.set_xlabel("nats above the least")


def draw_belief(axis, recogniser, touches) -> Belief:
    """Draw the posterior of each object, touch by touch; return the belief."""
    belief = recogniser.start()
    shares = [list(belief.posterior.values())]
    for touch in touches:
        belief = belief.update(touch)
        shares.append(list(belief.posterior.values()))
    for name, line in zip(recogniser.classes_, 100 * np.array(shares).T, strict=True):
        truth = name == TRUTH
        axis.plot(line, "o-", color=ORANGE if truth else GREY, label=name, ms=4)
        if truth:
            axis.annotate(name, (len(line) - 1, line[-1]), (-34, -16),
                          textcoords="offset points", color=ORANGE)  # fmt: skip
    axis.set_title("5 recognition/\nbelief after each touch")
    axis.set_xlabel("touches")
    axis.set_ylabel("per cent")
    axis.set_ylim(0, 102)
    return belief


if __name__ == "__main__":
    main()
