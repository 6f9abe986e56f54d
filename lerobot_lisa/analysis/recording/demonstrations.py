"""What the skill predictor chooses in the demonstrations of a dataset: a trace without a world."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.recording.evaluation import CheckpointConfig, code_labels, lisa_config
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.training_data import DatasetOptions, check_dataset
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy


@dataclass(kw_only=True)
class DemonstrationsConfig(CheckpointConfig):
    """Which policy to ask about which demonstrations."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    """The demonstrations."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        if self.dataset.root is None:
            raise UserError("--dataset.root is missing: name the folder of a LeRobotDataset")
        check_dataset(self.dataset.root)
        lisa_config(self)


def open_dataset(root: Path, repo_id: str | None = None) -> "LeRobotDataset":
    """The dataset in a folder, which is called like the folder if nothing else is said."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # takes seconds to import

    return LeRobotDataset(repo_id or root.name, root=root)


def load(config: CheckpointConfig, dataset: "LeRobotDataset") -> tuple["LisaPolicy", Any]:
    """The checkpoint's policy, reading whole episodes of `dataset`, and its preprocessor.

    Raises:
        UserError: It is none of LISA, has no codes, or the dataset lacks a feature that it reads.
    """
    from lerobot_lisa.checkpoints.load import load_checkpoint

    settings = lisa_config(config)
    for key, feature in {**settings.input_features, **settings.output_features}.items():
        found = tuple(dataset.meta.features.get(key, {}).get("shape", ()))
        if sorted(found) != sorted(feature.shape):  # images have channels last in a dataset, first in a policy
            had = f"has it with shape {found}" if found else "lacks it"
            reads = f"--policy.path={config.checkpoint} reads `{key}` {tuple(feature.shape)}"
            raise UserError(f"{reads}: {dataset.root} {had}")
    policy, preprocess, _, _ = load_checkpoint(settings, dataset=dataset.meta)
    return policy, preprocess


def ask(
    policy: "LisaPolicy", preprocess: Any, dataset: "LeRobotDataset", batch_size: int = 64, most: int | None = None
) -> Trace:
    """The codes that the skill predictor chooses in every episode of a dataset, in evaluation mode, as training does.

    Args:
        policy: Loaded for the dataset.
        preprocess: Its preprocessor.
        dataset: All of a dataset.
        batch_size: Episodes at a time.
        most: Episodes, the first ones; None: all.

    Returns:
        A trace of the steps at which it is asked: 0, H, 2H, ..., or more often. An episode is a run of frames with one
        instruction, of which `start` is the first frame in the dataset.
    """
    import torch
    from lerobot.utils.collate import lerobot_collate_fn
    from torch.utils.data import DataLoader, Subset
    from tqdm import tqdm

    from lerobot_lisa.episodes.runs import task_runs

    runs = task_runs(dataset.meta)
    starts, lengths = runs.starts[:most].tolist(), runs.lengths[:most]
    quantized, instructions = [], []
    hook = policy.network.quantizer.register_forward_hook(lambda _module, _inputs, skills: quantized.append(skills))
    policy.eval()
    if policy.config.learned_steps:  # of pictures, whose whole episodes are asked about all the same
        policy.config.excerpt_steps, batch_size = 0, 4
    with torch.no_grad():
        loader = DataLoader(Subset(dataset, starts), batch_size, collate_fn=lerobot_collate_fn)
        for batch in tqdm(loader, desc="asking for skills", unit="batch", disable=None):
            instructions += batch["task"]
            policy.forward(preprocess(batch))
    hook.remove()
    numbers = {"episode": range(len(starts)), "start": starts, "steps": lengths, "instruction": instructions}
    episodes = pd.DataFrame({"group": "dataset", "task_id": 0, **numbers})
    every = policy.config.question_stride
    steps = episodes.drop(columns=["start", "steps"]).loc[episodes.index.repeat(-(-lengths // every))]
    steps["step"] = every * steps.groupby("episode").cumcount()
    steps["code"] = torch.cat([skills.codes for skills in quantized]).cpu().numpy().astype(np.int64)
    asked = {name: getattr(policy.config, name) for name in ("horizon", "termination_stride")}
    return Trace(steps, episodes, {"policy": asked, "codes": code_labels(policy)})
