"""`lerobot-train` in two processes that train one policy together."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from safetensors.torch import load_file

PROGRAMS = Path(sys.executable).parent


@pytest.mark.slow
def test_training_in_two_processes(symbolic: Path, tmp_path: Path) -> None:
    run = subprocess.run(
        [
            str(PROGRAMS / "torchrun"), "--nproc_per_node=2", str(PROGRAMS / "lerobot-train"),
            "--policy.type=lisa", "--policy.device=cpu", "--policy.language_encoder=words",
            "--policy.push_to_hub=false", "--policy.dim_model=32",
            "--policy.n_heads=2", "--policy.codebook_size=4", "--policy.quantizer_warmup_steps=0", "--policy.horizon=3",
            "--dataset.repo_id=local/tiny", f"--dataset.root={symbolic}", f"--output_dir={tmp_path}/run",
            "--batch_size=8", "--steps=3", "--log_freq=1", "--num_workers=0",
        ],
        capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip

    assert run.returncode == 0, run.stderr[-3000:]
    assert "Effective batch size: 8 x 2 = 16" in run.stderr
    weights = load_file(tmp_path / "run/checkpoints/last/pretrained_model/model.safetensors")
    (counts,) = (value for key, value in weights.items() if key.endswith("cluster_size"))
    assert counts.sum() > 8  # chunks of both processes
