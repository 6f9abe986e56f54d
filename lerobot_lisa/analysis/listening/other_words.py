"""Which other instruction an episode could be told, for each world."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import pandas as pd
from lerobot.envs.configs import EnvConfig
from tqdm import tqdm

from lerobot_lisa.analysis.listening.telling import Told

OTHER, NOTHING = "other", "nothing"
TOLD = (OTHER, NOTHING)
DEAF = "something"
"""What everybody is told who is told nothing: one word, the same in every episode."""

_Task = tuple[str, int]
_HOPELESS = 5  # episodes in a row without another instruction: the level has only one


def other_words(told: str, env: EnvConfig, episodes: pd.DataFrame) -> Told:
    """What to tell each episode in place of its own instruction; episodes without another one are left out.

    Args:
        told: `OTHER` or `NOTHING`.
        env: The environment that they are of.
        episodes: Columns of `traces.EPISODES`, told their own instruction.
    """
    if told == NOTHING:
        return _table((row, DEAF) for row in episodes.itertuples())
    return _WORLDS.get(env.type, _of_other_tasks)(env, episodes)


def several_tasks(env: EnvConfig, envs: Mapping[str, Mapping[int, Any]]) -> bool:
    """Whether there may be another instruction: another task's, or, in BabyAI, another episode's."""
    return env.type == "babyai" or sum(map(len, envs.values())) > 1


def _of_other_tasks(
    env: EnvConfig, episodes: pd.DataFrame, differ: Callable[[_Task, _Task], bool] = lambda own, other: own != other
) -> Told:
    """What other tasks' episodes of the same number are told, of the same group if it has several; the seed chooses."""
    said = {(row.group, row.task_id, row.episode): str(row.instruction) for row in episodes.itertuples()}
    tasks = list(dict.fromkeys((group, task_id) for group, task_id, _ in said))
    others = {own: _near(own, [other for other in tasks if differ(own, other)]) for own in tasks}
    listed = []
    for row in episodes.itertuples():
        texts = [said[*other, row.episode] for other in others[row.group, row.task_id]]
        if another := [text for text in texts if text != row.instruction]:
            listed.append((row, another[row.seed % len(another)]))
    return _table(listed)


def _near(own: _Task, others: list[_Task]) -> list[_Task]:
    return [other for other in others if other[0] == own[0]] or others


def _of_lorels_tasks(env: EnvConfig, episodes: pd.DataFrame) -> Told:
    """What tasks are told that have no part in common: others only say the same in other words."""

    from lerobot_lisa.envs.lorel.groups import tasks_of

    def differ(own: _Task, other: _Task) -> bool:
        here, there = (tasks_of(group)[task_id].parts for group, task_id in (own, other))
        return set(here).isdisjoint(there)

    return _of_other_tasks(env, episodes, differ)


def _of_babyais_worlds(env: Any, episodes: pd.DataFrame) -> Told:
    """What other episodes of the level are told, if its objects are in this world, too."""
    from lerobot_lisa.analysis.listening.babyai import another_mission

    levels, listed, misses = env.levels, [], dict.fromkeys(episodes["task_id"], 0)
    for row in tqdm(episodes.itertuples(), desc="looking for other instructions", total=len(episodes), disable=None):
        if misses[row.task_id] < _HOPELESS:
            text = another_mission(levels[row.task_id], row.seed)
            misses[row.task_id] = misses[row.task_id] + 1 if text is None else 0
            listed += [] if text is None else [(row, text)]
    return _table(listed)


def _table(listed: Iterable[tuple[Any, str]]) -> Told:
    told: dict[_Task, dict[int, str]] = {}
    for row, text in listed:
        told.setdefault((row.group, row.task_id), {})[row.seed] = text
    return told


_WORLDS: dict[str, Callable[[EnvConfig, pd.DataFrame], Told]] = {
    "babyai": _of_babyais_worlds,
    "lorel": _of_lorels_tasks,
}
