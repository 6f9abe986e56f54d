"""Steps as jobs of a cluster: what is queued, and that its jobs do the work."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import dill
import pytest

from dataset_converters.cluster.slurm import Slurm
from lerobot_lisa.reproduce.command import main
from lerobot_lisa.reproduce.slurm import slurm_executor
from lerobot_lisa.reproduce.steps import Step


@pytest.fixture
def queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """SLURM's commands: `sbatch` keeps what it gets and gives it a number, `scontrol` knows one machine."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    keep = (
        'number=$(ls "$(dirname "$0")" | grep -c txt); script="${@: -1}"\n'
        'printf "%s\\n" "${@:1:$#-1}" | cat - "$script" > "$(dirname "$0")/$number.txt"; echo "Submitted job $number"'
    )
    for name, command in {"sbatch": keep, "scontrol": "echo localhost"}.items():
        (folder / name).write_text(f"#!/usr/bin/env bash\n{command}\n")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_NODELIST", "localhost")
    return folder


def run_job(job: str, ranks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    (executor,) = re.findall(r"launch_pickled_pipeline (\S+)", job)
    for rank in range(ranks):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(rank))
        with open(executor, "rb") as file:  # noqa: PTH123  what launch_pickled_pipeline does
            dill.load(file).run()


def test_each_stage_is_an_array_that_waits_for_the_one_before(
    writes: Callable[..., Step], queue: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = writes("first")
    steps = [writes("second", "", (first,)), writes("third", "", (first,))]
    executor = slurm_executor(steps, 5, Slurm("gpu"), tmp_path / "out", gpus=1)
    assert executor is not None
    executor.run()

    jobs = [(queue / f"{number}.txt").read_text() for number in range(4)]  # each is followed by one for its statistics
    assert "#SBATCH --array=0-0%5" in jobs[0]
    assert "#SBATCH --array=0-1%5" in jobs[2]
    assert "#SBATCH --partition=gpu" in jobs[2]
    assert "--dependency=afterany:0" in jobs[2]  # what does not need what has failed goes on
    run_job(jobs[0], 1, monkeypatch)
    run_job(jobs[2], 2, monkeypatch)

    assert all(step.note for step in (first, *steps))
    assert slurm_executor(steps, 5, Slurm("gpu"), tmp_path / "out") is None  # everything is done


def test_a_partition_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ours.gotolocal_1k", "--executor=slurm", f"--root={tmp_path}"]) == 1
    assert capsys.readouterr().err == "error: --executor=slurm needs --partition, the SLURM partition to run on\n"
    assert not list(tmp_path.iterdir())
