"""The page itself: one HTML file with everything in it, which needs neither network nor JavaScript."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from lerobot_lisa.analysis.drawing import DPI, Plot, clip, styled, write
from lerobot_lisa.analysis.material import Answer, Heading
from lerobot_lisa.errors import UserError

FIGURES = "figures"


class Picture(NamedTuple):
    """A figure as it stands in the page.

    Attributes:
        plot: Its name, title and reading; without its drawing, so that a hundred are never in memory together.
        source: The PNG, as a data URI.
        size: Width and height on the page, in CSS pixels.
        heading: Above it; None: it has none.
        table: Numbers shown as text; None: they are in the CSV only.
    """

    plot: Plot
    source: str
    size: tuple[int, int]
    heading: Heading | None
    table: pd.DataFrame | None


class Section(NamedTuple):
    """A question's answer, drawn."""

    answer: Answer
    pictures: list[Picture]


def draw(answers: Iterable[Answer], folder: Path) -> list[Section]:
    """Draw and write figures one after the other, and keep of each what the page needs."""
    folder.mkdir(parents=True, exist_ok=True)
    with styled():
        return [Section(answer, _pictures(answer, folder)) for answer in answers]


def _pictures(answer: Answer, folder: Path) -> list[Picture]:
    kept = []
    for number, plot in enumerate(answer.plots):
        write(plot, folder)
        source, size = _as_shown(folder / f"{plot.name}.png")
        heading = answer.headings[number] if answer.headings else None
        table = answer.as_text(plot.table) if answer.as_text else None
        kept.append(Picture(replace(plot, figure=Figure()), source, size, heading, table))
    return kept


def _as_shown(path: Path) -> tuple[str, tuple[int, int]]:
    from PIL import Image

    with Image.open(path) as drawn:
        width, height = (round(side * 96 / DPI) for side in drawn.size)
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}", (width, height)


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
