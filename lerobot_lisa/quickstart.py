"""The main job on a small level, offline: demonstrations, training, success, how much of it is listening, skills.

python -m lerobot_lisa.quickstart --dir quickstart

Prints each command before it runs it. Run again after an interruption, it goes on where it was.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import environ
from pathlib import Path
from typing import Any

import yaml

from lerobot_lisa.errors import UserError, exit_code

LEVEL = "GoToLocal"
REPO_ID = "quickstart/babyai_gotolocal"
DEMONSTRATIONS = 20_000
EVALUATION_EPISODES = 200
STEPS = 15  # of an evaluation episode, at most: three times what the bot needs; BabyAI itself allows 64
PROGRESS = re.compile(r"\bstep:\S+ .*")  # of what LeRobot logs, the lines about training


@dataclass(frozen=True)
class Step:
    """One command.

    Attributes:
        name: For messages and its log file.
        command: A program of this environment, or "python", and its arguments.
        result: The file that the command writes last.
    """

    name: str
    command: list[str]
    result: Path


def plan(folder: Path, seed: int, recipe: Path) -> list[Step]:
    """The commands that make everything in `folder`, in order."""
    data, run, evaluation, heard, skills = (
        folder / name for name in ("data", "lisa", "eval", "listening", "skill_words")
    )
    steps = yaml.safe_load(recipe.read_text(encoding="utf-8"))["steps"]
    policy = run / "checkpoints" / f"{steps:06d}" / "pretrained_model"
    generate = ["python", "-m", "dataset_converters.babyai", "generate", f"--level={LEVEL}"]
    generate += [f"--episodes={DEMONSTRATIONS}", f"--root={data}", f"--repo-id={REPO_ID}"]
    evaluate = ["lerobot-eval", f"--policy.path={policy}", "--policy.device=cpu", "--env.type=babyai"]
    evaluate += [f"--env.task={LEVEL}", f"--env.max_episode_steps={STEPS}"]
    evaluate += [f"--eval.n_episodes={EVALUATION_EPISODES}", "--eval.batch_size=50"]
    evaluate += ["--eval.use_async_envs=false", "--seed=1000", f"--output_dir={evaluation}"]
    rates = ["python", "-m", "lerobot_lisa.analysis.success", str(evaluation / "eval_info.json")]
    listen = ["lisa-diagnose", "heard", f"--policy.path={policy}", "--policy.device=cpu", "--env.type=babyai"]
    listen += [f"--env.task={LEVEL}", f"--env.max_episode_steps={STEPS}"]
    listen += [f"--n_episodes={EVALUATION_EPISODES}", "--batch_size=50", "--seed=1000"]
    words = ["python", "-m", "lerobot_lisa.analysis.skills", f"--policy.path={policy}", "--policy.device=cpu"]
    words += [f"--dataset.root={data}", f"--output_dir={skills}"]
    return [
        Step("generate", generate, data / "meta" / "info.json"),
        Step("train", _train(run, data, seed, recipe), policy.with_name("training_state") / "scheduler_state.json"),
        Step("evaluate", evaluate, evaluation / "eval_info.json"),
        Step("success", [*rates, f"--json={folder / 'success.json'}"], folder / "success.json"),
        Step("listening", [*listen, f"--output_dir={heard}"], heard / "heard.json"),
        Step("skill_words", words, skills / "skill_words_pmi.csv"),
    ]


def _train(run: Path, data: Path, seed: int, recipe: Path) -> list[str]:
    """Train, or go on from the last checkpoint."""
    saved = run / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if saved.is_file():
        return ["lerobot-train", f"--config_path={saved}", "--resume=true"]
    options = [f"--dataset.root={data}", f"--output_dir={run}", f"--seed={seed}"]
    return ["lerobot-train", f"--config_path={recipe}", *options]


def find_recipe() -> Path:
    """The training configuration: packed into a wheel, beside the package in a checkout."""
    package = Path(__file__).parent
    candidates = [parent / "configs" / "quickstart" / "lisa.yaml" for parent in (package, package.parent)]
    return next(path for path in candidates if path.is_file())


def run(step: Step, logs: Path) -> None:
    """Print a command and run it; what it writes to standard error goes into a log file.

    Raises:
        UserError: It failed.
    """
    print(f"\n$ {shlex.join(step.command)}", flush=True)
    log = logs / f"{step.name}.log"
    last = ""
    with (
        log.open("a", encoding="utf-8") as file,
        subprocess.Popen(
            _executable(step.command), stderr=subprocess.PIPE, text=True, errors="replace", env=_environment()
        ) as process,
    ):
        for line in process.stderr or ():  # universal newlines: a progress bar's states are lines too
            file.write(line)
            last = line.strip() or last
            if progress := PROGRESS.search(line):
                print(progress[0], flush=True)
    if process.returncode:
        raise UserError(f"`{step.command[0]}` ended with exit code {process.returncode}: {last} (all of it: {log})")


def _executable(command: list[str]) -> list[str]:
    """The command with its program's full path, so that it is this environment's."""
    program, *arguments = command
    path = sys.executable if program == "python" else str(Path(sysconfig.get_path("scripts")) / program)
    return [path, *arguments]


def _environment() -> dict[str, str]:
    """Nothing is fetched, and a network of this size gains nothing from threads."""
    return {"OMP_NUM_THREADS": "1", **environ, "HF_HUB_OFFLINE": "1"}


def quickstart(folder: Path, seed: int) -> None:
    """Run what is not finished yet, and say what came out.

    Raises:
        UserError: The folder belongs to another seed, or a command failed.
    """
    _claim(folder, seed)
    recipe = find_recipe()
    for number in range(len(plan(folder, seed, recipe))):
        step = plan(folder, seed, recipe)[number]
        if step.result.exists():
            print(f"\n{step.name}: finished before ({step.result})")
        else:
            run(step, folder / "logs")
    print(*closing(folder), sep="\n")


def closing(folder: Path) -> Iterator[str]:
    """What came out, in a few lines."""
    overall = _read(folder / "success.json")
    interval = f"95 % interval {overall['low']:.1f} to {overall['high']:.1f} %, n = {overall['episodes']}"
    yield f"\nSuccess rate on {LEVEL} within {STEPS} steps: {overall['percent']:.1f} % ({interval})"
    listening = _read(folder / "listening" / "heard.json")
    heard, twice, spl = listening["heard"], listening["budgets"]["2"], listening["spl"]
    yield (
        f"Within twice the bot's steps: {twice['success']['percent']:.1f} %, and "
        f"{twice['told_otherwise']['percent']:.1f} % when told something else; SPL {spl['value']:.2f}"
    )
    yield (
        f"Heard, what success loses when something else is told: {heard['points']:.1f} points "
        f"(95 % interval {heard['low']:.1f} to {heard['high']:.1f})"
    )
    yield f"Words of each skill: {folder / 'skill_words' / 'skill_words_by_skill.png'}"


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))["rates"]["overall"]


def _claim(folder: Path, seed: int) -> None:
    """Note the seed in a new folder; refuse a folder that was made with another one."""
    note = folder / "seed"
    if note.is_file():
        if note.read_text(encoding="utf-8").strip() != str(seed):
            raise UserError(
                f"{folder} was made with seed {note.read_text().strip()}: give another --dir for seed {seed}"
            )
        return
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    note.write_text(f"{seed}\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--dir", type=Path, default=Path("quickstart"), help="for everything made (default: quickstart)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the training (default: 0)")
    options = parser.parse_args(arguments)
    return exit_code(
        lambda: quickstart(options.dir, options.seed), interrupted="interrupted; run the same command again to go on"
    )


if __name__ == "__main__":
    sys.exit(main())
