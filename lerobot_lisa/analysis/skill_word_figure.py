"""The heat maps of words by skill, as in the paper's appendix: raw, by skill, by word."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

PANELS = (
    ("How often", None, "words"),
    ("Words of each skill\n(columns sum to 1)", 0, "share"),
    ("Skills of each word\n(rows sum to 1)", 1, "share"),
)


def draw(words: Sequence[str], counts: NDArray[np.int64], title: str, output: Path) -> None:
    """Draw three heat maps side by side, darker for more, so that they can be read without colours.

    Args:
        words: W words, the rows.
        counts: (W, K) how often each word was in an instruction that each skill was used for.
        title: What was counted.
        output: PNG file to write; the same counts give the same picture.
    """
    size, (rows, columns) = 0.24, counts.shape  # inches per cell
    panel = max(4.0, size * columns + 1.8)
    figure = Figure(figsize=(3 * panel, max(3.0, size * rows + 1.6)), layout="constrained")
    figure.suptitle(title)
    for number, (name, axis, unit) in enumerate(PANELS, start=1):
        axes = figure.add_subplot(1, 3, number)
        image = axes.imshow(_values(counts, axis), cmap="Greys", aspect="auto", vmin=0, interpolation="nearest")
        axes.set(title=name, xlabel="skill code")
        _label(axes, words, columns)
        figure.colorbar(image, ax=axes, label=unit, fraction=0.04, pad=0.02)
    FigureCanvasAgg(figure).print_png(output)


def _values(counts: NDArray[np.int64], axis: int | None) -> NDArray[np.float64]:
    if axis is None:
        return counts.astype(np.float64)
    return counts / np.maximum(counts.sum(axis=axis, keepdims=True), 1)


def _label(axes: Axes, words: Sequence[str], columns: int) -> None:
    """Name every word and, as far as there is room, every skill; thin lines part the cells."""
    every = 1 if columns <= 30 else 5
    axes.set_xticks(range(0, columns, every), [str(code) for code in range(0, columns, every)], fontsize=7)
    axes.set_yticks(range(len(words)), list(words), fontsize=8)
    axes.set_xticks(np.arange(0.5, columns - 1), minor=True)
    axes.set_yticks(np.arange(0.5, len(words) - 1), minor=True)
    axes.grid(which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="minor", length=0)
