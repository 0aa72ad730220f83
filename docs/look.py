"""One look for every picture of the gallery."""

from pathlib import Path
from typing import Any


def one_look(gallery: Any, name: str) -> None:
    """Reset the style of pictures to `palpate.mplstyle`."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    plt.style.use(["default", str(Path(__file__).with_name("palpate.mplstyle"))])


def free_figures(block: Any, names: dict[str, Any], gallery: Any) -> str:
    """Show figures that palpate returned, which pyplot does not know, once each."""
    from matplotlib.figure import Figure
    from sphinx_gallery.scrapers import figure_rst

    paths = []
    for figure in [*names["example_globals"].values()]:
        if isinstance(figure, Figure) and not hasattr(figure, "number"):
            figure.number = 0  # pyplot numbers its own
            paths.append(next(names["image_path_iterator"]))
            figure.savefig(paths[-1])
    return str(figure_rst(paths, gallery["src_dir"]))
