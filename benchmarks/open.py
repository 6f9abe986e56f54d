"""Opening a dataset for training, ten times as large against once: time and memory must grow in step.

What `lerobot-train` does before its first step: LeRobot opens the dataset, the policy learns about it, and whole
episodes are read into the episode store. Datasets are made with the bulk writer, from the demonstrations in --root over
and over, with instructions of their own.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from benchmarks.measuring import Seconds
from benchmarks.table import Aim, Row
from dataset_converters.babyai.schema import FEATURES, FPS
from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.episodes.load import load_episodes

SIZES = {10_000: 7_000, 100_000: 70_000}  # episodes: instructions
PARTS = ("LeRobot's dataset", "policy", "episode store")


def rows(options: argparse.Namespace) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        opened = [_opened(Path(folder), options, *size) for size in SIZES.items()]
    small, large = opened
    times = {clock: _per_frame(large, clock) / _per_frame(small, clock) for clock in ("cpu", "wall")}
    count = f"{large['episodes']:,.0f} episodes, {large['frames'] / 1e6:.1f} M frames"
    details = {f"{part}, CPU-s": f"{small[part][0]:.2f} and {large[part][0]:.2f}" for part in PARTS}
    memory = large["memory"] / large["bytes"]
    return [
        Row(
            f"opening {count}, time per frame",
            f"{small['episodes']:,.0f} episodes",
            Aim("at most", 1.2),
            times["cpu"],
            times["wall"],
            f"{sum(large[part][0] for part in PARTS):.3g} CPU-s",
            f"{sum(small[part][0] for part in PARTS):.3g} CPU-s",
            details,
        ),
        Row(
            f"opening {count}, memory in addition",
            "the numbers as bytes",
            Aim("at most", 2),
            memory,
            memory,
            f"{large['memory'] / 1e9:.2f} GB",
            f"{large['bytes'] / 1e9:.2f} GB",
            {"memory-mapped": f"{large['memory when mapped'] / large['bytes']:.2f} x"},
        ),
    ]


def _per_frame(opened: dict, clock: str) -> float:
    return sum(opened[part][clock == "wall"] for part in PARTS) / opened["frames"]


def _opened(folder: Path, options: argparse.Namespace, episodes: int, instructions: int) -> dict:
    """Write a dataset and open it in a process of its own, so that its memory is its own too."""
    root = folder / str(episodes)
    write_dataset(root, DatasetLayout("local/large", FPS, FEATURES), many(options, episodes, instructions))
    command = [sys.executable, "-m", "benchmarks.open", str(root)]
    environment = {**os.environ, "HF_DATASETS_CACHE": str(folder / "cache"), "HF_LEROBOT_HOME": str(folder / "home")}
    found = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if found.returncode:
        raise RuntimeError(found.stderr)
    return json.loads(found.stdout.splitlines()[-1])


def many(options: argparse.Namespace, episodes: int, instructions: int) -> Iterator[Episode]:
    """Demonstrations over and over, with instructions made of two of theirs, such as "go to a door, then open it"."""
    meta = LeRobotDatasetMetadata(options.repo_id, root=options.root)
    store = load_episodes(meta, list(FEATURES))
    texts = sorted(str(task) for task in meta.tasks.index)
    columns = {key: column.numpy() for key, column in store.columns.items()}
    spans = list(zip(store.starts.tolist(), (store.starts + store.lengths).tolist(), strict=True))
    for i in range(episodes):
        start, stop = spans[i % len(spans)]
        first, second = divmod(i % instructions, len(texts))
        yield Episode(
            f"{texts[second]}, then {texts[first]}", {key: column[start:stop] for key, column in columns.items()}
        )


def main() -> None:
    """Open the dataset of the only argument; print what it took as one line of JSON."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.policies.factory import make_policy

    from benchmarks.policies import CONFIGS

    root = Path(sys.argv[1])
    config = CONFIGS["lisa"](language_encoder="words", device="cpu", push_to_hub=False)
    memory, readings = _Memory(), [Seconds.now()]
    dataset = LeRobotDataset("local/large", root=root)
    readings.append(Seconds.now())
    policy = make_policy(config, ds_meta=dataset.meta)
    readings.append(Seconds.now())
    frames = len(policy.episode_store.columns["action"])
    readings.append(Seconds.now())
    found: dict = {name: now.since(then) for name, (then, now) in zip(PARTS, pairwise(readings), strict=True)}
    found["memory"] = memory.highest()
    policy.frames.store = None
    memory = _Memory()
    load_episodes(dataset.meta, list(FEATURES), "disk")
    found["memory when mapped"] = memory.highest()
    found["episodes"], found["frames"] = dataset.num_episodes, frames
    found["bytes"] = frames * sum(int(np.prod(feature["shape"])) for feature in FEATURES.values())
    print(json.dumps(found))


class _Memory:
    """Watches the memory that belongs to this process alone; files that are mapped do not count."""

    def __init__(self) -> None:
        self._start = self._most = _own_memory()
        self._running = True
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while self._running:
            self._most = max(self._most, _own_memory())
            time.sleep(0.02)

    def highest(self) -> int:
        """Most bytes since the start, beyond those of the start."""
        self._running = False
        self._thread.join()
        return self._most - self._start


def _own_memory() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith("RssAnon")))


if __name__ == "__main__":
    main()
