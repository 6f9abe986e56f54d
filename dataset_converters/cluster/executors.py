"""Where a run takes place: processes on this machine, or jobs of a SLURM cluster."""

import sys
from dataclasses import dataclass
from pathlib import Path

from datatrove.executor import LocalPipelineExecutor, SlurmPipelineExecutor
from datatrove.executor.base import PipelineExecutor

from dataset_converters.cluster.plan import Plan
from dataset_converters.cluster.steps import MakeShards, MergeShards


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


def local_executor(plan: Plan, workers: int) -> PipelineExecutor:
    """Shards in `workers` processes of this machine, then the merge."""
    shards = LocalPipelineExecutor([MakeShards(plan)], plan.shards, workers, str(plan.logs / "shards"))
    return LocalPipelineExecutor([MergeShards(plan)], 1, 1, str(plan.logs / "merge"), depends=shards)


def slurm_executor(plan: Plan, workers: int, slurm: Slurm) -> PipelineExecutor:
    """An array of jobs, `workers` of them at a time, and a job that merges when all of them have succeeded."""

    def executor(step: MakeShards | MergeShards, tasks: int, depends: PipelineExecutor | None) -> PipelineExecutor:
        name = step.name.replace(" ", "_")
        return SlurmPipelineExecutor(
            [step],
            tasks=tasks,
            time=slurm.time,
            partition=slurm.partition,
            mem_per_cpu_gb=slurm.memory,
            workers=workers,
            job_name=f"{plan.root.name}_{name}",
            qos=slurm.qos,
            venv_path=_activation(),
            depends=depends,
            logging_dir=str(plan.logs / name),
        )

    return executor(MergeShards(plan), 1, executor(MakeShards(plan), plan.shards, None))


def _activation() -> str | None:
    """The script that activates this virtual environment, so that jobs run in it too."""
    script = Path(sys.prefix) / "bin/activate"
    return str(script) if sys.prefix != sys.base_prefix and script.is_file() else None
