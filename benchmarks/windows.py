"""Windows and whole episodes from the episode store against LeRobot's own windows through its loader."""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch import Tensor

from benchmarks.measuring import Contest, measure
from benchmarks.table import Row, ratio_row
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.store import EpisodeStore

KEYS = ["observation.grid", "observation.direction", "action"]
AGAINST = "LeRobot's `delta_timestamps` through a DataLoader"
BATCH = 128


def rows(options: argparse.Namespace) -> list[Row]:
    meta = LeRobotDatasetMetadata(options.repo_id, root=options.root)
    store = load_episodes(meta, KEYS)
    windows = [_windows(options, meta, store, length) for length in (10, 50)]
    return [*windows, _episodes(options, meta, store)]


def _windows(options: argparse.Namespace, meta: LeRobotDatasetMetadata, store: EpisodeStore, length: int) -> Row:
    starts = torch.randint(0, meta.total_frames - length, (4096,), generator=torch.Generator().manual_seed(0))
    last = store.starts + store.lengths - 1
    ends = last[torch.searchsorted(last, starts)]  # LeRobot repeats an episode's last frame

    def gather(at: int) -> dict[str, Tensor]:
        part = slice(at, at + BATCH)
        frames = torch.minimum(starts[part, None] + torch.arange(length), ends[part, None])
        return {key: column[frames] for key, column in store.columns.items()}

    loader = _loader(options, length, starts.tolist(), BATCH)
    assert_equal(next(loader), gather(0))

    def ours() -> int:
        for at in range(0, len(starts), BATCH):
            gather(at)
        return len(starts)

    def theirs() -> int:
        return len(next(loader)["index"])

    result = _contest(ours, theirs, options.repeats)
    return ratio_row(f"windows of {length} frames", AGAINST, 300, result, "windows")


def _episodes(options: argparse.Namespace, meta: LeRobotDatasetMetadata, store: EpisodeStore) -> Row:
    """LeRobot's windows have one length, so they are as long as the longest episode; 8 at a time keep memory low."""
    size, longest = 8, int(store.lengths.max())
    order = torch.randperm(len(store.starts), generator=torch.Generator().manual_seed(0))
    loader = _loader(options, longest, store.starts[order].tolist(), size)
    first = next(loader)
    columns, packing = store.gather(order[:size])
    real = torch.arange(longest) < packing.lengths[:, None]
    assert_equal({key: first[key][real] for key in KEYS}, columns)

    def ours() -> int:
        for at in range(0, len(order), BATCH):
            store.gather(order[at : at + BATCH])
        return len(order)

    result = _contest(ours, lambda: len(next(loader)["index"]), options.repeats)
    return ratio_row("whole episodes", AGAINST, 300, result, "episodes", longest=longest)


def _contest(ours: Any, theirs: Any, repeats: int) -> Contest:
    ours()
    return Contest([measure(ours) for _ in range(repeats)], [measure(theirs) for _ in range(repeats)])


def _loader(options: argparse.Namespace, length: int, frames: Sequence[int], size: int) -> Iterator[dict[str, Tensor]]:
    """Batches of windows that start at these frames, read in this process: workers only add their start."""
    fps = LeRobotDatasetMetadata(options.repo_id, root=options.root).fps
    deltas = {key: [step / fps for step in range(length)] for key in KEYS}
    dataset = LeRobotDataset(options.repo_id, root=options.root, delta_timestamps=deltas)
    return iter(torch.utils.data.DataLoader(dataset, batch_size=size, sampler=frames, num_workers=0))


def assert_equal(theirs: dict[str, Any], ours: dict[str, Tensor]) -> None:
    """Stop if values differ: a rate of wrong values means nothing."""
    for key in KEYS:
        if not torch.equal(theirs[key].reshape(ours[key].shape).to(ours[key].dtype), ours[key]):
            raise RuntimeError(f"{key} differs between the episode store and LeRobot's loader")
