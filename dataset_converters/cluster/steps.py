"""The two steps of a run as datatrove runs them: make a shard, merge all of them."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

from datatrove.pipeline.base import PipelineStep

from dataset_converters.card import write_card
from dataset_converters.cluster.plan import Plan
from dataset_converters.staging import refuse_existing, staged
from lerobot_lisa.errors import UserError

_SETTINGS = "settings.json"


def prepare(plan: Plan) -> None:
    """Create the folder of the shards, or check that the one found there belongs to a run with these settings.

    Raises:
        UserError: It belongs to another run, or the dataset is there already.
    """
    refuse_existing(plan.root)
    note, described = plan.folder / _SETTINGS, json.dumps(plan.describe(), indent=2, sort_keys=True)
    if not plan.folder.exists():
        plan.folder.mkdir(parents=True)
        note.write_text(described)
    elif not note.is_file() or note.read_text() != described:
        raise UserError(f"{plan.folder} holds the shards of another run; delete it or choose another --root")


class MakeShards(PipelineStep):
    """Task r of a pipeline makes shard r; a task that was killed goes on with what it has left."""

    type = "lerobot"
    name = "make shards"

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self.plan = plan

    def run(self, data: Any = None, rank: int = 0, world_size: int = 1) -> Any:
        """Make shard `rank`."""
        _be_quiet()
        with self.track_time():
            self.plan.make_shard(rank)
        return data


class MergeShards(PipelineStep):
    """Merges all shards by LeRobot's `aggregate_datasets`, and removes them."""

    type = "lerobot"
    name = "merge shards"

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self.plan = plan

    def run(self, data: Any = None, rank: int = 0, world_size: int = 1) -> Any:
        """Merge, unless an earlier run has done it."""
        _be_quiet()
        with self.track_time():
            if not self.plan.root.exists():
                merge(self.plan, self.plan.complete())
            for path in self.plan.folder.iterdir():
                if path != self.plan.logs:  # datatrove is still writing there
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
        return data


def merge(plan: Plan, roots: list[Path]) -> None:
    """One dataset of several, built aside; each keeps its data files, so that merging takes linear time."""
    from lerobot.datasets.aggregate import aggregate_datasets  # slow to import, and needed at the end only

    with staged(plan.root, plan.describe()) as partial:
        aggregate_datasets(
            [plan.repo_id] * len(roots),
            plan.repo_id,
            roots=roots,
            aggr_root=partial / "dataset",
            concatenate_data=False,
        )
        write_card(partial / "dataset", plan.repo_id, plan.card(roots))


def _be_quiet() -> None:
    """Tasks write log files, where progress bars are noise."""
    os.environ["TQDM_DISABLE"] = "1"
    from datasets.utils.logging import disable_progress_bar

    disable_progress_bar()
