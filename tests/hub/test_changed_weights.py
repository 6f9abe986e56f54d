"""A repository of the Hub whose weights change under a recorded evaluation, over real HTTP against a local Hub."""

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tiny_checkpoints
from local_hub import LocalHub
from safetensors.torch import load_file, save_file

REPO, OLD, NEW = "me/lisa", "a" * 40, "b" * 40
Rollout = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def hub(symbolic: Path, tmp_path: Path) -> Iterator[LocalHub]:
    """With a LISA checkpoint."""
    with LocalHub(tmp_path / "hub") as serving:
        tiny_checkpoints.lisa(symbolic, serving.root / REPO)
        serving.head = OLD
        yield serving


@pytest.fixture
def rollout(hub: LocalHub, tmp_path: Path) -> Rollout:
    """`lisa-rollout` of the repository, as a user of that Hub."""
    env = {key: value for key, value in os.environ.items() if not key.startswith("HF_")}
    env |= {"HF_ENDPOINT": hub.url, "HF_TOKEN": "hf_dummy", "HF_HOME": str(tmp_path / "home")}
    env |= {"HF_HUB_DISABLE_XET": "1", "NO_PROXY": "127.0.0.1", "OMP_NUM_THREADS": "1"}

    def rollout(output: Path, *options: str) -> subprocess.CompletedProcess[str]:
        program = Path(sysconfig.get_path("scripts")) / "lisa-rollout"
        command = [
            program,
            f"--policy.path={REPO}",
            "--env.type=babyai",
            "--env.task=GoToLocal",
            f"--output_dir={output}",
        ]
        few = ["--env.max_episode_steps=10", "--n_episodes=4", "--batch_size=4", "--n_videos=0"]
        return subprocess.run([*command, *few, *options], env=env, capture_output=True, text=True, check=False)

    return rollout


def push_other_weights(hub: LocalHub) -> None:
    weights = hub.root / REPO / "model.safetensors"
    save_file(
        {name: value * 0 if "codebook" not in name else value for name, value in load_file(weights).items()}, weights
    )
    hub.head = NEW


def lines(done: subprocess.CompletedProcess[str]) -> list[str]:
    """What it printed of episodes."""
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if "seed" in line]


@pytest.mark.slow
def test_old_numbers_are_not_those_of_new_weights(hub: LocalHub, rollout: Rollout, tmp_path: Path) -> None:
    old = lines(rollout(tmp_path / "out"))
    assert len(old) == 4
    push_other_weights(hub)

    refused = rollout(tmp_path / "out")
    assert refused.returncode == 1
    assert f"checkpoint.revision was '{OLD}', now '{NEW}'" in refused.stderr.splitlines()[-1]
    assert lines(rollout(tmp_path / "out", f"--policy.pretrained_revision={OLD}")) == old  # which is in the cache


@pytest.mark.slow
def test_a_file_too_big_is_not_fetched(hub: LocalHub, rollout: Rollout, tmp_path: Path) -> None:
    shutil.copyfile(hub.root / REPO / "model.safetensors", hub.root / REPO / "policy_preprocessor.json")
    with (hub.root / REPO / "policy_preprocessor.json").open("ab") as file:
        file.truncate(2**22)
    done = rollout(tmp_path / "out")
    assert done.returncode == 1
    assert "policy_preprocessor.json has 4,194,304 bytes, more than 2,097,152" in done.stderr.splitlines()[-1]
    assert not list((tmp_path / "home").rglob("policy_preprocessor.json"))
