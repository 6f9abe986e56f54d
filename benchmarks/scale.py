"""What a large dataset costs, level by level, from rates measured here: the figures of docs/scale.md.

    python -m benchmarks.scale [--episodes 40] [--merge data/gotoseq_1k ...] [--json scale.json]

Demonstrating and writing take the same time for every thousand episodes, so a few are measured and a million is
calculated. Merging is measured on copies of a dataset.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.bot import FIRST_SEED
from benchmarks.measuring import measure
from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import Demonstration
from dataset_converters.babyai.schema import babyai_layout, to_episodes
from dataset_converters.writer import write_dataset
from lerobot_lisa.envs.babyai.levels import LEVELS, make_level
from lerobot_lisa.errors import exit_code

os.environ.setdefault("HF_HUB_OFFLINE", "1")
MILLION = 1_000_000


def main() -> None:
    options = _parser().parse_args()
    print("| level | demonstrations/CPU-s | frames each | CPU-hours | million frames | GB |\n|---|---|---|---|---|---|")
    found = {}
    for name in LEVELS:
        cost = found[name] = level_cost(name, options.episodes)
        print(f"| {name} | {cost['per CPU-second']:.3g} | {cost['frames each']:.0f} | {_last(cost)} |", flush=True)
    total = {key: sum(cost[key] for cost in found.values()) for key in ("CPU-hours", "GB", "million frames")}
    print(f"| all {len(found)} | | | {_last(total)} |")
    result: dict[str, Any] = {"episodes": options.episodes, "levels": found, "all": total}
    for count in options.copies if options.merge else ():
        seconds = merging(options.merge, count)
        result[f"merging {count} copies, CPU-s"] = seconds
        print(f"merging {count} copies of {options.merge}: {seconds:.1f} CPU-s")
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=40, help="of each level (default: 40)")
    parser.add_argument("--merge", type=Path, help="a dataset whose copies are merged, to measure that")
    parser.add_argument("--copies", type=int, nargs="+", default=[5, 10], help="how many (default: 5 and 10)")
    parser.add_argument("--json", type=Path, help="keep the figures here")
    return parser


def _last(cost: dict[str, float]) -> str:
    return f"{cost['CPU-hours']:.1f} | {cost['million frames']:.0f} | {cost['GB']:.1f}"


def level_cost(name: str, episodes: int) -> dict[str, float]:
    """Cost of a million demonstrations of a level: bot, simulator and writer on one core."""
    level, demos = make_level(name), list[Demonstration]()
    demonstrate(level, name, FIRST_SEED - 1)

    def make() -> None:
        tried = (demonstrate(level, name, seed) for seed in range(FIRST_SEED, FIRST_SEED + episodes))
        demos.extend(demo for demo in tried if demo is not None)

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "data"
        demonstrating = measure(make).per(len(demos))
        writing = measure(lambda: _write(root, demos)).per(len(demos))
        size = sum(path.stat().st_size for path in root.rglob("*.parquet")) / len(demos)
    frames = sum(len(demo.action) for demo in demos) / len(demos)
    seconds = demonstrating.cpu + writing.cpu
    return {
        "per CPU-second": 1 / demonstrating.cpu,
        "written per CPU-second": 1 / writing.cpu,
        "frames each": frames,
        "success": len(demos) / episodes,
        "CPU-hours": seconds * MILLION / 3600,
        "million frames": frames,
        "GB": size * MILLION / 1e9,
    }


def _write(root: Path, demos: list[Demonstration]) -> None:
    write_dataset(root, babyai_layout("me/benchmark"), to_episodes((demo, None) for demo in demos))


def merging(root: Path, copies: int) -> float:
    """CPU-seconds that LeRobot takes to merge copies of a dataset, each keeping its data files."""
    from lerobot.datasets.aggregate import aggregate_datasets

    names = ["me/benchmark"] * copies
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "merged"
        return measure(
            lambda: aggregate_datasets(
                names, "me/benchmark", roots=[root] * copies, aggr_root=target, concatenate_data=False
            )
        ).cpu


if __name__ == "__main__":
    sys.exit(exit_code(main))
