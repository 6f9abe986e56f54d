"""What the dataset cards of Meta-World datasets say, and how seeds are told."""

from collections.abc import Iterator, Mapping, Sequence

from dataset_converters.card import DatasetCard
from dataset_converters.metaworld.expert import engine
from dataset_converters.seeds import describe_seeds

_CITATION = """@inproceedings{yu2019metaworld,
  title = {{Meta-World}: A Benchmark and Evaluation for Multi-Task and Meta Reinforcement Learning},
  author = {Tianhe Yu and Deirdre Quillen and Zhanpeng He and Ryan Julian and Karol Hausman and Chelsea Finn and
            Sergey Levine},
  booktitle = {Conference on Robot Learning},
  year = {2019},
  url = {https://arxiv.org/abs/1910.10897},
}"""
_PAPER = "https://arxiv.org/abs/1910.10897"


def seeds_by_task(seeds: Mapping[str, Sequence[int]], first_seed: int) -> Iterator[str]:
    """A line for each task: the range of seeds of its episodes, and those at which the expert failed."""
    for task, of_task in seeds.items():
        yield f"{task}: seeds {describe_seeds(first_seed, of_task)}"


def collected_card(seeds: Mapping[str, Sequence[int]], first_seed: int, pictures: str) -> DatasetCard:
    """Card of a dataset of the experts' successes.

    Args:
        seeds: of the episodes, by task.
        first_seed: of the seeds that were counted up from, in each task.
        pictures: what they look like.
    """
    lines = {
        "Policy": "the scripted expert of each task, until it succeeds; only successes are kept",
        "World": f"LeRobot's `--env.type=metaworld` with `--env.obs_type=pixels_agent_pos`; {engine()}",
        "Pictures": pictures,
        **{task: describe_seeds(first_seed, of_task) for task, of_task in seeds.items()},
    }
    title = "Demonstrations of Meta-World tasks by scripted experts, told as LeRobot's environment tells them."
    url = "https://metaworld.farama.org"
    return DatasetCard(title, lines, "mit", url, _PAPER, _CITATION, tags=("metaworld", "sawyer", "mujoco", "language"))
