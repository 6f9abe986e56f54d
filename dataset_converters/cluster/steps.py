"""The steps of a run: take its folder, make its shards, merge them. Here, or as the jobs of `slurm`."""

import shutil

from dataset_converters.card import write_card
from dataset_converters.cluster.plan import Plan
from dataset_converters.staging import clear, note_settings, one_line_for_disk_errors, refuse_existing, staged
from dataset_converters.workers import progress, results_in_order, worker_pool


def prepare(plan: Plan) -> None:
    """Create the folder of the shards, or check that the one found there belongs to a run with these settings.

    Raises:
        UserError: It belongs to another run, or the dataset is there already; what a killed run has left beside a
            complete dataset is removed.
    """
    with one_line_for_disk_errors(plan.root):
        if plan.root.exists() and plan.folder.exists():
            note_settings(plan.folder, plan.describe())
            shutil.rmtree(plan.folder)
        refuse_existing(plan.root)
        note_settings(plan.folder, plan.describe())


def run_here(plan: Plan, workers: int) -> None:
    """Make the shards in processes of this machine, then merge them; what an earlier run has made is kept."""
    calls = [(shard,) for shard in range(plan.shards)]
    with (
        worker_pool(min(workers, plan.shards), [type(plan).__module__], finish=False) as pool,
        progress(
            results_in_order(pool, plan.make_shard, calls, ahead=plan.shards), plan.shards, "shards", "shard"
        ) as bar,
    ):
        for _ in bar:
            pass
    finish(plan)
    shutil.rmtree(plan.folder)


def finish(plan: Plan) -> None:
    """Merge all shards, unless an earlier run has done it, and remove them."""
    if not plan.root.exists():
        merge(plan)
    clear(plan.folder, but=plan.logs)  # datatrove is still writing there


def merge(plan: Plan) -> None:
    """One dataset of all shards by LeRobot's `aggregate_datasets`, built aside.

    Each shard keeps its data files, so that merging takes linear time.
    """
    from datasets.utils.logging import disable_progress_bar
    from lerobot.datasets.aggregate import aggregate_datasets  # slow to import, and needed at the end only

    disable_progress_bar()
    roots = plan.complete()
    with staged(plan.root, plan.describe()) as partial:
        aggregate_datasets(
            [plan.repo_id] * len(roots),
            plan.repo_id,
            roots=roots,
            aggr_root=partial / "dataset",
            concatenate_data=False,
        )
        write_card(partial / "dataset", plan.repo_id, plan.card(roots))
