"""The dataset card: LeRobot's own template, filled with where the data came from."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot.datasets.io_utils import load_info
from lerobot.datasets.utils import create_lerobot_dataset_card

_MOST_NAMES = 16  # longer lists of dimension names would bury the card; meta/info.json has them all


@dataclass(frozen=True)
class DatasetCard:
    """What the card says beyond the numbers in meta/info.json."""

    title: str
    lines: Mapping[str, str]  # shown as a list: "Level" -> "GoToSeq"
    license: str  # a Hub licence identifier
    url: str
    paper: str
    citation: str
    tags: tuple[str, ...] = ()


def write_card(root: Path, repo_id: str, card: DatasetCard) -> None:
    """Write README.md into a finished dataset; instructions are counted, not listed.

    Args:
        root: dataset directory, with its meta/info.json.
        repo_id: name on the Hub, for the visualisation badge.
        card: what it says.
    """
    info = load_info(root)
    counts = {
        "Episodes": f"{info.total_episodes:,}",
        "Frames": f"{info.total_frames:,} at {info.fps} fps",
        "Distinct instructions": f"{info.total_tasks:,}",
    }
    lines = [f"- **{name}:** {text}" for name, text in {**card.lines, **counts}.items()]
    made = create_lerobot_dataset_card(
        tags=list(card.tags),
        dataset_info=dataclasses.replace(info, features={key: _brief(ft) for key, ft in info.features.items()}),
        repo_id=repo_id,
        license=card.license,
        dataset_description="\n".join([card.title, "", *lines, ""]),
        url=card.url,
        paper=card.paper,
        citation_bibtex=card.citation,
    )
    made.save(root / "README.md")


def _brief(feature: Mapping[str, Any]) -> dict[str, Any]:
    names, brief = feature.get("names"), dict(feature)
    if isinstance(names, list) and len(names) > _MOST_NAMES:
        brief["names"] = [*names[:2], "...", names[-1]]
    if feature.get("info"):  # what symbols are called, say, takes a page
        brief["info"] = {key: "..." if isinstance(value, dict) else value for key, value in feature["info"].items()}
    return brief
