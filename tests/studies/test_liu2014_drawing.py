"""Pictures of the Liu 2014 study: their contents, known without looking."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.studies import liu2014
from palpate.studies.liu2014 import simulated_presses

pytest.importorskip("matplotlib", reason='pip install "palpate[plot]"')


def test_both_bars_are_drawn_under_every_load_and_cover_alike(tiny_plan):
    figure = liu2014.draw_load_and_cover(tiny_plan())
    lines = np.reshape(figure.axes, (4, 6))
    assert [place.get_title() for place in lines[0, :5]] == [
        "1 kgf", "2 kgf", "3 kgf", "4 kgf", "5 kgf"
    ]  # fmt: skip
    assert [place.get_title() for place in lines[2]] == [
        "0.3 mm", "0.6 mm", "0.9 mm", "1.5 mm", "2 mm", "3 mm"
    ]  # fmt: skip
    images = [[i.get_array() for p in line for i in p.images] for line in lines]
    assert [len(line) for line in images] == [5, 5, 6, 6]
    for loads, covers in (images[::2], images[1::2]):
        # 4 kgf through 0.9 mm stands in both lines; more load presses harder in sum.
        assert_array_equal(loads[3], covers[2])
        assert np.all(np.diff([int(image.sum()) for image in loads]) > 0)
    # The 10 mm bar does not reach the rim of the array, the 35 mm one must.
    assert images[0][4][[0, -1]].max() < images[1][4].max() / 4
    assert max(images[1][4][:, [0, -1]].max(), images[1][4][[0, -1]].max()) > 20


def test_a_disc_is_as_round_as_its_first_frequencies(tiny_plan):
    touches = simulated_presses(tiny_plan(parts=(1, 12)))
    bar, disc = liu2014.draw_boundaries(touches).axes[:2]
    for place, name in ((bar, "bar10"), (disc, "disc13")):
        line, smooth = (patch.get_xy()[:-1] for patch in place.patches)
        assert place.get_title() == f"{name}: {len(line)}"
        # One step along rows or columns, or a diagonal one, from pixel to pixel.
        steps = np.abs(np.diff(line, axis=0)).max(axis=1)
        assert_array_equal(steps, 1)
        assert_allclose(smooth.mean(axis=0), line.mean(axis=0), atol=1e-9)
    radii = np.linalg.norm(smooth - smooth.mean(axis=0), axis=1)
    # 13 mm of 20 mm are 21.45 of 33 pixels; the cover adds up to two taxels in all.
    assert 0.9 * 21.45 / 2 < radii.mean() < 28.05 / 2
    assert radii.std() < 0.1 * radii.mean()


def test_the_clean_up_is_drawn_from_the_part_to_three_partitions(tiny_plan):
    figure = liu2014.draw_stages(simulated_presses(tiny_plan()))
    lines = np.reshape(figure.axes, (8, 3))
    labels = [place.get_ylabel() for place in lines[:, 0]]
    assert [label[:3] for label in labels] == [f"({letter})" for letter in "abcdefgh"]
    assert labels[0] == "(a) part"
    assert labels[-1] == "(h) binary 3 x 3"
    # A hexagon and a square with a hole each, a disc without.
    assert [len(place.patches) for place in lines[0]] == [2, 2, 1]
    sizes = [place.images[0].get_array().shape for place in lines[1:, 0]]
    assert sizes == [(10, 10), *6 * [(33, 33)]]


def test_the_papers_figures_stand_beside_ours_as_hollow_marks():
    figures = (("Fig. 12", 40, 30.0, 43.0), ("Fig. 13", None, 90.0, 63.3))
    figures += (("Fig. 14", 40, 95.0, 68.69), ("Fig. 14", 5, 85.0, None))
    keys = ("table", "n", "ours", "paper")
    shared = {"classes": "all", "data": "simulated", "sd": None}
    rows = [
        {**shared, **dict(zip(keys, figure, strict=True)), "features": scaling}
        for figure in figures
        for scaling in ("z-scored", "raw")
    ]
    other = {**rows[0], "data": "taxel10x10", "ours": 1.0}
    left, right = np.reshape(liu2014.draw_class_sets([*rows, other]).axes, (3, 2)).T
    for side in (left, right):
        assert [marks(place, hollow=True) for place in side] == [[43], [63.3], [68.69]]
        # The ends of bars of no height lie on the marks.
        assert [{*marks(place)} for place in side] == [{30}, {90}, {95, 85}]
        assert {place.get_ylim() for place in side} == {(0.0, 104.0)}


def marks(place, *, hollow=False):
    lines = [line for line in place.lines if (line.get_mfc() == "none") == hollow]
    return [y for line in lines for y in line.get_ydata()]
