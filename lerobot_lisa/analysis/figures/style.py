"""How all figures look, and how they are written: the same numbers give the same bytes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, LIGHT = "#1a1a1a", "#777777", "#cccccc"
MAP = "Greys"
DPI = 144  # sharp at 96 CSS pixels to the inch on a screen of one and a half times that
PAGE_WIDTH = 10.8  # inches

_SETTINGS = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": LIGHT,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "pdf.fonttype": 42,  # text stays text
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw and write in the house style, whatever the user's own settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def headline(axes: Axes, title: str, sample: str) -> None:
    """What is shown, and below it, smaller, what it was counted on."""
    axes.set_title(title, pad=17)
    axes.annotate(
        sample, (0, 1), xycoords="axes fraction", xytext=(0, 5), textcoords="offset points", fontsize=8, color=GREY
    )


def write_png(figure: Figure, path: Path) -> None:
    """Write a PNG of few colours, which is all that a figure has."""
    from PIL import Image

    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    with Image.open(path) as picture:
        reduced = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    reduced.save(path, optimize=True)


def write_pdf(figure: Figure, path: Path) -> None:
    """Write a PDF without the date."""
    figure.savefig(path, dpi=DPI, metadata={"CreationDate": None, "Creator": None, "Producer": None})
