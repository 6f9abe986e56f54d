"""The page itself: one HTML file with everything in it, which needs neither network nor JavaScript."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from lerobot_lisa.analysis.drawing import DPI, Plot, clip, styled, write
from lerobot_lisa.analysis.material import Answer, Heading
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
        heading: Above it; None: it has none.
        table: Numbers shown as text; None: they are in the CSV only.
    """

    name: str
    title: str
    reading: str
    source: str
    width: int
    height: int
    heading: Heading | None = None
    table: pd.DataFrame | None = None


@dataclass(frozen=True)
class Section:
    """A question's answer, drawn."""

    answer: Answer
    pictures: Sequence[Picture]


def draw(answers: Iterable[Answer], folder: Path) -> list[Section]:
    """Draw and write figures one after the other, and keep of each what the page needs."""
    folder.mkdir(parents=True, exist_ok=True)
    with styled():
        return [Section(answer, _pictures(answer, folder)) for answer in answers]


def _pictures(answer: Answer, folder: Path) -> list[Picture]:
    kept = []
    for number, plot in enumerate(answer.plots):
        write(plot, folder)
        heading = answer.headings[number] if answer.headings else None
        kept.append(_picture(plot, folder, heading, answer.as_text(plot.table) if answer.as_text else None))
    return kept


def _picture(plot: Plot, folder: Path, heading: Heading | None, table: pd.DataFrame | None) -> Picture:
    from PIL import Image

    path = folder / f"{plot.name}.png"
    with Image.open(path) as drawn:
        width, height = (round(side * 96 / DPI) for side in drawn.size)
    source = f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}"
    return Picture(plot.name, plot.title, plot.reading, source, width, height, heading, table)


def render(sections: Sequence[Section], **more: Any) -> str:
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
    environment.filters["clip"] = clip
    return environment.get_template("page.html.j2").render(sections=sections, figures=FIGURES, **more)
