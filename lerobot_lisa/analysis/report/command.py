"""`lisa-report`: evaluate a checkpoint with LeRobot's own code, and say on one page what its skills mean.

lisa-report --policy.path=outputs/lisa/checkpoints/last/pretrained_model --env.type=babyai --env.task=GoToLocal \
    --n_episodes=200 --output_dir=reports/gotolocal
"""

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_lisa.analysis import training_data
from lerobot_lisa.analysis.annotations import answer as annotations
from lerobot_lisa.analysis.annotations.compare import Settings, compare
from lerobot_lisa.analysis.commands import check_number, run_command
from lerobot_lisa.analysis.listening import heard
from lerobot_lisa.analysis.material import PERMUTATIONS, Answer, Material
from lerobot_lisa.analysis.recording import frames, looks
from lerobot_lisa.analysis.recording.demonstrations import open_dataset
from lerobot_lisa.analysis.recording.environment import Watcher
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig
from lerobot_lisa.analysis.recording.frames import FrameCollector
from lerobot_lisa.analysis.recording.looks import LooksCollector
from lerobot_lisa.analysis.recording.record import NOTE, locked, record
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.report.build import FIGURES, PAGE, build
from lerobot_lisa.analysis.skills.sheets import check_font
from lerobot_lisa.analysis.training_data import DatasetOptions, TrainingData
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

TRACE, LISTENING = "trace", "listening"


@dataclass(kw_only=True)
class ReportConfig(EvaluationConfig):
    """What to evaluate and how to report it."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    """The training data, if they are no longer where the checkpoint's `train_config.json` says: they tell which
    instructions were seen.
    """

    listening: bool = True
    """Whether to run every episode a second time, told another instruction, to see how much of the success is
    listening; `lisa-diagnose heard` asks the same.
    """

    examples: int = 2
    """Strips of frames for each skill, 0 for none."""

    annotated_episodes: int = 1000
    """Episodes of the training data whose subtasks are compared with the skills, where they are annotated; 0: none."""

    permutations: int = PERMUTATIONS
    """How often instructions are dealt to other episodes, to see what chance gives."""

    font: Path | None = None
    """TrueType file for word clouds, for scripts that DejaVu Sans lacks."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        check_number("examples", self.examples, 0, 100)
        check_number("annotated_episodes", self.annotated_episodes, 0, 10_000_000)
        check_number("permutations", self.permutations, 20, 100_000)
        if self.font is not None:
            check_font(self.font)


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(report)


def report(config: ReportConfig) -> None:
    """Evaluate, unless that has been done, and write the report.

    Raises:
        UserError: The checkpoint, the environment, the training data or the folder cannot be used.
    """
    data = training_data.find(config.checkpoint, config.dataset.root, config.revision)
    _check_folder(config.output_dir)
    trace = _record(config)
    runs = heard.measure(config, config.output_dir / LISTENING, own=trace) if config.listening else None
    examples = frames.read(config.output_dir / TRACE, config.examples)
    looked = looks.read(config.output_dir / TRACE)
    annotated = _annotated(config, data)
    with locked(config.output_dir / TRACE), _building(config.output_dir) as folder:
        material = Material(trace, data, examples, looked, config.permutations, config.font)
        numbers = build(folder, material, runs, annotated)
        _move_in_place(folder, config.output_dir)
    for name, number, meaning in numbers:
        print(f"{name}: {number} ({meaning})")
    print(config.output_dir / PAGE)


def _check_folder(folder: Path) -> None:
    """Only what an earlier report left may be replaced."""
    ours = (folder / TRACE / NOTE).is_file()
    for name in (PAGE, FIGURES):
        if (folder / name).exists() and not ours:
            raise UserError(f"{folder / name} was not made by this program: choose another --output_dir")


def _record(config: ReportConfig) -> Trace:
    folder, horizon = config.output_dir / TRACE, getattr(config.policy, "horizon", None)
    watchers: list[Watcher] = []
    if isinstance(config.policy, EpisodePolicyConfig):
        watchers.append(LooksCollector(folder, config.policy))
    if config.examples and horizon is not None:
        watchers.append(FrameCollector(folder, horizon, config.examples))
    return record(config, folder, watchers)


def _annotated(config: ReportConfig, data: TrainingData) -> Answer | None:
    """What is to be said of skills and the subtasks of the training data; None where there are none or no codes."""
    coded = isinstance(config.policy, LisaConfig) and config.policy.n_codes
    if data.annotated is None or data.annotated.root is None or not coded or not config.annotated_episodes:
        return None
    settings = Settings(config.annotated_episodes, config.permutations)
    try:
        return annotations.answer(compare(config, open_dataset(data.annotated.root, data.annotated.repo_id), settings))
    except UserError as error:  # other annotations, or other names of features: no reason to be without a report
        return Answer(annotations.NAME, annotations.TITLE, f"Skills were not compared with annotations. {error}.")


@contextmanager
def _building(output: Path) -> Iterator[Path]:
    """A folder to build in; what a killed run has left is taken away."""
    folder = output / ".building"
    for left in output.glob(f"{folder.name}*"):
        shutil.rmtree(left)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _move_in_place(building: Path, folder: Path) -> None:
    """Replace an earlier report; the page comes last."""
    if (folder / FIGURES).exists():
        shutil.rmtree(folder / FIGURES)
    (building / FIGURES).rename(folder / FIGURES)
    (building / PAGE).replace(folder / PAGE)


if __name__ == "__main__":
    sys.exit(main())
