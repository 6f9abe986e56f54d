"""From collected data to numbers with the real commands: lerobot-train, lerobot-eval, the success rates."""

import json
import subprocess
from pathlib import Path
from typing import Any

import av
import drawing
import programs
import pytest

from dataset_converters.lorel.collect import CollectSettings, collect
from lerobot_lisa.analysis.success.__main__ import main as success
from lerobot_lisa.envs.lorel.groups import GROUPS
from lerobot_lisa.envs.lorel.suites import SUITES

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
IMAGE_ONLY = json.dumps({"observation.image": {"type": "VISUAL", "shape": [3, 64, 64]}})


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six episodes of random play with states and images."""
    drawing.needs_gl()
    root = tmp_path_factory.mktemp("data") / "play"
    collect(CollectSettings(6, root, "local/play", quality="minimal", keep_unlabelled=True))
    return root


def train(data: Path, output: Path, *settings: str) -> Path:
    """Two steps of a small LISA policy; returns its checkpoint."""
    done = programs.run(
        "lerobot-train", "--policy.type=lisa", "--policy.language_encoder=words", "--policy.dim_model=32",
        "--policy.n_heads=2", "--policy.device=cpu", "--policy.push_to_hub=false", "--dataset.repo_id=local/play",
        f"--dataset.root={data}", "--batch_size=4", "--num_workers=0", "--steps=2", f"--output_dir={output}", *settings,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return output / "checkpoints" / "last" / "pretrained_model"


def evaluate(policy: Path, output: Path, task: str, *settings: str) -> subprocess.CompletedProcess[str]:
    return programs.run(
        "lerobot-eval", f"--policy.path={policy}", "--env.type=lorel", f"--env.task={task}", "--eval.n_episodes=1",
        "--eval.batch_size=1", "--eval.use_async_envs=false", f"--output_dir={output}", *settings,
    )  # fmt: skip


def results(done: subprocess.CompletedProcess[str], output: Path) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads((output / "eval_info.json").read_text())


def video_size(path: str) -> tuple[int, int]:
    with av.open(path) as video:
        return video.streams.video[0].width, video.streams.video[0].height


@pytest.fixture(scope="module")
def seeing(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of a policy that was trained on the images alone."""
    return train(data, tmp_path_factory.mktemp("images") / "run", f"--policy.input_features={IMAGE_ONLY}")


def test_images_are_small_for_the_policy_and_large_for_people(seeing: Path, tmp_path: Path) -> None:
    info = results(evaluate(seeing, tmp_path, "seen", "--env.obs_type=pixels"), tmp_path)
    assert info["per_group"].keys() == {"seen"}
    assert [task["task_id"] for task in info["per_task"]] == list(range(6))
    assert json.loads((seeing / "config.json").read_text())["input_features"] == json.loads(IMAGE_ONLY)
    for task in info["per_task"]:
        (video,) = task["metrics"]["video_paths"]
        assert video_size(video) == (256, 256)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["--env.obs_type=pixels", "--env.image_quality=smooth"], "pass --env.image_quality=minimal, or"),
        ([], "trained on observation.image, but the environment shows observation.state"),
    ],
)
def test_another_world_than_in_training_is_one_line(
    seeing: Path, tmp_path: Path, settings: list[str], message: str
) -> None:
    done = evaluate(seeing, tmp_path, "close drawer", *settings)
    (said,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert (done.returncode, message in said, "Traceback" in said) == (1, True, False), done.stderr[-3000:]
    assert not (tmp_path / "eval_info.json").exists()


def test_another_world_on_purpose(seeing: Path, tmp_path: Path) -> None:
    free = ["--env.obs_type=pixels", "--env.arm=free", "--policy.feature_info=null", "--env.render_size=16"]
    info = results(evaluate(seeing, tmp_path, "close drawer", *free), tmp_path)
    assert info["per_group"].keys() == {"close_drawer_free_arm"}


def test_every_suite_with_its_kinds_and_the_floor(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state = json.dumps({"observation.state": {"type": "STATE", "shape": [15]}})
    policy = train(data, tmp_path / "run", f"--policy.input_features={state}")
    output = tmp_path / "eval"
    info = results(evaluate(policy, output, ",".join(SUITES), "--env.render_size=16"), output)
    expected = {group: len(tasks) for groups in GROUPS.values() for group, tasks in groups.items()}
    found = [task["task_group"] for task in info["per_task"]]
    assert (
        {group: found.count(group) for group in found}
        == expected
        == dict(zip(info["per_group"], [group["n_episodes"] for group in info["per_group"].values()], strict=True))
    )
    assert info["overall"]["n_episodes"] == 6 + 77 + 15 + 15
    monkeypatch.setattr("sys.argv", ["success", str(output / "eval_info.json"), "--env.type=lorel"])
    assert success() == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 113 + len(expected) + 2  # tasks, groups, all rephrasals, everything
    assert all("random actions" in line for line in lines)
    (rephrasals,) = (line for line in lines if line.endswith("  rephrasals"))
    assert "/77 " in rephrasals  # duplicates count twice
