"""Success rates of parts of an evaluation."""

import numpy as np
import pandas as pd
import pytest

from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.success.breakdown import breakdowns, task_names
from lerobot_lisa.envs.lorel.groups import GROUPS


def trace(rows: list[tuple[str, int, str, bool]], task: str = "GoToLocal", world: str = "babyai") -> Trace:
    episodes = pd.DataFrame(rows, columns=["group", "task_id", "instruction", "success"])
    return Trace(pd.DataFrame(), episodes, {"env": {"type": world, "task": task}})


def counted(table: pd.DataFrame) -> dict[str, tuple[int, int]]:
    return {row.part: (row.successes, row.episodes) for row in table.itertuples()}


LEVELS = trace(
    [
        ("babyai", 0, "go to the red ball", True),
        ("babyai", 0, "go to the blue key", False),
        ("babyai", 1, "open the door", True),
        ("babyai", 1, "open a red door then go", True),
    ],
    task="GoToLocal, Open",
)


def test_levels_are_named_as_on_the_command_line() -> None:
    parts = breakdowns(LEVELS, known=None)
    assert list(parts) == ["overall", "task", "instruction length"]
    assert counted(parts["overall"]) == {"all episodes": (3, 4)}
    assert counted(parts["task"]) == {"GoToLocal": (1, 2), "Open": (2, 2)}
    assert np.isnan(parts["overall"]["random_actions"].iloc[0])


def test_seen_and_unseen_instructions() -> None:
    (table,) = (breakdowns(LEVELS, {"open the door"})[name] for name in ["seen and unseen instructions"])
    assert counted(table) == {"seen in training": (1, 1), "not seen in training": (2, 3)}


def test_lengths() -> None:
    assert counted(breakdowns(LEVELS, None)["instruction length"]) == {
        "3 words": (1, 1), "5 words": (1, 2), "6 words": (1, 1),
    }  # fmt: skip
    many = trace([("babyai", 0, "word " * length, True) for length in range(1, 61)])
    parts = counted(breakdowns(many, None)["instruction length"])
    assert [episodes for _, episodes in parts.values()] == [10] * 6
    assert list(parts)[::5] == ["1 to 10 words", "51 to 60 words"]


def test_kinds_of_rephrasals_and_the_floor() -> None:
    rows = [
        (group, task_id, task.instruction, kind == "human")
        for kind, group in (("seen", "rephrasals_seen"), ("human", "rephrasals_human"))
        for task_id, task in enumerate(GROUPS["rephrasals"][group][:3])
        for _ in range(2)
    ]
    parts = breakdowns(trace(rows, task="rephrasals", world="lorel"), None)
    assert counted(parts["kind of instruction"]) == {"seen": (0, 6), "human": (6, 6)}
    assert counted(parts["task group"]) == {"rephrasals_seen": (0, 6), "rephrasals_human": (6, 6)}
    assert ((parts["task"]["random_actions"] >= 0) & (parts["task"]["random_actions"] < 100)).all()


def test_tasks_are_told_apart() -> None:
    names = task_names(trace([("a", 0, "go", True), ("a", 0, "go", True), ("b", 0, "go", True), ("b", 0, "go", True)]))
    assert names == {("a", 0): "go (a/0)", ("b", 0): "go (b/0)"}
    (table,) = [breakdowns(LEVELS, None)["task"]]
    assert table["part"].is_unique


@pytest.mark.parametrize("known", [None, set()])
def test_one_episode(known: set[str] | None) -> None:
    parts = breakdowns(trace([("babyai", 0, "go", True)]), known)
    assert counted(parts["overall"]) == {"all episodes": (1, 1)}
