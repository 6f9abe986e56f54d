"""Draws docs/figures/architecture.png, the house and the two trips: python docs/figures/architecture.py"""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

INK, PAPER, TRAINING, ACTING, BOTH = "#1f2933", "#ffffff", "#1f6fb2", "#c4561a", "#5c6773"
FLOORS = [  # the ground floor first; each room with what it is for
    [("networks/", "plain torch, no LeRobot: encoders, asking, skill predictor, copying, quantisers, policy, heads")],
    [("episodes/", "whole episodes: store, checks, symmetries")],
    [
        ("policies/", "LeRobot's protocol: lisa, lang_dt, original baselines"),
        ("envs/", "babyai, lorel, metaworld_states"),
    ],
    [("checkpoints/", "load them, run nothing"), ("dataset_converters/", "babyai, lorel, metaworld, cluster")],
    [
        (
            "analysis/",
            "recording; a folder for each question: success, listening, skills, annotations, control; report, training",
        )
    ],
    [("reproduce/", "rows of the paper's tables, run by the commands below")],
]
WIDTHS = [[96], [62], [62, 32], [62, 32], [96], [96]]
SHARED = [  # what both trips pass through, in order
    ("encode", "instruction,\nobservations"),
    ("words ask", "parts of what\nis seen"),
    ("skill\npredictor", "one answer\nevery H steps"),
    ("copy", "phrases of the\ninstruction"),
    ("quantiser", "nearest of\nK skill codes"),
    ("code asks", "parts of what\nis seen"),
    ("policy", "one chunk of\nH steps"),
    ("head", "one prediction\nfor each step"),
]
TRAIN_IN = [
    ("lerobot-train", "frames, preprocessed"),
    ("forward", "a batch in policies/"),
    ("gather", "whole episodes"),
    ("symmetries", "where data name them"),
]
ACT_IN = [
    ("environment\nor robot", "one observation"),
    ("preprocessor", "names, tokens, scale"),
    ("select_action", "one step in policies/"),
    ("history", "what is remembered"),
]


def box(axes: Axes, at: tuple[float, float, float, float], title: str, below: str, color: str) -> None:
    """A room, or a station of a trip: left, bottom, width and height."""
    x, y, width, height = at
    style = "round,pad=0,rounding_size=0.9"
    axes.add_patch(
        FancyBboxPatch((x, y), width, height, boxstyle=style, facecolor=PAPER, edgecolor=color, linewidth=1.4)
    )
    lines = title.count("\n") - below.count("\n")
    middle = y + height * (0.66 - 0.04 * lines)
    axes.text(x + width / 2, middle, title, ha="center", va="center", fontsize=9.5, weight="bold", color=color)
    axes.text(x + width / 2, y + height * 0.27, below, ha="center", va="center", fontsize=7.6, color=INK)


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    """From one place to another."""
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "color": color, "lw": 1.5, "shrinkA": 0, "shrinkB": 0}
    )


def draw_house(axes: Axes, bottom: float) -> None:
    """Floor upon floor; imports go down only."""
    for number, (rooms, widths) in enumerate(zip(FLOORS, WIDTHS, strict=True)):
        x = 2.0
        for (name, what), width in zip(rooms, widths, strict=True):
            box(axes, (x, bottom + 6.4 * number, width, 5.4), name, what, INK)
            x += width + 2
    axes.text(
        2, bottom + 6.4 * len(FLOORS) + 1.4, "The house: imports go down only", fontsize=12, weight="bold", color=INK
    )


def draw_row(axes: Axes, y: float, stations: list[tuple[str, str]], color: str, width: float = 10.4) -> None:
    """Stations from left to right, an arrow between each two."""
    for number, (name, what) in enumerate(stations):
        x = 2 + number * (width + 1.83)
        box(axes, (x, y, width, 8), name, what, color)
        if number:
            arrow(axes, (x - 1.83, y + 4), (x, y + 4), color)


def draw_trips(axes: Axes) -> None:
    """Training above, acting below, what both share between them."""
    axes.text(2, 45.5, "The two trips", fontsize=12, weight="bold", color=INK)
    for y, stations, color in ((34.5, TRAIN_IN, TRAINING), (2.5, ACT_IN, ACTING)):
        for number, (name, what) in enumerate(stations[:4]):
            x = 2 + number * 19.5
            box(axes, (x, y, 16.5, 8), name, what, color)
            if number:
                arrow(axes, (x - 3, y + 4), (x, y + 4), color)
    draw_row(axes, 18.5, SHARED, BOTH)
    axes.text(9, 27.6, "the same networks and the same numbers on both trips", fontsize=8.5, style="italic", color=BOTH)
    box(axes, (82, 34.5, 16, 8), "loss", "cross-entropy or squared\nerror + commitment", TRAINING)
    box(axes, (82, 2.5, 16, 8), "action", "postprocessor, then\nback to the world", ACTING)
    for y, top, color in ((34.5, True, TRAINING), (10.5, False, ACTING)):
        near = 26.5 if top else 18.5
        axes.plot([68.7, 68.7, 5.5], [y, (y + near) / 2, (y + near) / 2], color=color, lw=1.5)
        arrow(axes, (5.5, (y + near) / 2), (5.5, near), color)
        arrow(axes, (93, near), (93, y), color)


def main() -> None:
    """Draw it."""
    figure = Figure(figsize=(11, 10.1), facecolor=PAPER)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 100), ylim=(0, 94.4))
    axes.axis("off")
    draw_house(axes, 51)
    draw_trips(axes)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
