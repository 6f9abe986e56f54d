"""Which part of its instruction the bot serves: stored as LeRobot annotates, and nothing else is changed."""

import hashlib
import re
from pathlib import Path

import numpy as np
import programs
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dataset_converters.babyai.bot import DemonstrationBot, demonstrate
from dataset_converters.babyai.cli import main
from dataset_converters.babyai.generate import GenerateSettings, generate
from dataset_converters.babyai.shards import load_shard, make_shard
from dataset_converters.seeds import SeedRange
from dataset_converters.shard_files import load_arrays, save_arrays, shard_path
from lerobot_lisa.envs.babyai.levels import make_level

JOINTS = re.compile(r", then | after you | and ")
SEEDS = range(1_000_000, 1_000_012)


def parts_in_order(instruction: str) -> list[str]:
    """The parts of an instruction in the order in which they are to be done."""
    if " after you " in instruction:
        later, sooner = instruction.split(" after you ")
        return [*JOINTS.split(sooner), *JOINTS.split(later)]
    return JOINTS.split(instruction)


@pytest.mark.parametrize("name", ["GoToSeq", "SynthSeq", "BossLevel"])
def test_the_bot_serves_the_parts_of_its_instruction_in_their_order(name: str) -> None:
    """A part that was done on the way, or whose thing was in hand already, may be left out."""
    level, several = make_level(name), 0
    for seed in SEEDS:
        demo = demonstrate(level, name, seed)
        assert demo is not None
        served = [subtask.text for subtask in demo.subtasks]
        assert [subtask.frame for subtask in demo.subtasks] == sorted({subtask.frame for subtask in demo.subtasks})
        assert demo.subtasks[0].frame == 0
        parts = iter(parts_in_order(demo.instruction))
        assert all(text in parts for text in served), demo.instruction
        several += len(served) > 1
    assert several >= 3


def test_a_part_ends_with_what_it_asks_for() -> None:
    """Picking up ends with the bot's putting down again, opening with the door's opening."""
    level = make_level("BossLevel")
    checked = 0
    for seed in SEEDS:
        demo = demonstrate(level, "BossLevel", seed)
        assert demo is not None
        for before, after in zip(demo.subtasks, demo.subtasks[1:], strict=False):
            last = demo.action[after.frame - 1]
            if before.text.startswith("open"):
                assert last == 5  # toggle
            elif before.text.startswith(("pick", "put")):
                assert last == 4  # drop
            checked += before.text.startswith(("open", "pick", "put"))
    assert checked >= 3


def test_side_goals_are_for_the_part_that_needs_them() -> None:
    """On the way to a ball in another room the bot explores and opens doors: all of that is for the ball."""
    level = make_level("GoTo")
    level.reset(seed=1_000_003)
    bot = DemonstrationBot(level)
    kinds, action = set(), None
    for _ in range(60):
        action = bot.replan(action)
        kinds |= {type(goal).__name__ for goal in bot.stack}
        assert {goal.part for goal in list(bot.stack)} == {level.mission} == {bot.served}
        if level.step(action)[2]:
            break
    assert {"ExploreSubgoal", "OpenSubgoal"} <= kinds


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same demonstrations without and with subtasks."""
    folder = tmp_path_factory.mktemp("subtasks")
    for name, subtasks in (("plain", False), ("annotated", True)):
        generate(GenerateSettings("BossLevel", 6, folder / name, "me/boss", subtasks=subtasks))
    return folder / "plain", folder / "annotated"


def test_the_demonstrations_are_the_same_with_and_without(pair: tuple[Path, Path]) -> None:
    plain, annotated = (LeRobotDataset("me/boss", root=root) for root in pair)
    assert not plain.meta.has_language_columns
    assert annotated.meta.has_language_columns
    for key in plain.meta.features:
        ours, theirs = (np.stack(data.hf_dataset.with_format("numpy")[key]) for data in (annotated, plain))
        assert np.array_equal(ours, theirs)
    assert list(annotated.meta.stats) == list(plain.meta.stats)


def test_every_frame_of_an_episode_holds_its_subtasks_as_lerobot_annotates_them(pair: tuple[Path, Path]) -> None:
    dataset = LeRobotDataset("me/boss", root=pair[1])
    level = make_level("BossLevel")
    for episode in dataset.meta.episodes:
        demo = demonstrate(level, "BossLevel", episode["seed"])
        for frame in (episode["dataset_from_index"], episode["dataset_to_index"] - 1):
            rows = dataset[frame]["language_persistent"]
            assert [(round(row["timestamp"] * 10), row["content"]) for row in rows] == list(demo.subtasks)
            assert {(row["role"], row["style"], row["camera"], row["tool_calls"]) for row in rows} == {
                ("assistant", "subtask", None, None)
            }
            assert dataset[frame]["language_events"] == []
    assert "serves" in (pair[1] / "README.md").read_text()
    assert "serves" not in (pair[0] / "README.md").read_text()


def test_an_interrupted_run_of_an_earlier_version_goes_on(tmp_path: Path) -> None:
    """Its shards say nothing about subtasks, which nobody has asked it for."""
    make_shard(tmp_path, "GoToLocal", SeedRange(1_000_000, 1_000_003))
    path = shard_path(tmp_path, SeedRange(1_000_000, 1_000_003))
    assert all(len(demo.subtasks) == 1 for demo in load_shard(path, "GoToLocal"))
    arrays = {name: values for name, values in load_arrays(path).items() if not name.startswith("subtask")}
    save_arrays(path, **arrays)
    demos = list(load_shard(path, "GoToLocal"))
    assert [demo.seed for demo in demos] == [1_000_000, 1_000_001, 1_000_002]
    assert all(demo.subtasks == () for demo in demos)


def test_the_command_stores_them_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--level", "GoToLocal", "--episodes", "3", "--repo-id", "me/local", "--workers", "1", "--root"]
    assert main(["generate", *given, str(tmp_path / "d"), "--subtasks"]) == 0
    dataset = LeRobotDataset("me/local", root=tmp_path / "d")
    assert dataset[0]["language_persistent"][0]["content"] == dataset[0]["task"]


@pytest.mark.slow
def test_policies_train_on_it_and_learn_the_same(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """LeRobot hands annotations to every policy: these do not look at them."""
    weights = []
    for root in pair:
        output = tmp_path / root.name
        small = ["--policy.dim_model=32", "--policy.n_heads=2", "--policy.language_encoder=words", "--batch_size=2"]
        where = [f"--dataset.root={root}", "--dataset.repo_id=me/boss", f"--output_dir={output}", "--steps=2"]
        more = [
            "--policy.push_to_hub=false",
            "--policy.device=cpu",
            "--num_workers=0",
            "--save_freq=2",
            "--seed=0",
            "--env_eval_freq=0",
        ]
        done = programs.run("lerobot-train", "--policy.type=lisa", *small, *where, *more)
        assert done.returncode == 0, done.stderr[-2000:]
        weights += [path.read_bytes() for path in output.rglob("model.safetensors")]
    assert len(weights) == 2
    assert hashlib.sha256(weights[0]).digest() == hashlib.sha256(weights[1]).digest()
