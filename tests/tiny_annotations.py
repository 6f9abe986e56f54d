"""Annotates a dataset with subtasks by `lerobot-annotate`'s own writer, which only lacks the model that watches."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lerobot.annotations.steerable_pipeline.executor import Executor
from lerobot.annotations.steerable_pipeline.reader import iter_episodes
from lerobot.annotations.steerable_pipeline.staging import EpisodeStaging
from lerobot.annotations.steerable_pipeline.writer import LanguageColumnsWriter

Rows = Sequence[tuple[int, str]]  # from which frame on, and what


def annotate(root: Path, staging: Path, episodes: Mapping[int, Rows], style: str = "subtask") -> None:
    """Rewrite the dataset in `root` with rows of a style for some of its episodes."""
    records = list(iter_episodes(root))
    for record in records:
        times = record.frame_timestamps
        rows = [
            {"role": "assistant", "content": text, "style": style, "timestamp": times[frame], "tool_calls": None}
            for frame, text in episodes.get(record.episode_index, [])
        ]
        EpisodeStaging(staging, record.episode_index).write("plan", rows)
    LanguageColumnsWriter().write_all(records, staging, root)
    Executor._ensure_annotation_metadata_in_info(root)
