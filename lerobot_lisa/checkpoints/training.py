"""Which dataset a checkpoint says that it was trained on."""

from typing import Any

from lerobot_lisa.checkpoints.files import find
from lerobot_lisa.errors import UserError

TRAINING = "train_config.json"


def training_dataset(name: str, revision: str | None = None) -> dict[str, Any] | None:
    """The dataset's part of the training configuration that `lerobot-train` keeps with a checkpoint.

    Args:
        name: Folder or Hub id.
        revision: Of the Hub's repository.

    Returns:
        Its `repo_id`, `root` and `episodes`, the latter two None if not set; None: the checkpoint does not tell, or
        not in LeRobot's way.
    """
    try:
        named = find(name, revision).json(TRAINING).get("dataset")
    except UserError:
        return None
    if not isinstance(named, dict):
        return None
    repo_id, root, episodes = (named.get(key) for key in ("repo_id", "root", "episodes"))
    if not isinstance(repo_id, str) or not isinstance(root, str | None) or not _are_numbers(episodes):
        return None
    return {"repo_id": repo_id, "root": root, "episodes": episodes}


def _are_numbers(episodes: Any) -> bool:
    """Whether it is a list of episode numbers, or nothing."""
    return episodes is None or (isinstance(episodes, list) and all(type(n) is int and n >= 0 for n in episodes))
