"""From lerobot-train to the Hub and back, over real HTTP against a local Hub."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import programs
import pytest
import tiny_datasets
from local_hub import LocalHub

REPO = "me/lisa_test"
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalHub]:
    with LocalHub(tmp_path_factory.mktemp("hub")) as serving:
        yield serving


@pytest.fixture(scope="module")
def run(hub: LocalHub, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs a command as a user of that Hub."""
    home = tmp_path_factory.mktemp("hf_home")
    env = {key: value for key, value in os.environ.items() if not key.startswith("HF_")}
    env |= {"HF_ENDPOINT": hub.url, "HF_TOKEN": "hf_dummy", "HF_HOME": str(home), "HF_HUB_DISABLE_XET": "1"}
    return partial(programs.run, env={**env, "NO_PROXY": "127.0.0.1"}, cwd=home)


@pytest.fixture(scope="module")
def trained(run: Run, symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint that lerobot-train has also pushed."""
    output = tmp_path_factory.mktemp("outputs") / "lisa"
    done = run(
        "lerobot-train", "--policy.type=lisa", "--policy.language_encoder=words", "--policy.dim_model=32",
        "--policy.n_heads=2", "--policy.device=cpu", "--policy.push_to_hub=true", f"--policy.repo_id={REPO}",
        "--dataset.repo_id=local/tiny", f"--dataset.root={symbolic}", "--batch_size=4", "--num_workers=0", "--steps=2",
        f"--output_dir={output}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return output / "checkpoints" / "last" / "pretrained_model"


@pytest.mark.slow
def test_everything_arrives(trained: Path, hub: LocalHub) -> None:
    files = hub.files(REPO)
    assert {"README.md", *(path.name for path in trained.iterdir())} <= files.keys()
    assert files["model.safetensors"].read_bytes() == (trained / "model.safetensors").read_bytes()


@pytest.mark.slow
def test_the_card_names_paper_and_licence_and_a_few_instructions(trained: Path, hub: LocalHub) -> None:
    card = hub.files(REPO)["README.md"].read_text()
    assert "license: apache-2.0" in card
    assert "arxiv.org/abs/2203.00054" in card
    assert f"lerobot-eval --policy.path={REPO}" in card
    assert "local/tiny" in card
    shown = [text for text in set(tiny_datasets.INSTRUCTIONS) if f"- `{text}`\n" in card]
    assert 3 <= len(shown) <= 5


@pytest.mark.slow
def test_another_process_loads_it_and_acts_alike(trained: Path, run: Run) -> None:
    done = run("python", Path(__file__).with_name("act_from.py"), REPO, trained)
    assert done.returncode == 0, done.stderr
    from_hub, local = json.loads(done.stdout.splitlines()[-1])
    assert from_hub == local
    assert len(local) == 10


@pytest.mark.slow
@pytest.mark.usefixtures("trained")
def test_lerobot_eval_runs_it_from_the_hub(run: Run, tmp_path: Path) -> None:
    done = run(
        "lerobot-eval", f"--policy.path={REPO}", "--env.type=babyai", "--env.task=GoToObj", "--env.max_episode_steps=5",
        "--eval.n_episodes=2", "--eval.batch_size=2", "--eval.use_async_envs=false", f"--output_dir={tmp_path}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "eval_info.json").read_text())["overall"]["n_episodes"] == 2
