"""What each skill's words are: which skill codes a LISA policy uses for which words of a dataset's instructions.

python -m lerobot_lisa.analysis.skills --policy.path=outputs/lisa/checkpoints/last/pretrained_model \
    --dataset.root=data/gotoseq_1k --output_dir=outputs/skill_words

No world is needed: the skill predictor is asked about every demonstration. `lisa-report` says the same, and more, of
what a policy does by itself.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.drawing import clip, styled, write
from lerobot_lisa.analysis.recording.evaluation import CheckpointConfig, code_labels, lisa_config
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills import words
from lerobot_lisa.analysis.skills.choices import Choices, choices
from lerobot_lisa.analysis.skills.words import SkillWords, count_words, top_words
from lerobot_lisa.analysis.training_data import DatasetOptions, check_dataset
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy


@dataclass(kw_only=True)
class SkillsConfig(CheckpointConfig):
    """Which policy to ask about which demonstrations."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    """The demonstrations."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/skill_words"))
    """For the heat maps as PNG, PDF and CSV."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        if self.dataset.root is None:
            raise UserError("--dataset.root is missing: name the folder of a LeRobotDataset")
        check_dataset(self.dataset.root)
        lisa_config(self)


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run)


def run(config: SkillsConfig) -> None:
    """Load, count, print and write.

    Raises:
        UserError: The dataset or the checkpoint cannot be used.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # takes seconds to import

    root = Path(str(config.dataset.root))
    dataset = LeRobotDataset(config.dataset.repo_id or root.name, root=root)
    loaded = load(config, dataset)
    config.output_dir.mkdir(parents=True, exist_ok=True)  # before the asking, which takes its time
    made, found = count(ask(*loaded, dataset))
    print(*said(made, found), sep="\n")
    with styled():
        for plot in words.plots(found, f"{root.name}, {made.episodes:,} episodes, {len(made.table):,} skill codes"):
            write(plot, config.output_dir)
            print(config.output_dir / f"{plot.name}.png")


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


def ask(policy: "LisaPolicy", preprocess: Any, dataset: "LeRobotDataset", batch_size: int = 64) -> Trace:
    """The codes that the skill predictor chooses in every episode of a dataset, in evaluation mode, as training does.

    Returns:
        A trace of the steps at which it is asked: 0, H, 2H, ...
    """
    import torch
    from torch.utils.data import DataLoader, Subset
    from tqdm import tqdm

    quantized = []
    hook = policy.network.quantizer.register_forward_hook(lambda _module, _inputs, skills: quantized.append(skills))
    starts, instructions = list(dataset.meta.episodes["dataset_from_index"]), []
    policy.eval()
    if policy.config.learned_steps:  # of pictures, whose whole episodes are asked about all the same
        policy.config.excerpt_steps, batch_size = 0, 4
    with torch.no_grad():
        loader = DataLoader(Subset(dataset, starts), batch_size)
        for batch in tqdm(loader, desc="asking for skills", unit="batch", disable=None):
            instructions += batch["task"]
            policy.forward(preprocess(batch))
    hook.remove()
    horizon, lengths = policy.config.horizon, np.array(dataset.meta.episodes["length"])
    episodes = pd.DataFrame(
        {"group": "dataset", "task_id": 0, "episode": range(len(starts)), "instruction": instructions}
    )
    steps = episodes.loc[episodes.index.repeat(-(-lengths // horizon))]
    steps["step"] = horizon * steps.groupby("episode").cumcount()
    steps["code"] = torch.cat([skills.codes for skills in quantized]).cpu().numpy()
    return Trace(steps, episodes, {"policy": {"horizon": horizon}, "codes": code_labels(policy)})


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
