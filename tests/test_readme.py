"""What README.md shows works: its first steps run, smaller; the rest is held against the real programs and files."""

import os
import re
import shlex
import tomllib
from pathlib import Path

import draccus
import programs
import pytest
from lerobot.configs.eval import EvalPipelineConfig

import lerobot_lisa  # noqa: F401  registers the environment

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SMALLER = {
    "--episodes 1000": "--episodes 20 --workers 1",
    "--steps=2000": "--steps=2 --policy.device=cpu --policy.dim_model=32",
    "--policy.quantizer_warmup_steps=1000": "--policy.quantizer_warmup_steps=1",
    "--batch_size=64": "--batch_size=8",
    "--eval.n_episodes=100": "--eval.n_episodes=2 --policy.device=cpu --env.max_episode_steps=4",
    "--n_episodes=200": "--n_episodes=2 --policy.device=cpu --env.max_episode_steps=4",
}
FROM_NOTHING = ("lerobot-eval", "lisa-report")  # others do so in tests of their own


def section(title: str) -> str:
    return README.split(f"\n## {title}\n")[1].split("\n## ")[0]


def commands(title: str) -> list[list[str]]:
    """Commands of a section's shell snippets, one list of words each."""
    shell = "".join(re.findall(r"```bash\n(.*?)```", section(title), re.DOTALL))
    return [shlex.split(line, comments=True) for line in shell.replace("\\\n", " ").splitlines()]


def test_every_snippet_is_in_a_section_that_is_tested() -> None:
    tested = ("Install", "First steps", "Quick start", "In a robot stack", "Push and load")
    assert README.count("\n```bash") + README.count("\n```python") == sum(section(t).count("```") // 2 for t in tested)


@pytest.mark.slow
@pytest.mark.timeout(900)  # eight programs, two of which import PyTorch and LeRobot
def test_first_steps_and_the_robot_stack(tmp_path: Path) -> None:
    """One after the other in one folder, as a reader does; only numbers are smaller."""

    def run(program: str, *arguments: str) -> str:
        start = programs.run_anew if program in FROM_NOTHING else programs.run
        done = start(program, *arguments, cwd=tmp_path)
        assert done.returncode == 0, f"{program} {arguments}\n{done.stderr}"
        return done.stdout

    assert all(published in README for published in SMALLER)
    for command in commands("First steps"):
        line = shlex.join(command)
        for published, smaller in SMALLER.items():
            line = line.replace(published, smaller)
        run(*shlex.split(line))
    (snippet,) = re.findall(r"```python\n(.*?)```", section("In a robot stack"), re.DOTALL)
    shown = run("python", "-c", snippet)

    assert (tmp_path / "outputs" / "skill_words" / "skill_words_by_skill.png").is_file()
    assert (tmp_path / "outputs" / "report" / "report.html").is_file()
    assert shown.splitlines()[-1].startswith("torch.Size([1, 1]) tensor([")


def test_options_of_evaluation_from_the_hub() -> None:
    (command,) = commands("Push and load")
    assert command[0] == "lerobot-eval"
    rest = [word for word in command[1:] if not word.startswith("--policy.path=")]
    parsed = draccus.parse(EvalPipelineConfig, args=rest)
    assert (parsed.env.type, parsed.eval.n_episodes) == ("babyai", 100)


def test_first_steps_train_a_policy_that_gets_its_codes() -> None:
    """Codes are placed after the warm-up: with steps left to learn with them."""
    (train,) = (command for command in commands("First steps") if command[0] == "lerobot-train")
    given = dict(word.removeprefix("--").split("=", 1) for word in train[1:])
    assert int(given["steps"]) >= 2 * int(given["policy.quantizer_warmup_steps"])


def test_two_commands() -> None:
    listed = commands("Quick start")
    assert listed == [["make", "quickstart"], ["make", "test"]]
    makefile = (ROOT / "Makefile").read_text()
    for target in ("quickstart", "test"):
        assert f"\n{target}:\n\t@bash .ci/{target}\n" in makefile
        assert os.access(ROOT / ".ci" / target, os.X_OK)
        assert f"make {target}" in README
        assert f"or: bash .ci/{target}\n" in section("Quick start")


def test_extras() -> None:
    """Those that the README lists and installs are those that there are."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"].keys()
    assert set(re.findall(r"^\| `(\w+)` \|", section("Install"), re.MULTILINE)) == declared
    for listed in re.findall(r"\[([\w,]+)\]\"", section("Install")):
        assert set(listed.split(",")) <= declared
    assert commands("Install") == [["pip", "install", "lerobot_policy_lisa[babyai,analysis]"]]
