"""The one heat map of this project: darker for more, so that it can be read without colours."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lerobot_lisa.analysis.figures.style import MAP, PAGE_WIDTH, headline, new_figure

CELL = 0.21  # inches high, unless there are many
LABELLED = 60  # of more rows, or two thirds as many columns, only every few get a label


def draw_heat_map(
    axes: Axes,
    values: NDArray[np.float64],
    rows: Sequence[str],
    columns: Sequence[str],
    unit: str,
    highest: float | None = None,
) -> None:
    """Draw values (R, C) into axes, with names of rows and columns and a scale; nan stays white.

    Args:
        axes: Where.
        values: 0 and above.
        rows: R names.
        columns: C names.
        unit: Of the values.
        highest: Value that is black; None: the greatest.
    """
    image = axes.imshow(values, cmap=MAP, aspect="auto", vmin=0, vmax=highest, interpolation="nearest")
    every = -(-len(columns) * 3 // (LABELLED * 2))
    axes.set_xticks(range(0, len(columns), every), list(columns)[::every], fontsize=7)
    every = -(-len(rows) // LABELLED)
    axes.set_yticks(range(0, len(rows), every), list(rows)[::every], fontsize=8)
    axes.set_xticks(np.arange(0.5, len(columns) - 1), minor=True)
    axes.set_yticks(np.arange(0.5, len(rows) - 1), minor=True)
    axes.grid(which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    scale = axes.figure.colorbar(image, ax=axes, label=unit, fraction=0.03, pad=0.015, aspect=30)
    scale.locator = MaxNLocator(5, integer=bool(np.all(values[~np.isnan(values)] % 1 == 0)))
    scale.outline.set_visible(False)


def height(rows: int) -> float:
    """Inches that so many rows need."""
    return CELL * min(rows, LABELLED)


def heat_map(
    values: NDArray[np.float64],
    rows: Sequence[str],
    columns: Sequence[str],
    labels: tuple[str, str],
    unit: str,
    title: str,
    sample: str = "",
    highest: float | None = None,
) -> Figure:
    """A figure of one heat map, as wide as the page at most; see `draw_heat_map`, `labels` are of rows and columns."""
    names = 0.3 + 0.075 * max(map(len, rows))
    width = min(PAGE_WIDTH, max(5.0, 0.3 * len(columns) + names + 1.0))
    figure = new_figure(width, max(2.0, height(len(rows)) + 1.1))
    axes = figure.add_subplot()
    draw_heat_map(axes, values, rows, columns, unit, highest)
    axes.set(ylabel=labels[0], xlabel=labels[1])
    headline(axes, title, sample)
    return figure


def long_table(
    values: Mapping[str, NDArray[Any]], rows: Sequence[str], columns: Sequence[str], names: tuple[str, str]
) -> pd.DataFrame:
    """Values (R, C) of one or several measures as a table with a row for each cell."""
    index = pd.MultiIndex.from_product([list(rows), list(columns)], names=list(names))
    return pd.DataFrame({name: measure.reshape(-1) for name, measure in values.items()}, index=index).reset_index()
