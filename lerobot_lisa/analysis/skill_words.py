"""What each skill's words are: which skill codes a LISA policy uses for which words of the instructions.

python -m lerobot_lisa.analysis.skill_words --policy-path outputs/lisa/checkpoints/last/pretrained_model \
    --dataset-root data/gotoseq_1k --repo-id local/babyai_gotoseq_1k --output-dir outputs/skill_words
"""

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_lisa.analysis.figures.skill_words import draw
from lerobot_lisa.analysis.statistics.words import Counts, count_words, top_words
from lerobot_lisa.errors import UserError, exit_code

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy


@dataclass(frozen=True)
class SkillUse:
    """What a policy's codebook did over whole episodes.

    Attributes:
        instructions: One for each of E episodes.
        codes: Skill codes of each episode's chunks, in order.
        perplexity: How many codes are in effective use, over all chunks.
        mutual_information: Between instructions and codes, in bits, as the paper's listing defines it.
    """

    instructions: list[str]
    codes: list[list[int]]
    perplexity: float
    mutual_information: float


def load(policy_path: str, dataset: "LeRobotDataset") -> tuple["LisaPolicy", Any]:
    """A LISA checkpoint, from a folder or the Hub, that reads whole episodes of `dataset`; and its preprocessor.

    Raises:
        UserError: There is no checkpoint, it is none of LISA, or the dataset lacks a feature that it reads.
    """
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.processor import NormalizerProcessorStep

    from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy

    try:
        config = PreTrainedConfig.from_pretrained(policy_path)
    except (OSError, ValueError) as error:
        raise UserError(f"--policy-path {policy_path}: no checkpoint (a folder with config.json) there") from error
    if config.type != "lisa":
        raise UserError(f"--policy-path {policy_path} is a {config.type} policy: only lisa has skill codes")
    if config.continuous_skills:
        raise UserError(f"--policy-path {policy_path} has continuous skills: there are no skill codes")
    for key, feature in {**config.input_features, **config.output_features}.items():
        found = tuple(dataset.meta.features.get(key, {}).get("shape", ()))
        if sorted(found) != sorted(feature.shape):  # images have channels last in a dataset, first in a policy
            had = f"has it with shape {found}" if found else "lacks it"
            raise UserError(f"--policy-path {policy_path} reads `{key}` {tuple(feature.shape)}: {dataset.root} {had}")
    preprocess, _ = make_pre_post_processors(config, pretrained_path=policy_path)
    stats = next((step.stats for step in preprocess.steps if isinstance(step, NormalizerProcessorStep)), None)
    policy = LisaPolicy.from_pretrained(policy_path, config=config, dataset_stats=stats, dataset_meta=dataset.meta)
    return policy, preprocess


def use_skills(policy: "LisaPolicy", preprocess: Any, dataset: "LeRobotDataset", batch_size: int = 64) -> SkillUse:
    """Ask the skill predictor about every episode of a dataset, in evaluation mode, as training does."""
    import torch
    from torch.utils.data import DataLoader, Subset
    from tqdm import tqdm

    from lerobot_lisa.networks.codebook import mutual_information, perplexity
    from lerobot_lisa.networks.packing import Packing

    quantized = []
    hook = policy.network.codebook.register_forward_hook(lambda _module, _inputs, skills: quantized.append(skills))
    loader = DataLoader(Subset(dataset, list(dataset.meta.episodes["dataset_from_index"])), batch_size)
    instructions: list[str] = []
    policy.eval()
    with torch.no_grad():
        for batch in tqdm(loader, desc="asking for skills", unit="batch", disable=None):
            instructions += batch["task"]
            policy.forward(preprocess(batch))
    hook.remove()
    lengths = torch.tensor(dataset.meta.episodes["dataset_to_index"]) - torch.tensor(
        dataset.meta.episodes["dataset_from_index"]
    )
    chunks = Packing(lengths).count_chunks(policy.config.horizon).lengths.tolist()
    codes = torch.cat([skills.codes for skills in quantized]).cpu()
    distances = torch.cat([skills.distances for skills in quantized])
    return SkillUse(
        instructions,
        [part.tolist() for part in codes.split(chunks)],
        perplexity(codes, policy.config.codebook_size).item(),
        mutual_information(distances).item(),
    )


def write_table(words: Sequence[str], counts: Counts, output: Path) -> None:
    """The raw counts: one row for each word, one column for each skill."""
    with output.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["word", *range(counts.shape[1])])
        table.writerows([word, *row] for word, row in zip(words, counts.tolist(), strict=True))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    return exit_code(lambda: run(options.policy_path, options.dataset_root, options.repo_id, options.output_dir))


def run(policy_path: str, root: Path, repo_id: str, output_dir: Path) -> None:
    """Load, count, print and write.

    Raises:
        UserError: The dataset or the checkpoint cannot be used.
    """
    if not (root / "meta" / "info.json").is_file():
        raise UserError(f"--dataset-root {root}: no LeRobotDataset (meta/info.json) there")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # takes seconds to import

    dataset = LeRobotDataset(repo_id, root=root)
    policy, preprocess = load(policy_path, dataset)
    use = use_skills(policy, preprocess, dataset)
    words, counts = count_words(use.instructions, use.codes, policy.config.codebook_size)
    report(words, counts, use)
    output_dir.mkdir(parents=True, exist_ok=True)
    write_table(words, counts, output_dir / "skill_words.csv")
    title = f"{repo_id}: {len(use.codes):,} episodes, {sum(map(len, use.codes)):,} skill codes"
    draw(words, counts, title, output_dir / "skill_words.png")
    print(output_dir / "skill_words.png")


def report(words: Sequence[str], counts: Counts, use: SkillUse) -> None:
    """Print the words that are more frequent with each skill than usual, and how many skills there are."""
    episodes = Counter(code for codes in use.codes for code in set(codes))
    for skill, listed in enumerate(top_words(words, counts)):
        if episodes[skill]:
            shown = ", ".join(f"{word} x{times:.1f}" for word, times in listed)
            print(f"skill {skill:2d}  {episodes[skill]:6d} episodes  {shown}")
    print(
        f"{len(episodes)} of {counts.shape[1]} codes used, perplexity {use.perplexity:.1f}, "
        f"mutual information {use.mutual_information:.2f} bits"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy-path", required=True, help="folder or Hub id of a lisa checkpoint")
    parser.add_argument("--dataset-root", required=True, type=Path, help="folder of the LeRobotDataset")
    parser.add_argument("--repo-id", required=True, help="its name, for the title")
    parser.add_argument("--output-dir", required=True, type=Path, help="for skill_words.png and skill_words.csv")
    return parser


if __name__ == "__main__":
    sys.exit(main())
