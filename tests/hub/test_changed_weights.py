"""A repository of the Hub whose weights change under a recorded evaluation, over real HTTP against a local Hub."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import programs
import pytest
import tiny_checkpoints
from local_hub import LocalHub
from safetensors.torch import load_file, save_file

REPO, OLD, NEW = "me/lisa", "a" * 40, "b" * 40
BIG = "me/big"


@pytest.fixture(scope="module")
def hub(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalHub]:
    """With a LISA checkpoint, twice."""
    with LocalHub(tmp_path_factory.mktemp("hub")) as serving:
        tiny_checkpoints.lisa(symbolic, serving.root / REPO)
        shutil.copytree(serving.root / REPO, serving.root / BIG)
        serving.head = OLD
        yield serving


@pytest.fixture(scope="module")
def env(hub: LocalHub, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Of a user of that Hub."""
    env = {key: value for key, value in os.environ.items() if not key.startswith("HF_")}
    env |= {"HF_ENDPOINT": hub.url, "HF_TOKEN": "hf_dummy", "HF_HOME": str(tmp_path_factory.mktemp("home"))}
    return env | {"HF_HUB_DISABLE_XET": "1", "NO_PROXY": "127.0.0.1", "OMP_NUM_THREADS": "1"}


def rollout(repo: str, output: Path, *options: str) -> list[str]:
    """`lisa-rollout` of a repository."""
    few = ["--env.max_episode_steps=10", "--n_episodes=4", "--batch_size=4", "--n_videos=0"]
    world = ["--env.type=babyai", "--env.task=GoToLocal"]
    return ["lisa-rollout", f"--policy.path={repo}", *world, f"--output_dir={output}", *few, *options]


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
def test_old_numbers_are_not_those_of_new_weights(hub: LocalHub, env: dict[str, str], tmp_path: Path) -> None:
    command = rollout(REPO, tmp_path / "out")
    old = lines(programs.run(*command, env=env))
    assert len(old) == 4
    push_other_weights(hub)

    refused = programs.run(*command, env=env)
    assert refused.returncode == 1
    assert f"checkpoint.revision was '{OLD}', now '{NEW}'" in refused.stderr.splitlines()[-1]
    at_old = f"--policy.pretrained_revision={OLD}"  # which is in the cache
    assert lines(programs.run(*command, at_old, env=env)) == old


@pytest.mark.slow
def test_a_file_too_big_is_not_fetched(hub: LocalHub, env: dict[str, str], tmp_path: Path) -> None:
    shutil.copyfile(hub.root / BIG / "model.safetensors", hub.root / BIG / "policy_preprocessor.json")
    with (hub.root / BIG / "policy_preprocessor.json").open("ab") as file:
        file.truncate(2**22)
    done = programs.run_anew(*rollout(BIG, tmp_path / "out"), env=env)
    assert done.returncode == 1
    assert "policy_preprocessor.json has 4,194,304 bytes, more than 2,097,152" in done.stderr.splitlines()[-1]
    assert not list(Path(env["HF_HOME"]).rglob("models--me--big/**/policy_preprocessor.json"))
    assert list(Path(env["HF_HOME"]).rglob("models--me--big"))
