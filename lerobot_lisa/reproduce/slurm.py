"""Steps as jobs on a SLURM cluster, which datatrove queues, as it does for datasets."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from datatrove.executor.base import PipelineExecutor
from datatrove.pipeline.base import PipelineStep

from dataset_converters.cluster.slurm import Slurm, jobs
from lerobot_lisa.reproduce.perform import perform
from lerobot_lisa.reproduce.steps import Step


class PerformSteps(PipelineStep):
    """Task r of a pipeline performs step r."""

    type = "lisa"
    name = "perform steps"

    def __init__(self, steps: Sequence[Step]) -> None:
        super().__init__()
        self.steps = list(steps)

    def run(self, data: Any = None, rank: int = 0, world_size: int = 1) -> Any:
        """Perform step `rank`, or go on with it."""
        with self.track_time():
            perform(self.steps[rank])
        return data


def slurm_executor(
    steps: Sequence[Step], workers: int, slurm: Slurm, root: Path, gpus: int = 0
) -> PipelineExecutor | None:
    """An array of jobs for each stage: datasets, trainings, what needs those.

    A stage also starts when some of the one before has failed: what does not need that can be done, and the rest says
    what is missing.

    Args:
        steps: Those that nothing else needs.
        workers: Jobs at a time.
        slurm: What is asked for.
        root: Folder of all that is made, which all machines can write to.
        gpus: For each job but those that make data.

    Returns:
        The last stage, which queues those before it; None: everything is done.
    """
    last = None
    for stage in stages(steps):
        logs = root / "slurm" / hashlib.sha256(" ".join(step.key for step in stage).encode()).hexdigest()[:12]
        task = PerformSteps(stage)
        more = {"run_on_dependency_fail": True, "gpus_per_task": 0 if stage[0].kind == "data" else gpus}
        last = jobs(task, len(stage), workers, slurm, stage[0].kind, logs, last, **more)
    return last


def stages(steps: Sequence[Step]) -> list[list[Step]]:
    """All that is not done: what needs nothing, what needs only that, and so on."""
    whole = {step.name: step for last in steps for step in last.chain() if step.note is None}
    ordered: dict[int, list[Step]] = {}
    for step in whole.values():
        ordered.setdefault(_depth(step), []).append(step)
    return [ordered[depth] for depth in sorted(ordered)]


def _depth(step: Step) -> int:
    return 1 + max((_depth(needed) for needed in step.after), default=-1)
