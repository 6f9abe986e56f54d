"""How well skill codes match the subtasks that demonstrations are annotated with.

python -m lerobot_lisa.analysis.annotations --policy.path=outputs/lisa/checkpoints/last/pretrained_model \
    --dataset.root=data/bosslevel_1k --output_dir=outputs/annotations

The dataset is one that `lerobot-annotate` has annotated, or BabyAI's from `generate --subtasks`. No world is needed:
the skill predictor is asked about the demonstrations. `lisa-report` says the same of annotated training data.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_lisa.analysis.annotations import answer
from lerobot_lisa.analysis.annotations.compare import Settings, as_json, compare, lines
from lerobot_lisa.analysis.annotations.match import TOLERANCE
from lerobot_lisa.analysis.annotations.subtasks import SUBTASK
from lerobot_lisa.analysis.commands import check_number, run_command
from lerobot_lisa.analysis.drawing import styled, write
from lerobot_lisa.analysis.files import write_json
from lerobot_lisa.analysis.material import PERMUTATIONS
from lerobot_lisa.analysis.recording.demonstrations import DemonstrationsConfig, open_dataset


@dataclass(kw_only=True)
class AnnotationsConfig(DemonstrationsConfig):
    """Which policy to compare with which demonstrations."""

    n_episodes: int = 1000
    """Episodes of the dataset, the first ones."""

    style: str = SUBTASK
    """LeRobot's style of the annotations: "subtask", or another that lasts until the next one, such as "plan"."""

    tolerance: int = TOLERANCE
    """Steps that a change of code may be off a change of subtask."""

    permutations: int = PERMUTATIONS
    """How often each episode's codes are put in another order, to see what chance gives."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/annotations"))
    """For annotations.json and the figures as PNG, PDF and CSV."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        check_number("n_episodes", self.n_episodes, 1, 10_000_000)
        check_number("tolerance", self.tolerance, 0, 1_000)
        check_number("permutations", self.permutations, 20, 100_000)


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run)


def run(config: AnnotationsConfig) -> None:
    """Compare, print and write.

    Raises:
        UserError: The dataset or the checkpoint cannot be used.
    """
    dataset = open_dataset(Path(str(config.dataset.root)), config.dataset.repo_id)
    settings = Settings(config.n_episodes, config.permutations, config.tolerance, config.style)
    made = compare(config, dataset, settings)
    config.output_dir.mkdir(parents=True, exist_ok=True)
    print(*lines(made), sep="\n")
    with styled():
        for plot in answer.plots(made):
            write(plot, config.output_dir)
            print(config.output_dir / f"{plot.name}.png")
    write_json(as_json(made), config.output_dir / "annotations.json", indent=2)
    print(config.output_dir / "annotations.json")


if __name__ == "__main__":
    sys.exit(main())
