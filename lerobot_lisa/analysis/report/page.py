"""The page itself: one HTML file with everything in it, which needs neither network nor JavaScript."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from lerobot_lisa.analysis.figures.plot import Plot, write
from lerobot_lisa.analysis.figures.style import DPI, styled
from lerobot_lisa.errors import UserError

FIGURES = "figures"


@dataclass(frozen=True)
class Picture:
    """A figure as it stands in the page.

    Attributes:
        name: Of its files.
        title: What it shows.
        reading: How to read it.
        source: The PNG, as a data URI.
        width: On the page, in CSS pixels.
        height: On the page.
        table: Numbers shown as text; None: they are in the CSV only.
    """

    name: str
    title: str
    reading: str
    source: str
    width: int
    height: int
    table: pd.DataFrame | None = None


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        name: For links.
        title: Heading.
        introduction: A sentence or two below it.
        pictures: Its figures.
        heads: One for each figure where a figure has a heading of its own, else empty.
    """

    name: str
    title: str
    introduction: str
    pictures: Sequence[Picture]
    heads: Sequence[Any] = ()


def pictures(plots: Iterable[Plot], folder: Path, with_tables: bool = False) -> list[Picture]:
    """Draw and write figures one after the other, and keep of each what the page needs."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    with styled():
        for plot in plots:  # drawn here, so that a hundred figures are never in memory together
            write(plot, folder)
            kept.append(_picture(plot, folder, plot.table if with_tables else None))
    return kept


def _picture(plot: Plot, folder: Path, table: pd.DataFrame | None) -> Picture:
    from PIL import Image

    path = folder / f"{plot.name}.png"
    with Image.open(path) as drawn:
        width, height = (round(side * 96 / DPI) for side in drawn.size)
    source = f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}"
    return Picture(plot.name, plot.title, plot.reading, source, width, height, table)


def render(sections: Sequence[Section], **facts: Any) -> str:
    """The page as HTML.

    Raises:
        UserError: jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ModuleNotFoundError:
        raise UserError("reports need jinja2: pip install lerobot_policy_lisa[analysis]") from None
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2").render(sections=sections, figures=FIGURES, **facts)
