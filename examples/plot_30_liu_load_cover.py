"""
Liu 2014, Figs 5 and 6: load and cover
======================================

The paper presses a bar with 1 to 5 kgf (Fig. 5) and through several covers (Fig. 6),
and shows the touch images. Light loads left them incomplete, heavy ones distorted them;
thin covers broke them up, thick ones blurred them. Ours are of a simulated array, with
the outline that the clean-up finds: 1 kgf is too little for the long bar, and 3 mm blur
both. Nothing is distorted at 5 kgf, since the simulated metal does not slip or bend.
"""

from palpate.studies import liu2014

figure = liu2014.draw_load_and_cover(liu2014.Liu2014Plan())
