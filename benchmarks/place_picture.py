"""Picture of a belief over places: a pen after one, three and six chosen touches.

python benchmarks/place_picture.py
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from scipy.spatial import ConvexHull

from palpate.exploration import (
    InformativeTouch,
    SurfaceMap,
    explore_to_learn,
    put_down,
)
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, find_object

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "exploration-places.png"
CAMERA = DomeCamera(image_shape=(80, 80), n_nodes=24)
NAMES = "pen", "stapler", "mug"


def main() -> None:
    """Teach three objects, touch one, and draw what is believed."""
    things = [find_object(name) for name in NAMES]
    touches = explore_to_learn(things, 60, CAMERA, n_sessions=3, random_state=1)
    surface_map = SurfaceMap().fit(ObjectRecogniser().fit(touches), touches)
    stand = put_down(things[0], CAMERA, yaw_rad=0.6, random_state=4)
    belief = surface_map.start_before(stand.hemisphere)
    strategy = InformativeTouch(surface_map, stand.hemisphere)
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), dpi=100)
    history = []
    for axis, count in zip(axes, (1, 3, 6), strict=True):
        while len(history) < count:
            pose = strategy.next_pose(belief, history)
            history.append(stand.touch_at_once(pose))
            belief.update_from_record(history[-1])
        belief.plot_surface(history, axis)
        axis.set(xlim=(-110, 110), ylim=(-110, 110))
        axis.set_title(str(belief.pose()).replace(", (", ",\n("), fontsize="small")
    corners = stand.bench.target.vertices_mm[:, :2]
    outline = corners[ConvexHull(corners).vertices]
    for axis in axes:
        axis.fill(*outline.T, color="#bbbbbb", zorder=0)
    figure.tight_layout()
    figure.savefig(PICTURE)


if __name__ == "__main__":
    main()
