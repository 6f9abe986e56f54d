"""The figures of docs/results.md, from the files that its tables are from: ours beside the paper's, and curves."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lerobot_lisa.analysis.drawing import DPI, GREY, INK, LIGHT, new_figure, styled
from lerobot_lisa.analysis.files import aside
from lerobot_lisa.reproduce.cells import called, pooled
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import MAIN, Row
from lerobot_lisa.reproduce.tables import place

FOLDER = "figures/results"  # in docs
_WIDTH, _BAR = 8.0, 0.38  # inches that a figure is wide and that a bar takes
_STYLES = ("-", "--", ":", "-.")  # of lines: told apart without colors
_MARKERS = ("o", "s", "^", "D")
_VARIED = {"horizon": re.compile(r", horizon (\d+)$"), "number of skills": re.compile(r", (\d+) skills$")}


def beside_paper(runs: Sequence[Outcome], rows: Iterable[Row]) -> Figure | None:
    """Two bars for every policy of a row that the paper has a number of and we have run; None: there is none."""
    compared = [
        (row, policy, own)
        for row in rows
        if row.table in MAIN
        for policy in row.policies
        if policy in row.paper and (own := _of(runs, row, policy))
    ]
    if not compared:
        return None
    compared.sort(key=lambda each: place(each[0].title, 0, each[1]))
    figure = new_figure(_WIDTH, 1 + 2 * _BAR * len(compared))
    axes = figure.add_subplot()
    for line, (row, policy, own) in enumerate(compared):
        rate, (theirs, spread) = pooled(own), row.paper[policy]
        reach = [[rate.percent - rate.low], [rate.high - rate.percent]]
        first = line == 0
        axes.barh(line - 0.19, rate.percent, 0.36, xerr=reach, color=GREY, ecolor=INK, label="here" if first else None)
        label = "the paper" if first else None
        axes.barh(line + 0.19, theirs, 0.36, xerr=spread or None, color=LIGHT, ecolor=INK, label=label)
    axes.set_yticks(range(len(compared)), [f"{row.title}, {called(policy)}" for row, policy, _ in compared])
    axes.invert_yaxis()
    axes.set(xlabel="success, %; lines: here a 95 % interval over episodes, in the paper plus-minus", xlim=(0, 100))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def learning_curves(runs: Sequence[Outcome], rows: Iterable[Row]) -> Figure | None:
    """Success after so many steps, from nothing and from another level's skills; None: no curve has two points."""
    levels: dict[str, list[tuple[str, list[tuple[int, Outcome]]]]] = {}
    for row in rows:
        if row.curve and (points := sorted(_points(runs, row), key=lambda point: point[0])):
            levels.setdefault(row.data["level"], []).append((row.title.partition(", ")[2], points))
    levels = {level: curves for level, curves in levels.items() if any(map(_moves, curves))}
    if not levels:
        return None
    figure = new_figure(_WIDTH, 3.2)
    for number, (level, curves) in enumerate(levels.items()):
        axes = figure.add_subplot(1, len(levels), number + 1)
        for style, marker, (name, points) in zip(_STYLES, _MARKERS, curves, strict=False):
            _draw_curve(axes, name, points, style, marker)
        axes.set(title=level, xlabel="steps of training", ylabel="success in percent", ylim=(0, 100))
        axes.legend()
    return figure


def _moves(curve: tuple[str, Sequence[tuple[int, Outcome]]]) -> bool:
    return len({steps for steps, _ in curve[1]}) > 1


def _draw_curve(axes: Axes, name: str, points: Sequence[tuple[int, Outcome]], style: str, marker: str) -> None:
    """A line in its interval; what was evaluated once is a point with its interval."""
    steps = list(dict.fromkeys(at for at, _ in points))
    rates = [pooled([run for at, run in points if at == each]) for each in steps]
    (line,) = axes.plot(steps, [rate.percent for rate in rates], style, marker=marker, markersize=4, label=name)
    low, high = [rate.low for rate in rates], [rate.high for rate in rates]
    if len(steps) == 1:
        axes.vlines(steps, low, high, alpha=0.5, color=line.get_color())
    axes.fill_between(steps, low, high, alpha=0.15, color=line.get_color(), linewidth=0)


def information(runs: Sequence[Outcome], rows: Iterable[Row]) -> Figure | None:
    """Bits between instructions and codes during training, by horizon and by number of skills; None: none was kept."""
    ours = {row.title for row in rows if row.table == "ablations"}
    panels: dict[str, list[tuple[int, Outcome]]] = {}
    for run in runs:
        for varied, pattern in _VARIED.items():
            if run["row"] in ours and run.get("information") and (found := pattern.search(run["row"])):
                panels.setdefault(varied, []).append((int(found[1]), run))
    if not panels:
        return None
    figure = new_figure(_WIDTH, 3.2)
    for number, (varied, curves) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), number + 1)
        ordered = sorted(curves, key=lambda curve: curve[0])
        for (size, run), style in zip(ordered, _STYLES, strict=False):
            axes.plot(*zip(*run["information"], strict=True), style, label=str(size))
        axes.set(title=f"BossLevel, {varied}", xlabel="steps of training", ylabel="bits", ylim=(0, None))
        axes.legend()
    return figure


def _of(runs: Iterable[Outcome], row: Row, policy: str) -> list[Outcome]:
    limit = row.evaluate.get("env.max_episode_steps")
    own = [run for run in runs if (run["row"], run["policy"]) == (row.title, policy)]
    return [run for run in own if run["env"]["max_episode_steps"] == limit or row.family != "babyai"]


def _points(runs: Iterable[Outcome], row: Row) -> Iterable[tuple[int, Outcome]]:
    for run in runs:
        if run["row"] == row.title:
            at = run["policy"].partition("@")[2]
            yield int(at or run["depends"]["of"]["config"]["steps"]), run


class _Drawing(NamedTuple):
    draw: Callable[[Sequence[Outcome], Iterable[Row]], Figure | None]
    caption: str


DRAWINGS = {
    "paper": _Drawing(beside_paper, "Success of every row that was run, beside the paper's"),
    "transfer": _Drawing(learning_curves, "Success during training, from nothing and from another level's skills"),
    "information": _Drawing(information, "Bits between instructions and skill codes during training"),
}


def link(name: str, runs: Sequence[Outcome], rows: Iterable[Row]) -> str:
    """What the page says where a figure belongs."""
    drawing = DRAWINGS[name]
    there = drawing.draw(runs, rows) is not None
    return f"![{drawing.caption}]({FOLDER}/{name}.png)" if there else "Nothing to draw yet."


def draw_all(runs: Sequence[Outcome], rows: Sequence[Row], docs: Path) -> None:
    """Draw every figure that there are numbers for."""
    with styled():
        for name, drawing in DRAWINGS.items():
            if figure := drawing.draw(runs, rows):
                path = docs / FOLDER / f"{name}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                with aside(path) as partial:
                    figure.savefig(partial, format="png", dpi=DPI, metadata={"Software": None})
