"""What the dataset cards of LOReL datasets say."""

from pathlib import Path

from dataset_converters.card import CardFacts

_CITATION = """@inproceedings{nair2021lorel,
  title = {Learning Language-Conditioned Robot Behavior from Offline Data and Crowd-Sourced Annotation},
  author = {Suraj Nair and Eric Mitchell and Kevin Chen and Brian Ichter and Silvio Savarese and Chelsea Finn},
  booktitle = {Conference on Robot Learning},
  year = {2021},
  url = {https://arxiv.org/abs/2109.01115},
}"""
_PAPER = "https://arxiv.org/abs/2109.01115"
_WRIST = "`wrist`, which the simulator ignores; its values are random (`info.ignored` of the feature says so)"


def collected_card(seeds: str, engine: str, arm: str, quality: str | None, dropped: int) -> CardFacts:
    """Card of a dataset that was collected in our simulator."""
    facts = {
        "Policy": "uniformly random actions, a fresh reset for each episode",
        "Seeds": seeds,
        "Engine": f"{engine}, arm {arm}",
        "Images": f"rendered from the stored states, quality {quality}" if quality else "none",
    }
    return _card("Random play on a simulated Sawyer tabletop, described by templates.", facts, dropped, "apache-2.0")


def converted_card(source: Path, selection: str, quality: str | None, dropped: int) -> CardFacts:
    """Card of a dataset that was converted from an original file."""
    facts = {"Source file": f"{source.name} of the LOReL data set ({selection})"}
    facts["Images"] = f"rounded to 8 bits, quality {quality}" if quality else "left out"
    return _card("Original LOReL episodes of a simulated Sawyer tabletop.", facts, dropped, "unknown")


def _card(title: str, facts: dict[str, str], dropped: int, license_id: str) -> CardFacts:
    facts |= {"Ignored action dimension": _WRIST, "Episodes left out because nothing happened": f"{dropped:,}"}
    url = "https://sites.google.com/view/robotlorel"
    return CardFacts(title, facts, license_id, url, _PAPER, _CITATION, tags=("lorel", "sawyer", "mujoco", "language"))
