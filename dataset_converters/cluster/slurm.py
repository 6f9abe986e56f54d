"""A run as jobs that datatrove queues on a SLURM cluster, as LeRobot's own porting examples do."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datatrove.executor import SlurmPipelineExecutor
from datatrove.executor.base import PipelineExecutor
from datatrove.pipeline.base import PipelineStep

from dataset_converters.cluster.plan import Plan
from dataset_converters.cluster.steps import finish


class MakeShards(PipelineStep):
    """Task r of a pipeline makes shard r; a task that was killed goes on with what it has left."""

    type = "lerobot"
    name = "make shards"

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self.plan = plan

    def run(self, data: Any = None, rank: int = 0, world_size: int = 1) -> Any:
        """Make shard `rank`."""
        with self.track_time():
            self.plan.make_shard(rank)
        return data


class MergeShards(PipelineStep):
    """Merges all shards, and removes them."""

    type = "lerobot"
    name = "merge shards"

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self.plan = plan

    def run(self, data: Any = None, rank: int = 0, world_size: int = 1) -> Any:
        """Merge, unless an earlier run has done it."""
        with self.track_time():
            finish(self.plan)
        return data


@dataclass(frozen=True)
class Slurm:
    """What SLURM is asked for.

    Attributes:
        partition: Of the cluster; processors are enough.
        time: Limit for making one shard, and for merging.
        memory: GB for each.
        qos: Quality of service; empty: the cluster's default.
    """

    partition: str
    time: str = "08:00:00"
    memory: int = 4
    qos: str = ""


def slurm_executor(plan: Plan, workers: int, slurm: Slurm) -> PipelineExecutor:
    """An array of jobs, `workers` of them at a time, and a job that merges when all of them have succeeded."""
    shards = jobs(MakeShards(plan), plan.shards, workers, slurm, plan.root.name, plan.logs)
    return jobs(MergeShards(plan), 1, workers, slurm, plan.root.name, plan.logs, shards)


def jobs(
    step: PipelineStep,
    tasks: int,
    workers: int,
    slurm: Slurm,
    whose: str,
    logs: Path,
    depends: PipelineExecutor | None = None,
    **more: Any,
) -> PipelineExecutor:
    """An array of jobs, one for each task of a pipeline's only step.

    Args:
        step: Does task r.
        tasks: How many there are.
        workers: How many run at a time.
        slurm: What is asked for.
        whose: Of the jobs' names the first part; the second is the step's name.
        logs: Folder for a folder of logs.
        depends: What has to succeed before.
        more: Options of datatrove's.
    """
    name = step.name.replace(" ", "_")
    return SlurmPipelineExecutor(
        [step],
        tasks=tasks,
        time=slurm.time,
        partition=slurm.partition,
        mem_per_cpu_gb=slurm.memory,
        workers=workers,
        job_name=f"{whose}_{name}",
        qos=slurm.qos,
        venv_path=_activation(),
        depends=depends,
        logging_dir=str(logs / name),
        **more,
    )


def _activation() -> str | None:
    """The script that activates this virtual environment, so that jobs run in it too."""
    script = Path(sys.prefix) / "bin/activate"
    return str(script) if sys.prefix != sys.base_prefix and script.is_file() else None
