"""Whole-episode data against LeRobot's own windows, and the share of a training step spent waiting for data.

python benchmarks/episode_windows.py --root data/gotoseq_1k --repo-id me/babyai_gotoseq_1k [--json out.json]
"""

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_lisa.episodes.load import load_episodes

KEYS = ["observation.grid", "observation.direction", "action"]


def main() -> None:
    arguments = parse_arguments()
    torch.set_num_threads(1)
    table = {
        **{f"windows of {length} frames": windows(arguments, length) for length in (10, 50)},
        "lerobot-train": waiting(arguments),
    }
    for name, row in table.items():
        print(f"{name}: " + ", ".join(f"{key} {value:,.4g}" for key, value in row.items()))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(table, indent=2) + "\n")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", required=True, help="folder of a BabyAI LeRobotDataset")
    parser.add_argument("--repo-id", default="local/babyai")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--steps", type=int, default=40, help="lerobot-train steps to measure")
    parser.add_argument("--batch-size", type=int, default=128)
    parser.add_argument("--json", help="also write the figures here")
    return parser.parse_args()


def windows(arguments: argparse.Namespace, length: int) -> dict[str, float]:
    """Windows per CPU-second: the store's contiguous frames against `delta_timestamps`."""
    meta = LeRobotDatasetMetadata(arguments.repo_id, root=arguments.root)
    store = load_episodes(meta, KEYS)
    deltas = [step / meta.fps for step in range(length)]
    dataset = LeRobotDataset(arguments.repo_id, root=arguments.root, delta_timestamps=dict.fromkeys(KEYS, deltas))
    starts = torch.randint(0, meta.total_frames - length, (4096,), generator=torch.Generator().manual_seed(0)).tolist()

    def ours() -> int:
        for at in range(0, len(starts), 128):
            frames = torch.tensor([range(start, start + length) for start in starts[at : at + 128]])
            for column in store.columns.values():
                column[frames]
        return len(starts)

    def lerobots() -> int:
        for start in starts[:16]:
            dataset[start]
        return 16

    fast, slow = (statistics.median(rate(f) for _ in range(arguments.repeats)) for f in (ours, lerobots))
    return {"store per CPU-second": fast, "LeRobot per CPU-second": slow, "ratio": fast / slow}


def rate(work: Callable[[], int]) -> float:
    """Items per CPU-second."""
    start = time.process_time()
    return work() / (time.process_time() - start)


def waiting(arguments: argparse.Namespace) -> dict[str, float]:
    """Median share of a `lerobot-train` step spent in the loader and the preprocessor, from its own log."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            str(Path(sys.executable).with_name("lerobot-train")), "--policy.type=lisa", "--policy.device=cpu",
            "--policy.language_encoder=words", "--policy.push_to_hub=false", f"--dataset.repo_id={arguments.repo_id}",
            f"--dataset.root={arguments.root}", f"--batch_size={arguments.batch_size}", f"--steps={arguments.steps}",
            "--log_freq=1", "--num_workers=0", "--save_checkpoint=false", f"--output_dir={folder}/run",
        ]  # fmt: skip
        log = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    pattern = re.compile(r"updt_s:([\d.]+) data_s:([\d.]+)")
    steps = [(float(update), float(data)) for update, data in pattern.findall(log)][5:]  # the first load and warm up
    share = statistics.median(data / (update + data) for update, data in steps)
    return {
        "batch size": arguments.batch_size,
        "seconds per step": statistics.median(update + data for update, data in steps),
        "share waiting for data": share,
    }


if __name__ == "__main__":
    main()
