"""One look for every picture of the gallery."""

from pathlib import Path
from typing import Any


def one_look(gallery: Any, name: str) -> None:
    """Give pictures the colours and letters of `palpate.mplstyle`, in a new start."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    plt.style.use(["default", str(Path(__file__).with_name("palpate.mplstyle"))])
