"""
Liu 2014, Figs 9 to 11: presses, clean-up, boundaries
=====================================================

The paper shows a press of each part (Fig. 9), cleans it up step by step (Fig. 10), and
follows the boundary of what is left (Fig. 11), which Fourier descriptors describe.
"""

from palpate import simulate_presses
from palpate.studies import liu2014

touches = simulate_presses(None, 1, random_state=5)
presses = liu2014.draw_parts(touches)

# %%
# White lines are the edges of the part where it really lay. The clean-up of three of
# the parts; the last three rows are thresholded as a whole, and on 2 x 2 and 3 x 3
# partitions, of which the paper found 2 x 2 best:

stages = liu2014.draw_stages(touches)

# %%
# Boundaries of 10 x 10 taxels are short (their lengths in pixels of the 33 x 33 image
# stand above), and their first three frequencies, the thin lines, hardly tell a hexagon
# from a disc. This is why descriptors alone are poor, in the paper (43 %) and here (40
# to 48 %).

boundaries = liu2014.draw_boundaries(touches)
