"""What the dataset cards of LOReL datasets say."""

from pathlib import Path

from dataset_converters.card import DatasetCard

_CITATION = """@inproceedings{nair2021lorel,
  title = {Learning Language-Conditioned Robot Behavior from Offline Data and Crowd-Sourced Annotation},
  author = {Suraj Nair and Eric Mitchell and Kevin Chen and Brian Ichter and Silvio Savarese and Chelsea Finn},
  booktitle = {Conference on Robot Learning},
  year = {2021},
  url = {https://arxiv.org/abs/2109.01115},
}"""
_PAPER = "https://arxiv.org/abs/2109.01115"
_WRIST = "`wrist`, which the simulator ignores; its values are random (`info.ignored` of the feature says so)"


def collected_card(seeds: str, engine: str, arm: str, quality: str | None, dropped: int) -> DatasetCard:
    """Card of a dataset that was collected in our simulator."""
    lines = {
        "Policy": "uniformly random actions, a fresh reset for each episode",
        "Seeds": seeds,
        "Engine": f"{engine}, arm {arm}",
        "Images": f"rendered from the stored states, quality {quality}" if quality else "none",
    }
    return _card("Random play on a simulated Sawyer tabletop, described by templates.", lines, dropped, "apache-2.0")


def converted_card(source: Path, selection: str, quality: str | None, dropped: int) -> DatasetCard:
    """Card of a dataset that was converted from an original file."""
    lines = {"Source file": f"{source.name} of the LOReL data set ({selection})"}
    lines["Images"] = f"rounded to 8 bits, quality {quality}" if quality else "left out"
    return _card("Original LOReL episodes of a simulated Sawyer tabletop.", lines, dropped, "unknown")


def _card(title: str, lines: dict[str, str], dropped: int, license_id: str) -> DatasetCard:
    lines |= {"Ignored action dimension": _WRIST, "Episodes left out because nothing happened": f"{dropped:,}"}
    url = "https://sites.google.com/view/robotlorel"
    return DatasetCard(title, lines, license_id, url, _PAPER, _CITATION, tags=("lorel", "sawyer", "mujoco", "language"))
