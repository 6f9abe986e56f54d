"""The suites hold what the paper evaluates, and each task starts and succeeds as specified."""

import collections
import re

import numpy as np
import pytest

from lerobot_lisa.envs.lorel.env import LorelEnv
from lerobot_lisa.envs.lorel.groups import GROUPS, find_groups, suite_of, tasks_of
from lerobot_lisa.envs.lorel.labels import EVENTS
from lerobot_lisa.envs.lorel.random_floor import floor_key, random_floor, table
from lerobot_lisa.envs.lorel.state import BLACK_X, BLACK_Y, DRAWER, FAUCET, WHITE_X, WHITE_Y
from lerobot_lisa.envs.lorel.suites import SUITES, find_task
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import UserError

DISTINCT = [*SUITES["seen"], *SUITES["compositions"]]


def test_sizes() -> None:
    assert {name: len(tasks) for name, tasks in SUITES.items()} == {
        "seen": 6,
        "rephrasals": 77,
        "compositions": 15,
        "compositions_as_released": 15,
    }
    kinds = collections.Counter(task.kind for task in SUITES["rephrasals"])
    assert kinds == {"seen": 6, "unseen verb": 6, "unseen noun": 6, "unseen verb+noun": 6, "human": 53}
    assert len({task.instruction for task in SUITES["rephrasals"]}) == 73
    parts = collections.Counter(task.parts for task in SUITES["rephrasals"])
    assert set(parts) == {(task.instruction,) for task in SUITES["seen"]}
    assert sorted(parts.values()) == [12, 13, 13, 13, 13, 13]


def test_lengths() -> None:
    assert {task.steps for task in SUITES["rephrasals"]} == {20}
    assert {task.steps for task in SUITES["compositions"] + SUITES["compositions_as_released"]} == {40}


def changed(names: tuple[str, ...]) -> np.ndarray:
    state = np.zeros(15)
    for name in names:
        state[EVENTS[name].coordinate] += 1.1 * EVENTS[name].sign * EVENTS[name].threshold
    return state


@pytest.mark.parametrize("task", DISTINCT, ids=lambda task: task.instruction)
def test_success_needs_every_part(task: Task) -> None:
    assert task.succeeded(np.zeros(15), changed(task.parts))
    for part in task.parts:
        others = tuple(other for other in task.parts if other != part)
        assert not task.succeeded(np.zeros(15), changed(others))


def test_the_release_tests_another_axis_in_three_compositions() -> None:
    differing = [
        ours.instruction
        for ours, released in zip(SUITES["compositions"], SUITES["compositions_as_released"], strict=True)
        if not released.succeeded(np.zeros(15), changed(ours.parts))
    ]
    assert differing == [
        "pull the handle and move black mug down",
        "shift white mug right",
        "shift black mug down",
    ]
    left, up = changed(("move black mug left",)), changed(("move white mug up",))
    released = {task.instruction: task for task in SUITES["compositions_as_released"]}
    assert released["shift black mug down"].succeeded(np.zeros(15), left)
    assert released["shift white mug right"].succeeded(np.zeros(15), up)


def test_placements() -> None:
    assert dict(find_task("close drawer").placement) == {DRAWER: (-0.15, -0.05)}
    assert dict(find_task("unclose the cabinet").placement) == {DRAWER: (-0.05, 0)}
    composed = find_task("move black mug right and turn faucet clockwise")
    assert set(composed.placement) == {BLACK_X, BLACK_Y, FAUCET}
    assert composed.hand_target == (-0.1, 0.55, 0.1)
    assert find_task("turn tap left").hand_target == (0, 0.45, 0.1)
    # Parts never ask for different places of the same object.
    for task in DISTINCT:
        assert len(task.placement) == sum(len(Task("", (part,)).placement) for part in task.parts)


@pytest.mark.parametrize("task", DISTINCT[:9], ids=lambda task: task.instruction)
def test_episodes_start_where_specified(task: Task) -> None:
    env = LorelEnv(task)
    for seed in range(2):
        state = env.reset(seed=seed)[0]["agent_pos"]
        for index, (low, high) in task.placement.items():
            # Mugs that start inside one another, and what the arm touches, are pushed on.
            slack = 0.12 if index in (WHITE_X, WHITE_Y, BLACK_X, BLACK_Y) else 0.03
            assert low - slack < state[index] < high + slack


def test_groups_hold_their_suites_in_order() -> None:
    assert GROUPS.keys() == SUITES.keys()
    assert {group: len(tasks) for group, tasks in GROUPS["rephrasals"].items()} == {
        "rephrasals_seen": 6,
        "rephrasals_unseen_verb": 6,
        "rephrasals_unseen_noun": 6,
        "rephrasals_unseen_verb_noun": 6,
        "rephrasals_human": 53,
    }
    for suite, groups in GROUPS.items():
        held = collections.Counter(task for tasks in groups.values() for task in tasks)
        assert held == collections.Counter(SUITES[suite])


def test_find_groups() -> None:
    groups = find_groups("seen, close drawer,shift white mug right")
    assert {group: len(tasks) for group, tasks in groups.items()} == {
        "seen": 6,
        "close_drawer": 1,
        "shift_white_mug_right": 1,
    }
    assert groups["shift_white_mug_right"][0].kind == "composition"
    assert list(find_groups("seen,pull the handle", "free")) == ["seen_free_arm", "pull_the_handle_free_arm"]


def test_every_group_name_leads_back_to_its_tasks() -> None:
    instructions = {task.instruction for suite in SUITES.values() for task in suite}
    for arm in ("original", "free"):
        found = find_groups(",".join([*SUITES, *instructions]), arm)
        assert len(found) == 8 + len(instructions)
        for group, tasks in found.items():
            assert tasks_of(group) == tasks
            assert re.fullmatch(r"\w+", group)
    assert tasks_of("babyai") == ()
    assert [suite_of(group) for group in ("rephrasals_human", "rephrasals_seen_free_arm", "seen")] == [
        "rephrasals",
        "rephrasals_free_arm",
        None,
    ]


def test_a_floor_for_every_task() -> None:
    for arm in ("original", "free"):
        for suite in SUITES.values():
            assert all(0 < random_floor(task, arm) < 100 for task in suite)
    keys = {floor_key(task) for suite in SUITES.values() for task in suite}
    assert set(table()["successes"]["original"]) == set(table()["successes"]["free"]) == keys
    assert table()["episodes"] >= 1000


@pytest.mark.parametrize(
    ("names", "message"),
    [("", "env.task is '': name a suite"), ("close draw", "no LOReL task 'close draw'"), ("seen,seen", "'seen' twice")],
)
def test_refusals(names: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        find_groups(names)
