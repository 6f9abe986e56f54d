"""What the dataset cards of BabyAI datasets say."""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from dataset_converters.card import DatasetCard
from dataset_converters.seeds import describe_seeds

_CITATION = """@inproceedings{chevalier-boisvert2019babyai,
  title = {{BabyAI}: A Platform to Study the Sample Efficiency of Grounded Language Learning},
  author = {Maxime Chevalier-Boisvert and Dzmitry Bahdanau and Salem Lahlou and Lucas Willems and Chitwan Saharia and
            Thien Huu Nguyen and Yoshua Bengio},
  booktitle = {International Conference on Learning Representations},
  year = {2019},
  url = {https://openreview.net/forum?id=rJeXCo0cYX},
}"""
_PAPER = "https://openreview.net/forum?id=rJeXCo0cYX"


def generated_card(level: str, first_seed: int, seeds: Sequence[int], subtasks: bool = False) -> DatasetCard:
    """Card of a dataset that the bot made; only seeds whose episode succeeded are in it."""
    lines = {
        "Level": level,
        "Generator": f"the bot of minigrid {version('minigrid')}; frames are what the agent sees before each action",
        "Seeds": f"{describe_seeds(first_seed, seeds)}; one episode each",
    }
    if subtasks:
        lines["Subtasks"] = "the part of the instruction that the bot serves, in `language_persistent`"
    title = f"Demonstrations of the BabyAI level {level} by a bot, with their instructions."
    return _card(title, lines, license_id="apache-2.0", url="https://minigrid.farama.org/environments/babyai/")


def converted_card(level: str, source: Path, selection: str, encoding: str) -> DatasetCard:
    """Card of a dataset that was converted from an original file."""
    lines = {
        "Level": level,
        "Source file": f"{source.name} of the BabyAI package ({selection})",
        "Cell encoding of the source": encoding,
    }
    title = f"Original demonstrations of the BabyAI level {level}, with their instructions."
    return _card(title, lines, license_id="bsd-3-clause", url="https://github.com/mila-iqia/babyai")


def _card(title: str, lines: dict[str, str], license_id: str, url: str) -> DatasetCard:
    return DatasetCard(title, lines, license_id, url, _PAPER, _CITATION, tags=("babyai", "minigrid", "language"))
