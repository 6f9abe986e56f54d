"""Per-episode statistics as LeRobot stores them, computed for many short episodes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.datasets.compute_stats import (
    DEFAULT_QUANTILES,
    aggregate_stats,
    auto_downsample_height_width,
    get_feature_stats,
    sample_indices,
)

FeatureStats = dict[str, np.ndarray]
EpisodeStats = dict[str, FeatureStats]

_QUANTILE_KEYS = [f"q{int(quantile * 100):02d}" for quantile in DEFAULT_QUANTILES]


def numeric_stats(values: np.ndarray) -> FeatureStats:
    """Statistics of one numeric feature over one episode.

    Quantiles are order statistics: the value that LeRobot's 5000-bin histogram brackets, without building 5000 bins
    per dimension (its result lies within one bin of this one). Everything else is exact where LeRobot uses float32.

    Args:
        values: (T,) or (T, D), any numeric dtype.

    Returns:
        `min max mean std count q01 q10 q50 q90 q99`, each float64 (D,), `count` int64 (1,).
    """
    table = values.reshape(len(values), -1)
    ordered = np.sort(np.ascontiguousarray(table.T), axis=1)  # (D, T): sorting rows is several times faster
    exact = table.astype(np.float64)
    ranks = np.ceil(np.multiply(DEFAULT_QUANTILES, len(table))).astype(np.int64) - 1
    stats = {
        "min": ordered[:, 0].astype(np.float64),
        "max": ordered[:, -1].astype(np.float64),
        "mean": exact.mean(axis=0),
        "std": exact.std(axis=0),
        "count": np.array([len(table)]),
    }
    quantiles = ordered[:, ranks].astype(np.float64)
    return stats | dict(zip(_QUANTILE_KEYS, quantiles.T, strict=True))


def image_stats(images: np.ndarray) -> FeatureStats:
    """LeRobot's own statistics of an image feature: a sample of frames, per channel, scaled to [0, 1].

    Args:
        images: (T, H, W, C) uint8.

    Returns:
        The same keys as `numeric_stats`, each (C, 1, 1).
    """
    frames = [auto_downsample_height_width(images[i].transpose(2, 0, 1)) for i in sample_indices(len(images))]
    stats = get_feature_stats(np.stack(frames), axis=(0, 2, 3), keepdims=True)
    return {
        key: value if key == "count" else np.squeeze(value.astype(np.float64) / 255.0, axis=0)
        for key, value in stats.items()
    }


def episode_stats(columns: Mapping[str, np.ndarray], features: Mapping[str, Mapping[str, Any]]) -> EpisodeStats:
    """Statistics of every column of one episode that there is, in the order of `features`."""
    return {
        key: image_stats(columns[key]) if feature["dtype"] == "image" else numeric_stats(columns[key])
        for key, feature in features.items()
        if key in columns
    }


class RunningStats:
    """Dataset statistics from episode statistics, in bounded memory (LeRobot's own aggregation, block by block)."""

    def __init__(self) -> None:
        self._total: EpisodeStats | None = None

    def update(self, episodes: list[EpisodeStats]) -> None:
        """Add a block of episodes."""
        blocks = episodes if self._total is None else [self._total, *episodes]
        total = aggregate_stats(blocks)
        # aggregate_stats goes through a set: without this, the order of stats.json would change from run to run
        self._total = {key: total[key] for key in episodes[0]}

    def result(self) -> EpisodeStats:
        """Statistics of everything added so far."""
        return self._total or {}
