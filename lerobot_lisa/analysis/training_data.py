"""What a checkpoint was trained on: its instructions and the names of its actions, if the dataset is still there."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_lisa.checkpoints.files import refusing
from lerobot_lisa.checkpoints.training import training_dataset
from lerobot_lisa.errors import UserError


@dataclass
class DatasetOptions:
    """A dataset, as `--dataset.root` and `--dataset.repo_id` name it."""

    root: Path | None = None
    """Its folder."""

    repo_id: str | None = None
    """Its name, if that is not its folder's."""


@dataclass(frozen=True)
class TrainingData:
    """The training dataset, as far as it could be found.

    Attributes:
        instructions: All different ones; None: not known.
        action_names: Of the classes or numbers of an action; None: not known.
        note: One sentence that says where this is from, or why there is nothing.
        annotated: Where the dataset is, if it is annotated with language; None: it is not, or not known.
    """

    instructions: set[str] | None
    action_names: list[str] | None
    note: str
    annotated: DatasetOptions | None = None


def find(checkpoint: str, root: Path | None = None, revision: str | None = None) -> TrainingData:
    """Look for the dataset that a checkpoint's `train_config.json` names, or in a folder.

    Args:
        checkpoint: Folder or Hub id.
        root: The dataset's folder, if it is not where it was in training.
        revision: Of the Hub's repository.

    Raises:
        UserError: There is no dataset in `root`, or the one there cannot be read.
    """
    named = training_dataset(checkpoint, revision)
    if root is not None:
        check_dataset(root)
        return _read(root, named or {})
    if named is None:
        return TrainingData(None, None, "The checkpoint does not name its training data; --dataset.root does.")
    found = _place(named)
    if not _is_dataset(found):
        where = named.get("root") or named["repo_id"]
        return TrainingData(None, None, f"The training data ({where}) are not here; --dataset.root says where.")
    return _read(found, named)


def check_dataset(root: Path) -> None:
    """Refuse a folder that is no LeRobotDataset.

    Raises:
        UserError: It is none.
    """
    if not _is_dataset(root):
        raise UserError(f"--dataset.root={root}: no LeRobotDataset (meta/info.json) there")


def _is_dataset(root: Path) -> bool:
    return (root / "meta" / "info.json").is_file()


def _place(named: dict[str, Any]) -> Path:
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return Path(named.get("root") or HF_LEROBOT_HOME / named["repo_id"])


def _read(root: Path, named: dict[str, Any]) -> TrainingData:
    with refusing(f"{root} is not the dataset of the checkpoint", "pass --dataset.root=FOLDER of that one"):
        return _read_metadata(root, named)


def _read_metadata(root: Path, named: dict[str, Any]) -> TrainingData:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.datasets.language import LANGUAGE_PERSISTENT

    meta = LeRobotDatasetMetadata(named.get("repo_id") or root.name, root=root)
    chosen = named.get("episodes")  # training may have used some episodes only
    listed = (task for number in chosen for task in meta.episodes[number]["tasks"]) if chosen else meta.tasks.index
    instructions = {str(task) for task in listed}
    names = meta.features.get("action", {}).get("names")
    note = f"Training data: {root}, {len(instructions):,} different instructions."
    action_names = list(names["classes"] if isinstance(names, dict) else names or []) or None
    annotated = DatasetOptions(root, meta.repo_id) if LANGUAGE_PERSISTENT in meta.features else None
    return TrainingData(instructions, action_names, note, annotated)
