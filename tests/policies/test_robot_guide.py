"""The commands of docs/robots.md, one after another as a reader types them; only numbers are smaller."""

import os
import re
import shlex
from pathlib import Path

import programs
import pytest
import tiny_datasets
from scripted_robot import CAMERAS, JOINTS

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs/robots.md").read_text(encoding="utf-8")
CAMERA = {"dtype": "video", "shape": (48, 64, 3), "names": ["height", "width", "channels"]}
ARM = {"dtype": "float32", "shape": (6,), "names": JOINTS}
SMALL = "--policy.device=cpu --steps=2 --batch_size=2 --save_freq=1 --log_freq=1"
ROBOT = "--robot.type=scripted_robot"
PROGRAMS = {
    "lerobot-train": "from lerobot.scripts.lerobot_train import main",
    "lerobot-rollout": "import scripted_robot; from lerobot.scripts.lerobot_rollout import main",
}


def commands() -> list[list[str]]:
    shell = "".join(re.findall(r"```bash\n(.*?)```", GUIDE, re.DOTALL))
    return [shlex.split(line) for line in shell.replace("\\\n", " ").splitlines()]


def smaller(command: list[str], data: Path) -> list[str]:
    """For a robot without hardware, on data that are there, in seconds."""
    line = shlex.join(command)
    if "--resume" in line:
        return [*command, "--steps=3"]
    line = re.sub(r"--dataset\.repo_id=me/(\w+)", rf"--dataset.repo_id=me/\1 --dataset.root={data}", line)
    line = re.sub(r"--(steps|batch_size)=\d+", "", line)
    if command[0] == "lerobot-rollout":
        line = re.sub(
            r"--robot\.type=\S+ --robot\.port=\S+ '?--robot\.cameras=[^']*'", "--robot.type=scripted_robot", line
        )
        line = line.replace("--duration=30", "--duration=1 --device=cpu --play_sounds=false")
        return [*shlex.split(line), "--return_to_initial_position=false"]
    return shlex.split(f"{line} {SMALL}")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_guide_from_top_to_bottom(tmp_path: Path) -> None:
    cameras = {f"observation.images.{camera}": {**CAMERA, "dtype": "image"} for camera in CAMERAS}
    data = tiny_datasets.write(
        tmp_path / "data", {"observation.state": ARM, **cameras, "action": ARM}, lengths=[40, 95, 12]
    )
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    here = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])}

    done = []
    for command in commands():
        program, *arguments = smaller(command, data)
        run = f"import sys; sys.argv[0] = {program!r}; {PROGRAMS[program]}; main()"
        result = programs.run("python", "-c", run, *arguments, cwd=tmp_path, env={**os.environ, **here})
        assert result.returncode == 0, f"{command}\n{result.stderr[-4000:]}"
        done.append(program)

    assert done == ["lerobot-train", "lerobot-train", "lerobot-rollout", "lerobot-train"]
    assert (tmp_path / "outputs/stack/checkpoints/last/pretrained_model/model.safetensors").is_file()


def test_settings_are_the_policies() -> None:
    from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

    table = GUIDE.split("## Which settings to touch first")[1].split("##")[0]
    named = {name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}

    assert named
    assert [name for name in named if not hasattr(LisaConfig(device="cpu"), name)] == []
