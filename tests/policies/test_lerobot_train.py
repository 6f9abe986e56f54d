"""The real `lerobot-train`: rates, log, exact repetition and resumption, and one line for bad input."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import programs
import pytest
import tiny_datasets
import torch
from safetensors.torch import load_file

pytestmark = pytest.mark.slow
LAST = "checkpoints/000004"


def lerobot_train(*arguments: str) -> subprocess.CompletedProcess[str]:
    return programs.run("lerobot-train", *arguments)


def new_run(output: Path, root: Path, *settings: str) -> list[str]:
    """Four steps of a small LISA policy, saved at every second one."""
    return [
        f"--dataset.root={root}", "--dataset.repo_id=local/tiny", f"--output_dir={output}",
        "--policy.device=cpu", "--policy.push_to_hub=false", "--policy.dim_model=32", "--policy.n_heads=2",
        "--steps=4", "--save_freq=2", "--log_freq=1", "--batch_size=4", "--num_workers=0", "--env_eval_freq=0",
        "--seed=1", *settings,
    ]  # fmt: skip


def state_of(run: Path) -> dict[str, torch.Tensor]:
    """Weights, codebook and the optimizer's moments."""
    files = ["pretrained_model/model.safetensors", "training_state/optimizer_state.safetensors"]
    return {f"{file}/{key}": value for file in files for key, value in load_file(run / LAST / file).items()}


def assert_same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert one.keys() == other.keys()
    assert [key for key, value in one.items() if not torch.equal(value, other[key])] == []


@pytest.mark.timeout(900)
def test_rates_log_resumption_and_repetition(symbolic: Path, encoder: Path, tmp_path: Path) -> None:
    """One run with a frozen pretrained encoder, resumed in the middle after the encoder is gone, and done again."""
    lisa = ["--policy.type=lisa", f"--policy.language_encoder={encoder}", "--policy.freeze_language_encoder=true"]
    rates = ["--policy.optimizer_lr=2e-4", "--policy.optimizer_lr_skill_predictor=3e-5"]
    settings = [*lisa, *rates, "--policy.codebook_size=5", "--policy.horizon=3", "--policy.scheduler_warmup_steps=2"]
    settings += ["--policy.quantizer_warmup_steps=0"]

    first = lerobot_train(*new_run(tmp_path / "first", symbolic, *settings))
    assert first.returncode == 0, first.stderr[-3000:]
    again = programs.run_anew("lerobot-train", *new_run(tmp_path / "again", symbolic, *settings, "--save_freq=4"))
    assert again.returncode == 0, again.stderr[-3000:]
    shutil.rmtree(encoder)
    middle = tmp_path / "first/checkpoints/000002/pretrained_model/train_config.json"
    resumed = lerobot_train(f"--config_path={middle}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    assert resumed.returncode == 0, resumed.stderr[-3000:]

    groups = json.loads((tmp_path / "first" / LAST / "training_state/optimizer_param_groups.json").read_text())
    assert {group["name"]: group["initial_lr"] for group in groups} == {
        "policy": 2e-4,
        "skill_predictor": 3e-5,
        "language_encoder": 1e-6,
    }
    assert {group["name"]: group["lr"] for group in groups} == {
        group["name"]: pytest.approx(group["initial_lr"]) for group in groups
    }
    log = first.stdout + first.stderr
    for name in ("perplexity", "codes_used", "commitment_loss", "mutual_information", "action_accuracy"):
        assert len(re.findall(rf"{name}:[-+\d.]+", log)) == 4, name
    assert_same(state_of(tmp_path / "first"), state_of(tmp_path / "again"))
    assert_same(state_of(tmp_path / "first"), state_of(tmp_path / "resumed"))


@pytest.mark.timeout(900)
def test_learned_termination(symbolic: Path, tmp_path: Path) -> None:
    """Trained before and after codes come, resumed in the middle to the same numbers, and evaluated."""
    settings = ["--policy.type=lisa", "--policy.language_encoder=words", "--policy.codebook_size=5"]
    settings += ["--policy.horizon=6", "--policy.termination_stride=2", "--policy.quantizer_warmup_steps=2"]

    first = lerobot_train(*new_run(tmp_path / "first", symbolic, *settings))
    assert first.returncode == 0, first.stderr[-3000:]
    middle = tmp_path / "first/checkpoints/000002/pretrained_model/train_config.json"
    resumed = lerobot_train(f"--config_path={middle}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    assert resumed.returncode == 0, resumed.stderr[-3000:]

    assert len(re.findall(r"skill_steps:[\d.]+", first.stdout + first.stderr)) == 4
    assert_same(state_of(tmp_path / "first"), state_of(tmp_path / "resumed"))
    world = ["--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=20"]
    evaluated = programs.run(
        "lerobot-eval", *world, f"--policy.path={tmp_path / 'first' / LAST / 'pretrained_model'}",
        "--eval.n_episodes=3", "--eval.batch_size=3", "--eval.use_async_envs=false",
        f"--output_dir={tmp_path / 'eval'}",
    )  # fmt: skip
    assert evaluated.returncode == 0, evaluated.stderr[-3000:]
    assert (tmp_path / "eval" / "eval_info.json").is_file()


BASELINES = {
    "babyai_rnn": ("symbolic", []),
    "lang_bc": ("continuous", []),
    "lorel_planner": ("continuous", ["--policy.plan_steps=3", "--policy.plan_samples=20", "--policy.plan_elites=4"]),
    "kmeans_skills": ("symbolic", ["--policy.codebook_size=5", "--policy.horizon=3"]),
}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", BASELINES)
def test_the_original_baselines(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Trained, and resumed in the middle to the same numbers."""
    data, settings = BASELINES[kind]
    settings = [f"--policy.type={kind}", "--policy.language_encoder=words", *settings]

    first = lerobot_train(*new_run(tmp_path / "first", request.getfixturevalue(data), *settings))
    assert first.returncode == 0, first.stderr[-3000:]
    middle = tmp_path / "first/checkpoints/000002/pretrained_model/train_config.json"
    resumed = lerobot_train(f"--config_path={middle}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    assert resumed.returncode == 0, resumed.stderr[-3000:]

    assert_same(state_of(tmp_path / "first"), state_of(tmp_path / "resumed"))


BAD = {
    "no observation": (
        {"action": tiny_datasets.CLASSES},
        ["--policy.type=lisa", "--policy.language_encoder=words"],
        r"error: lisa needs at least one observation",
    ),
    "no language encoder": (
        {"observation.state": tiny_datasets.STATE, "action": tiny_datasets.MOVE},
        ["--policy.type=lang_dt", "--policy.language_encoder=no/such-model"],
        r"error: language encoder 'no/such-model' is neither",
    ),
}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case: str, tmp_path: Path) -> None:
    features, settings, message = BAD[case]
    root = tiny_datasets.write(tmp_path / "data", features)

    done = lerobot_train(*new_run(tmp_path / "run", root, *settings))

    assert done.returncode == 1
    *_, last = done.stderr.strip().splitlines()
    assert re.match(message, last), done.stderr[-2000:]
    assert "UserError" not in done.stderr
    assert not (tmp_path / "run").exists()
