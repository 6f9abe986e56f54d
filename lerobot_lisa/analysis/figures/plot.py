"""A figure with its numbers and the sentence that says how to read it, and what is written of it."""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from lerobot_lisa.analysis.figures.style import write_pdf, write_png


@dataclass(frozen=True)
class Plot:
    """A figure.

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


def write(plot: Plot, folder: Path) -> None:
    """Write a figure as `name.png`, `name.pdf` and `name.csv`."""
    write_png(plot.figure, folder / f"{plot.name}.png")
    write_pdf(plot.figure, folder / f"{plot.name}.pdf")
    plot.table.to_csv(folder / f"{plot.name}.csv", index=False, float_format="%.6g", lineterminator="\n")
