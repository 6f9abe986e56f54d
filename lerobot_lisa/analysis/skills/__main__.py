"""What each skill's words are: which skill codes a LISA policy uses for which words of a dataset's instructions.

python -m lerobot_lisa.analysis.skills --policy.path=outputs/lisa/checkpoints/last/pretrained_model \
    --dataset.root=data/gotoseq_1k --output_dir=outputs/skill_words

No world is needed: the skill predictor is asked about every demonstration. `lisa-report` says the same, and more, of
what a policy does by itself.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.drawing import clip, styled, write
from lerobot_lisa.analysis.recording.demonstrations import DemonstrationsConfig, ask, load, open_dataset
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills import words
from lerobot_lisa.analysis.skills.choices import Choices, choices
from lerobot_lisa.analysis.skills.sheets import clouds_plot
from lerobot_lisa.analysis.skills.words import SkillWords, count_words, top_words


@dataclass(kw_only=True)
class SkillsConfig(DemonstrationsConfig):
    """Which policy to ask about which demonstrations."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/skill_words"))
    """For heat maps and word clouds as PNG, PDF and CSV."""


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run)


def run(config: SkillsConfig) -> None:
    """Load, count, print and write.

    Raises:
        UserError: The dataset or the checkpoint cannot be used.
    """
    root = Path(str(config.dataset.root))
    dataset = open_dataset(root, config.dataset.repo_id)
    loaded = load(config, dataset)
    config.output_dir.mkdir(parents=True, exist_ok=True)  # before the asking, which takes its time
    made, found = count(ask(*loaded, dataset))
    print(*said(made, found), sep="\n")
    with styled():
        maps = words.plots(found, f"{root.name}, {made.episodes:,} episodes, {len(made.table):,} skill codes")
        for plot in (*maps, clouds_plot(found)):
            write(plot, config.output_dir)
            print(config.output_dir / f"{plot.name}.png")


def count(trace: Trace) -> tuple[Choices, SkillWords]:
    """The choices of a trace, and words by skill."""
    made = choices(trace)
    return made, count_words(trace.episodes["instruction"].tolist(), made.used, made.labels)


def said(made: Choices, found: SkillWords) -> list[str]:
    """The words that are more frequent with each skill than usual, and how many skills there are."""
    episodes = made.used.sum(0)
    lines = [
        f"skill {label:>2}  {episodes[code]:6d} episodes  "
        + ", ".join(f"{clip(word)} x{times:.1f}" for word, times in listed)
        for code, (label, listed) in enumerate(zip(found.labels, top_words(found), strict=True))
        if episodes[code]
    ]
    return [*lines, f"{len(lines)} of {made.size} codes used, perplexity {made.perplexity:.1f}"]


if __name__ == "__main__":
    sys.exit(main())
