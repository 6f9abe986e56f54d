"""What does a skill look at? Its attention by what things are called, and over the places of what is seen."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from lerobot_lisa.analysis.drawing import (
    GREY,
    MOST_CODES,
    PAGE_WIDTH,
    Grid,
    Plot,
    heat_map,
    new_figure,
    shorten,
)  # fmt: skip
from lerobot_lisa.analysis.material import Answer, Material
from lerobot_lisa.analysis.recording.looks import Look

MOST_PANELS, MOST_NAMES, ACROSS = 36, 40, 6
_MARK = "#d55e00"  # beside grey for the colour-blind too
LOOKS = (
    "A skill code asks what is seen: which of you is called so, and where are you? What answers gets a share of its "
    "attention, and what nothing answers to stays at nothing, as when the thing is not in view. Attention is what the "
    "policy is offered, not what it does with it: it also sees the observation as a whole, so a skill that looks at "
    "nothing is not blind, and one that looks at the right thing may yet not go there. Whether words reach actions is "
    "what heard, above, measures."
)
WORDS = (
    "The instruction's words ask what is seen: which of you is called so, and where are you? What answers gets a share "
    "of each word's attention; words such as “the”, which nothing answers to, keep theirs, so that less than all of "
    "it going to something is no fault. Attention is what the policy is offered, not what it does with it: it also "
    "sees the observation as a whole. Whether words reach actions is what heard, above, measures."
)
_BY_NAME = (
    "Rows are skills, columns what things in view are called; each cell is the share of a skill's attention that went "
    "there, and what is missing to 100 % went to nothing. Good: each row has one dark cell, and it is what the skill "
    "is called or what its words say. A row that is dark everywhere looks at whatever there is. The CSV also says in "
    "how many steps each was in view at all: a thing that always is gets looked at more easily."
)
_WHERE = (
    "Darker is more attention, each panel on its own scale, averaged over all steps that followed the skill. It shows "
    "where the skill's things were as much as where it turned: what one walks up to ends up in front."
)
_FROM_ABOVE = " Seen from above: the triangle is the agent, which looks up."
_OVER_PICTURE = (
    " Below it one picture that was seen under the skill; where the camera or the things move, patches mean less than "
    "the picture suggests."
)


class Looker(NamedTuple):
    """One skill, or the instruction of a policy without skill codes.

    Attributes:
        label: What it is called.
        looks: Where it looked, by feature.
    """

    label: str
    looks: Mapping[str, Look]

    @property
    def steps(self) -> int:
        """How many it was followed in."""
        return next(iter(self.looks.values())).steps

    @property
    def questions(self) -> int:
        """How many it asked in them, each with an attention of 1."""
        return max(1, next(iter(self.looks.values())).questions)

    @property
    def paid(self) -> float:
        """Share of its attention that went to something."""
        return sum(float(look.attention.sum()) for look in self.looks.values()) / self.questions

    @property
    def named(self) -> dict[str, float]:
        """Share of its attention by what things are called, most first; without what got none."""
        found = {name: value / self.questions for look in self.looks.values() for name, value in look.named.items()}
        return dict(sorted(((name, share) for name, share in found.items() if share > 0), key=lambda item: -item[1]))

    @property
    def in_view(self) -> dict[str, float]:
        """Share of its steps in which something so called could be looked at."""
        return {name: times / self.steps for look in self.looks.values() for name, times in look.in_view.items()}

    def in_words(self) -> str:
        """How much of its attention it pays to anything at all, and to what."""
        if self.paid < 0.005:
            return "looks at nothing"
        listed = [(name, share / self.paid) for name, share in self.named.items() if share >= 0.01 * self.paid]
        to = ", ".join(f"{name} {100 * share:.0f} %" for name, share in listed[:4])
        return f"pays {100 * self.paid:.0f} % of its attention to something" + (f"; of that: {to}" if to else "")


def lookers(looks: Sequence[Look], labels: Sequence[str], alone: str) -> list[Looker]:
    """Skills in the order of how many steps they were followed in.

    Args:
        looks: Of all skills.
        labels: Of the K codes.
        alone: What asks if there are no codes.
    """
    by_code: dict[int | None, dict[str, Look]] = {}
    for look in looks:
        by_code.setdefault(look.code, {})[look.feature] = look
    found = [Looker(alone if code is None else labels[code], of_one) for code, of_one in by_code.items()]
    return sorted(found, key=lambda looker: -looker.steps)


def found_in(material: Material) -> list[Looker]:
    """Who looked in an evaluation; nobody if looks were not recorded."""
    flat = material.trace.origin["policy"]["type"] == "lang_dt"
    labels = material.trace.code_labels if material.trace.has_codes else []
    return lookers(material.looks, labels, "the instruction" if flat else "its skill")


def answer(material: Material) -> Answer:
    """The section about it."""
    found, has_codes = found_in(material), material.trace.has_codes
    recorded, steps = sum(looker.steps for looker in found), len(material.trace.steps)
    partly = f" Looks were recorded in {recorded:,} of {steps:,} steps." if recorded < steps else ""
    in_all = "" if has_codes else f" {found[0].label.capitalize()} {found[0].in_words()}."
    paid = sum(looker.paid * looker.questions for looker in found) / sum(looker.questions for looker in found)
    meaning = "of its attention goes to something that is seen, the rest to nothing"
    title = "Where skills look" if has_codes else "Where it looks"
    about = WORDS if material.trace.origin["policy"]["type"] == "lang_dt" else LOOKS
    numbers = [("Looks", f"{100 * paid:.0f} %", meaning)]
    return Answer("looks", title, about + in_all + partly, plots(found, material), numbers=numbers)


def plots(found: Sequence[Looker], material: Material) -> Iterator[Plot]:
    """By name, and over the places of each feature that has more than one."""
    yield by_name(found, material.sample)
    for feature, look in found[0].looks.items():
        if look.attention.size > 1:
            yield where(found, feature, material.sample, material.trace.world == "babyai")


def by_name(found: Sequence[Looker], sample: str) -> Plot:
    """Attention by what things are called, a row for each skill, as a heat map."""
    totals: dict[str, float] = {}
    for looker in found:
        for name, share in looker.named.items():
            totals[name] = totals.get(name, 0.0) + share * looker.questions
    names = sorted(totals, key=lambda name: -totals[name])
    shown, listed = found[:MOST_CODES], names[:MOST_NAMES] or ["nothing"]
    values = np.array([[100 * looker.named.get(name, 0.0) for name in listed] for looker in shown])
    grid = Grid(
        values, [looker.label for looker in shown], listed, ("skill code", "what it looks at"), "% of attention"
    )
    rows = [
        (looker.label, looker.steps, looker.paid, name, looker.named.get(name, 0.0), looker.in_view.get(name, 0.0))
        for looker in found
        for name in names or ["nothing"]
    ]
    columns = ["skill_code", "steps", "attention_paid", "name", "attention", "in_view"]
    figure = heat_map(grid, "What skills look at", sample, highest=max(1.0, float(values.max())))
    left_out = [f"{len(whole) - len(cut)} {what}" for whole, cut, what in (
        (found, shown, "rarer skills"), (names, listed, "rarer names")) if len(whole) > len(cut)]  # fmt: skip
    note = f" Left out: {' and '.join(left_out)}; the CSV has all." if left_out else ""
    return Plot("looks_by_name", "What skills look at", figure, pd.DataFrame(rows, columns=columns), _BY_NAME + note)


def where(found: Sequence[Looker], feature: str, sample: str, from_above: bool) -> Plot:
    """Attention over the places of a feature, a panel for each skill, the most frequent first.

    Args:
        found: Who looked.
        feature: At what.
        sample: What was counted, for the title.
        from_above: Whether a grid shows what lies before an agent in the middle of its last row.
    """
    shown, short = found[:MOST_PANELS], feature.removeprefix("observation.")
    lines = -(-len(shown) // ACROSS)
    figure = new_figure(PAGE_WIDTH, 0.5 + 2.1 * lines)
    figure.suptitle(f"Where skills look: {short}, {sample}", fontsize=10, fontweight="bold", x=0.01, ha="left")
    grid = from_above and shown[0].looks[feature].picture is None and shown[0].looks[feature].attention.shape == (7, 7)
    panels = figure.subplots(lines, ACROSS, squeeze=False).ravel()
    for axes, looker in zip(panels, shown, strict=False):
        _draw_panel(axes, looker, looker.looks[feature], grid)
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    pictured = any(looker.looks[feature].picture is not None for looker in shown)
    note = (_FROM_ABOVE if grid else "") + (_OVER_PICTURE if pictured else "")
    more = len(found) - len(shown)
    note += f" {more} rarer skills are left out; the CSV has all." if more else ""
    table = pd.concat([_places(looker, feature) for looker in found], ignore_index=True)
    return Plot(f"looks_{short.replace('.', '_')}", f"Where skills look: {short}", figure, table, _WHERE + note)


def _places(looker: Looker, feature: str) -> pd.DataFrame:
    attention = looker.looks[feature].attention / looker.questions
    row, column = np.indices(attention.shape)
    numbers = {"row": row.ravel(), "column": column.ravel(), "attention": attention.ravel()}
    return pd.DataFrame({"skill_code": looker.label, "feature": feature, **numbers})


def _draw_panel(axes: Axes, looker: Looker, look: Look, agent: bool) -> None:
    rows, columns = look.attention.shape
    highest = max(float(look.attention.max()), 1e-9)
    extent = (-0.5, columns - 0.5, rows - 0.5, -0.5)
    if look.picture is None:
        axes.imshow(look.attention, cmap="Greys", vmin=0, vmax=highest, aspect="auto" if rows == 1 else "equal")
    else:
        axes.imshow(_grey(look.picture), cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto")
        veil = np.zeros((rows, columns, 4))
        veil[..., :3] = (0.84, 0.37, 0.0)
        veil[..., 3] = 0.85 * look.attention / highest
        axes.imshow(veil, extent=extent, aspect="auto", interpolation="nearest")
    if agent:
        axes.plot(columns // 2, rows - 1, "^", color=_MARK, markersize=6)
    if look.picture is None:
        axes.set_xticks(np.arange(0.5, columns - 1), minor=True)
        axes.set_yticks(np.arange(0.5, rows - 1), minor=True)
        axes.grid(which="minor", color="0.88", linewidth=0.4)
    axes.tick_params(which="both", length=0)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=GREY)
    most = next(iter(looker.named), "")
    says = f"{100 * looker.paid:.0f} % paid" + (
        f", most to {shorten(most, 14)}" if most and looker.paid > 0.005 else ""
    )
    axes.set_title(f"{shorten(looker.label, 24)}\n", fontsize=8)
    axes.annotate(says, (0, 1), xycoords="axes fraction", xytext=(0, 3), textcoords="offset points", fontsize=7)


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    return picture.astype(np.float64).mean(-1)
