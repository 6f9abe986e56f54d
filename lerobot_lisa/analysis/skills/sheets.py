"""What one skill is: its words as a cloud, and strips of frames of what it does."""

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import font_manager
from matplotlib.axes import Axes
from numpy.typing import NDArray

from lerobot_lisa.analysis.drawing import GREY, PAGE_WIDTH, Grid, Plot, clip, new_figure, shorten
from lerobot_lisa.analysis.recording.frames import Example
from lerobot_lisa.analysis.skills.words import SkillWords, contributions, lift, normalise
from lerobot_lisa.errors import UserError

CLOUD = (420, 300)  # pixels
FRAME = 180  # pixels along the longer side of a frame
CLOUDS_A_LINE, MOST_CLOUDS = 5, 100


def skill_sheet(code: int, place: int, found: SkillWords, examples: Sequence[Example], font: Path | None) -> Plot:
    """A skill's word cloud beside strips of frames.

    Args:
        code: The skill.
        place: Its place among those whose words were counted.
        found: Words of all skills.
        examples: Chunks that the skill was followed in; there may be none.
        font: TrueType file for the cloud; None: DejaVu Sans.

    Raises:
        UserError: The font is none.
    """
    measures = {
        "count": found.counts, "share_of_skill": normalise(found.counts, 0), "lift": lift(found.counts),
        "bits": contributions(found.counts),
    }  # fmt: skip
    table = pd.DataFrame({"word": list(found.words), **{name: values[:, place] for name, values in measures.items()}})
    figure = new_figure(PAGE_WIDTH, 1.0 + 1.35 * max(1, len(examples)))
    left, right = figure.subfigures(1, 2, width_ratios=[1, 2.4], squeeze=False)[0]
    _draw_cloud(left.add_subplot(), dict(zip(table["word"], table["bits"], strict=True)), font)
    for place, example in enumerate(examples):
        _draw_strip(right.add_subplot(len(examples), 1, place + 1), example)
    reading = (
        "Left, words that are more frequent with this skill than usual, by how much they say about it. Right, what "
        "happens while the code holds, in chunks drawn by lot. Good: the frames do what the words say."
    )
    table = table.sort_values("bits", ascending=False, kind="stable")
    return Plot(f"skill_{code:03d}", f"Skill {shorten(found.labels[place], 100)}", figure, table, reading)


def clouds_plot(found: SkillWords, font: Path | None = None) -> Plot:
    """The word clouds of all skills that were used, the first `MOST_CLOUDS` of `found`, side by side.

    Raises:
        UserError: The font is none, or wordcloud is not installed.
    """
    weights = contributions(found.counts)
    used = np.flatnonzero(found.counts.sum(0))
    shown = used[:MOST_CLOUDS]
    lines = -(-max(1, len(shown)) // CLOUDS_A_LINE)
    figure = new_figure(PAGE_WIDTH, 1.6 * lines)
    for axes, place in zip_longest(figure.subplots(lines, CLOUDS_A_LINE, squeeze=False).ravel(), shown):
        if place is None:
            axes.set_axis_off()
            continue
        _draw_cloud(axes, dict(zip(found.words, weights[:, place], strict=True)), font)
        axes.set_title(shorten(found.labels[place], 28), fontsize=8)
    table = Grid(weights, found.words, found.labels, ("word", "skill code"), "bits").table(
        bits=weights, count=found.counts
    )
    left_out = f" {len(used) - len(shown):,} more are in the CSV only." if len(used) > len(shown) else ""
    reading = (
        "Words that are more frequent with a skill than usual, larger the more they say about it. Good: few large "
        "words that belong together, others than the neighbours'." + left_out
    )
    return Plot("skill_word_clouds", "Words of each skill that was used", figure, table, reading)


def _draw_cloud(axes: Axes, weights: dict[str, float], font: Path | None) -> None:
    axes.set_axis_off()
    telling = {clip(word): weight for word, weight in weights.items() if weight > 0}
    if not telling:
        axes.text(0.5, 0.5, "no word is more\nfrequent than usual", ha="center", va="center", color=GREY)
        return
    axes.imshow(word_cloud(telling, font), interpolation="antialiased")


def word_cloud(weights: dict[str, float], font: Path | None = None) -> NDArray[np.uint8]:
    """A picture of words, larger for more weight, black on white; the same weights give the same picture.

    Raises:
        UserError: The font is none, or wordcloud is not installed.
    """
    try:
        from wordcloud import WordCloud
    except ModuleNotFoundError:
        raise UserError("word clouds need wordcloud: pip install lerobot_policy_lisa[analysis]") from None
    cloud = WordCloud(
        font_path=str(font) if font else font_manager.findfont("DejaVu Sans"),
        width=CLOUD[0],
        height=CLOUD[1],
        background_color="white",
        color_func=lambda *_, **__: "black",
        prefer_horizontal=1.0,
        max_words=40,
        relative_scaling=0.5,
        random_state=0,
    )
    return cloud.generate_from_frequencies(weights).to_array()


def check_font(font: Path) -> None:
    """Refuse what is no font, before an evaluation is run for it.

    Raises:
        UserError: It cannot be read as one.
    """
    from PIL import ImageFont

    try:
        ImageFont.truetype(str(font), 12)
    except OSError as error:
        raise UserError(f"--font={font}: no font that can be read ({error}): give a .ttf or .otf file") from error


def _draw_strip(axes: Axes, example: Example) -> None:
    axes.set_axis_off()
    where = f"{clip(example.group)}/{example.task_id}, episode {example.episode}, from step {example.step}"
    axes.set_title(f"“{clip(example.instruction, 80)}” ({where})", fontsize=7, fontweight="normal")
    axes.imshow(strip(example.pictures()), interpolation="antialiased")


def strip(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Frames side by side with white between them, (height, width, 3)."""
    from PIL import Image

    scale = min(1.0, FRAME / max(pictures[0].shape[:2]))
    size = (round(pictures[0].shape[1] * scale), round(pictures[0].shape[0] * scale))
    small = [np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS)) for picture in pictures]
    gap = np.full((size[1], 8, 3), 255, np.uint8)
    return np.concatenate([part for picture in small for part in (picture, gap)][:-1], axis=1)
