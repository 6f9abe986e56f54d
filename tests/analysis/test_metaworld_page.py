"""The commands of docs/metaworld.md, one after another as a reader types them; only numbers are smaller."""

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

if find_spec("mujoco") is None or find_spec("metaworld") is None:
    pytest.skip("Meta-World is not installed", allow_module_level=True)

from lerobot_options import read_training

from lerobot_lisa.analysis.control import rollout
from lerobot_lisa.analysis.listening import command as listening
from lerobot_lisa.analysis.listening import metaworld
from lerobot_lisa.envs import engine
from lerobot_lisa.envs.engine import check_drawing
from lerobot_lisa.envs.metaworld_states.tasks import find_tasks
from lerobot_lisa.errors import UserError

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/metaworld.md").read_text(encoding="utf-8")
TASKS = ("stick-push-v3", "coffee-button-v3")  # the experts need some 30 steps
STEPS = 3  # instead of 500: each takes a tenth of a second to draw
SMALLER = {
    r"--tasks MT10 --episodes 50": f"--tasks {','.join(TASKS)} --episodes 1 --workers 1",
    r"--image-size 128": "--image-size 32",
    r"configs/metaworld/\w+/lisa.yaml": r"\g<0> --policy.device=cpu --policy.dim_model=32 --steps=2 --batch_size=2 "
    "--policy.quantizer_warmup_steps=1 --policy.image_size=32",
    r"--env.task=[\w,-]+": f"--env.task={','.join(TASKS)} --policy.device=cpu",
    r"n_episodes=\d+": "n_episodes=1",
    r"--eval.batch_size=\d+": "--eval.batch_size=1 --eval.use_async_envs=false",
}
DRIVER = f"""
import runpy, shlex, sys
from importlib.metadata import entry_points
from lerobot.envs import metaworld

begin = metaworld.MetaworldEnv.__init__

def begin_short(self, *given, **named):
    begin(self, *given, **named)
    self._max_episode_steps = {STEPS}

metaworld.MetaworldEnv.__init__ = begin_short
for line in sys.stdin.read().splitlines():
    print("===", line, flush=True)
    program, *words = shlex.split(line)
    sys.argv = [program, *words]
    try:
        if program == "python":
            sys.argv = words[1:]
            runpy.run_module(words[1], run_name="__main__", alter_sys=True)
        else:
            (script,) = entry_points(group="console_scripts", name=program)
            sys.exit(script.load()())
    except SystemExit as ended:
        if ended.code:
            raise
"""


def commands() -> list[str]:
    """Those of the page, smaller; it installs and chooses how to draw first."""
    shell = "".join(re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)).replace("\\\n", " ")
    install, choose, *rest = shell.splitlines()
    assert (install.split()[0], choose) == ("pip", "export MUJOCO_GL=egl")
    for published, smaller in SMALLER.items():
        assert any(re.search(published, line) for line in rest), published
        rest = [re.sub(published, smaller, line) for line in rest]
    return rest


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_page_from_top_to_bottom(tmp_path: Path) -> None:
    """In one process: twelve programs that import LeRobot and MuJoCo once."""
    try:
        check_drawing("Meta-World", "--states-only")
    except UserError as error:
        pytest.skip(str(error))
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    env = {**os.environ, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    run = {"cwd": tmp_path, "env": env, "capture_output": True, "text": True, "check": False}
    done = subprocess.run([sys.executable, "-c", DRIVER], input="\n".join(commands()), **run)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"

    outputs = tmp_path / "outputs"
    evaluated = json.loads((outputs / "eval/mt10/eval_info.json").read_text())
    assert [task["task_group"] for task in evaluated["per_task"]] == list(TASKS)
    report = (outputs / "report/mt10/report.html").read_text()
    assert "LISA on Meta-World" in report
    assert all(task in report for task in TASKS)
    assert len(list((outputs / "rollout/mt10/videos").rglob("*.mp4"))) == len(TASKS)
    heard = json.loads((outputs / "diagnosis/mt10/heard.json").read_text())
    assert heard["rates"]["overall"]["heard"]["episodes"] == len(TASKS)
    assert heard["rates"]["overall"]["spl"]["episodes"] == len(TASKS)  # of those that the expert solves
    unseen = json.loads((outputs / "diagnosis/mt10_states/heard.json").read_text())
    assert unseen["rates"].keys() == heard["rates"].keys()


@pytest.mark.parametrize("folder", ["mt10", "mt10_states"])
def test_the_recipes_are_of_mt10_and_differ_in_the_policy_only(folder: str) -> None:
    lisa, lang_dt = (read_training(ROOT / f"configs/metaworld/{folder}/{name}.yaml") for name in ("lisa", "lang_dt"))
    assert find_tasks(lisa.env.task) == find_tasks("MT10")
    for name in ("batch_size", "steps", "seed", "dataset", "env"):
        assert getattr(lisa, name) == getattr(lang_dt, name), name
    for name in ("optimizer_lr", "scheduler", "dim_model", "language_encoder", "normalization_mapping", "action_head"):
        assert getattr(lisa.policy, name) == getattr(lang_dt.policy, name), name
    for recipe in (lisa, lang_dt):
        assert f"--root {recipe.dataset.root} --repo-id {recipe.dataset.repo_id}" in PAGE


def test_a_task_that_is_none_is_one_line(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also of worlds that say nothing but the name of a key."""
    out = tmp_path / "out"
    options = [f"--policy.path={lisa}", "--env.type=metaworld", "--env.task=reach-v9", f"--output_dir={out}"]
    monkeypatch.setattr("sys.argv", ["lisa-diagnose", "heard", *options])
    assert listening.main() == 1
    *_, last = capsys.readouterr().err.splitlines()
    assert last == "error: LeRobot cannot make --env.type=metaworld --env.task=reach-v9: KeyError: 'reach-v9'"
    assert not out.exists()


def test_a_machine_that_cannot_draw_is_one_line(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delattr(engine.mujoco, "Renderer", raising=False)
    options = [f"--policy.path={lisa}", "--env.type=metaworld", "--env.task=reach-v3", f"--output_dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", ["lisa-rollout", *options])
    assert rollout.main() == 1
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("error: cannot draw metaworld (MUJOCO_GL is ")


def test_the_expert_is_who_steps_are_compared_with() -> None:
    assert 20 <= (metaworld.demonstrator_steps("stick-push-v3", 1000) or 0) <= 60
