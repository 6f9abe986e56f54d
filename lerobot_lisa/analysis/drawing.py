"""How all figures look, the one heat map, and how a figure and its numbers are written: equal numbers, equal bytes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lerobot_lisa.analysis.files import write_csv

INK, GREY, LIGHT = "#1a1a1a", "#777777", "#cccccc"
DPI = 144  # sharp at 96 CSS pixels to the inch on a screen of one and a half times that
PAGE_WIDTH = 10.8  # inches
CELL = 0.21  # inches that a row of a heat map is high, unless there are many
LABELLED = 60  # of more rows, or two thirds as many columns, only every few get a label
MOST_CODES = 60
"""Skill codes that a figure shows; of a larger codebook those that were used, the most frequent first."""

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
    "text.parse_math": False,  # a "$" in an instruction is a dollar
    "pdf.fonttype": 42,  # text stays text
}


@dataclass(frozen=True)
class Plot:
    """A figure with its numbers.

    Attributes:
        name: Of its files.
        title: What it shows, in a few words.
        figure: The drawing.
        table: Its numbers.
        reading: How to read it and what a good value is.
    """

    name: str
    title: str
    figure: Figure
    table: pd.DataFrame
    reading: str


@dataclass(frozen=True)
class Grid:
    """Values by row and column.

    Attributes:
        values: 0 and above, or nan, (R, C).
        rows: R names.
        columns: C names.
        axes: What rows and columns are, such as ("word", "skill code").
        unit: Of the values.
    """

    values: NDArray[Any]
    rows: Sequence[str]
    columns: Sequence[str]
    axes: tuple[str, str]
    unit: str

    def table(self, **measures: NDArray[Any]) -> pd.DataFrame:
        """A row for each cell, with one or several measures, (R, C) each."""
        names = [axis.replace(" ", "_") for axis in self.axes]
        index = pd.MultiIndex.from_product([list(self.rows), list(self.columns)], names=names)
        columns = {name: measure.reshape(-1) for name, measure in measures.items()}
        return pd.DataFrame(columns, index=index).reset_index()


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


def clip(text: str, most: int = 40) -> str:
    """At most so many letters: drawing a word of a hundred thousand takes minutes, and nobody can read it."""
    return text if len(text) <= most else text[: most - 1] + "…"


def shorten(label: str, most: int = 40) -> str:
    """A name of a few parts, such as "817 pick up / red ball", in about so many letters: a bit of every part stays."""
    parts = label.split(" / ")
    if len(label) <= most or len(parts) == 1:
        return clip(label, most)
    return " / ".join(clip(part, max(4, (most - 3 * (len(parts) - 1)) // len(parts))) for part in parts)


def height(rows: int) -> float:
    """Inches that so many rows of a heat map need."""
    return CELL * min(rows, LABELLED)


def draw_heat_map(axes: Axes, grid: Grid, highest: float | None = None) -> None:
    """Darker for more, so that it can be read without colours; nan stays white, `highest` or the greatest is black."""
    image = axes.imshow(grid.values, cmap="Greys", aspect="auto", vmin=0, vmax=highest, interpolation="nearest")
    rows, columns = [shorten(name) for name in grid.rows], [shorten(name) for name in grid.columns]
    every = -(-len(columns) * 3 // (LABELLED * 2))
    turned = 90 if max(map(len, columns)) > 6 else 0
    axes.set_xticks(range(0, len(columns), every), columns[::every], fontsize=7, rotation=turned)
    every = -(-len(rows) // LABELLED)
    axes.set_yticks(range(0, len(rows), every), rows[::every], fontsize=8)
    axes.set_xticks(np.arange(0.5, len(columns) - 1), minor=True)
    axes.set_yticks(np.arange(0.5, len(rows) - 1), minor=True)
    axes.set(ylabel=grid.axes[0], xlabel=grid.axes[1])
    axes.grid(which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    scale = axes.figure.colorbar(image, ax=axes, label=grid.unit, fraction=0.03, pad=0.015, aspect=30)
    scale.locator = MaxNLocator(5, integer=bool(np.all(grid.values[~np.isnan(grid.values)] % 1 == 0)))
    scale.outline.set_visible(False)


def heat_map(grid: Grid, title: str, sample: str, highest: float | None = None) -> Figure:
    """A figure of one heat map, as wide as the page at most; see `draw_heat_map`."""
    names = 0.3 + 0.085 * max(len(shorten(name)) for name in grid.rows)
    below = 0.06 * max(len(shorten(name)) for name in grid.columns)
    width = min(PAGE_WIDTH, max(5.0, 0.3 * len(grid.columns) + names + 1.6))
    figure = new_figure(width, max(2.0, height(len(grid.rows)) + 1.1 + (below if below > 0.36 else 0)))
    axes = figure.add_subplot()
    draw_heat_map(axes, grid, highest)
    headline(axes, title, sample)
    return figure


def write(plot: Plot, folder: Path) -> None:
    """Write a figure as `name.png` of few colours, which is all that it has, `name.pdf` and `name.csv`."""
    from PIL import Image

    png = folder / f"{plot.name}.png"
    plot.figure.savefig(png, dpi=DPI, metadata={"Software": None})
    with Image.open(png) as picture:
        reduced = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    reduced.save(png, optimize=True)
    undated = {"CreationDate": None, "Creator": None, "Producer": None}
    plot.figure.savefig(folder / f"{plot.name}.pdf", dpi=DPI, metadata=undated)
    write_csv(plot.table, folder / f"{plot.name}.csv")
