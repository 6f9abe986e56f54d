"""The demonstration bot: minigrid's BabyAI bot, decision for decision, with a faster search and the fast view."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from minigrid.utils.baby_ai_bot import BabyAIBot

from dataset_converters.babyai.demonstration import GRID_SIZE, Demonstration
from dataset_converters.subtasks import changes
from lerobot_lisa.envs.babyai.levels import FastLevel

Position = tuple[int, int]

_MOST_GOALS = 100  # new ones in a step; no success in 40 seeds of each level took more than 10


class _Goals(list):
    """The bot's stack of goals. Before some locked doors minigrid's bot pushes new ones for ever; here it gives up.

    Attributes:
        served: The part of the instruction that the goal looked at last is for. A goal that is pushed is for the part
            that the goal which pushes it is for, and the bot looks at a goal before it lets it push.
    """

    new = 0  # in this step
    served = ""

    def append(self, goal: Any) -> None:
        self.new += 1
        if self.new > _MOST_GOALS:
            raise RuntimeError("the bot finds no plan")
        goal.part = self.served
        super().append(goal)

    def __getitem__(self, place: Any) -> Any:
        goal = super().__getitem__(place)
        self.served = goal.part
        return goal


class DemonstrationBot(BabyAIBot):
    """Chooses the actions that minigrid's `BabyAIBot` chooses, or raises where that one would plan for ever."""

    stack: _Goals

    def __init__(self, mission: FastLevel) -> None:
        super().__init__(mission)
        self.stack = _Goals(self.stack)

    @property
    def served(self) -> str:
        """The part of the instruction that the action chosen last is for, such as "go to the red ball"."""
        return self.stack.served

    def _process_instr(self, instr: Any) -> None:
        """Note of each of the first goals which part of the instruction it is for; later, "the" might have become "a".

        Called for the whole instruction and, from within, for each part, which therefore is the first to be noted.
        """
        super()._process_instr(instr)
        part = instr.surface(self.mission)
        for goal in self.stack:
            vars(goal).setdefault("part", part)

    def replan(self, action_taken: int | None = None) -> int:
        """Choose an action, knowing the one before."""
        self.stack.new = 0
        return super().replan(action_taken)

    def _process_obs(self) -> None:
        """Mark what the environment has just seen, instead of looking a second time."""
        width = self.mission.grid.width
        for cell in self.mission.view.visible:
            row, column = divmod(cell, width)
            self.vis_mask[column, row] = True
        self._seen = self.vis_mask.tolist()  # plain lists: the search reads single cells

    def _breadth_first_search(
        self, initial_states: Iterable[tuple[int, int, int, int]], accept_fn: Callable, ignore_blockers: bool
    ) -> tuple[list[Position] | None, Position | None, dict[Position, Position | None]]:
        """Search in minigrid's order, straight on first, but without copying the queue at every step.

        Upstream also queues a cell from each of its neighbours and skips all but the first; here only the first queues.
        """
        self.bfs_counter += 1
        grid, seen = self.mission.grid, self._seen
        cells, width = grid.grid, grid.width
        queued = bytearray(len(cells))
        queue: deque = deque()
        for i, j, di, dj in initial_states:
            queued[j * width + i] = True
            queue.append((i, j, di, dj, None))
        previous: dict[Position, Position | None] = {}
        while queue:
            i, j, di, dj, came_from = queue.popleft()
            here = (i, j)
            self.bfs_step_counter += 1
            cell = cells[j * width + i]
            previous[here] = came_from
            if accept_fn(here, cell):
                return _path_to(here, previous), here, previous
            if seen[i][j] and (cell is None or not _blocks(cell, ignore_blockers)):
                for k, l in ((di, dj), (dj, di), (-dj, -di), (-di, -dj)):  # noqa: E741  (minigrid's names)
                    there = (j + l) * width + i + k
                    if not queued[there]:
                        queued[there] = True
                        queue.append((i + k, j + l, k, l, here))
        return None, None, previous


def _blocks(cell: Any, ignore_blockers: bool) -> bool:
    """Whether the search stops at a cell: walls and closed doors always, other objects unless told otherwise."""
    if cell.type == "door":
        return not cell.is_open
    return cell.type == "wall" or not ignore_blockers


def _path_to(end: Position, previous: dict[Position, Position | None]) -> list[Position]:
    path: list[Position] = []
    step: Position | None = end
    while step:
        path.append(step)
        step = previous[step]
    return path


def demonstrate(level: FastLevel, name: str, seed: int) -> Demonstration | None:
    """Let the bot solve one episode.

    Args:
        level: from `make_level(name)`; it is reset.
        name: what the demonstration says about its level.
        seed: of the reset; the same seed gives the same demonstration.

    Returns:
        The demonstration, or None if the bot did not succeed within the level's step limit.
    """
    observation, _ = level.reset(seed=seed)
    bot = DemonstrationBot(level)
    images: list[np.ndarray] = []
    directions: list[int] = []
    actions: list[int] = []
    served: list[str] = []
    terminated = truncated = False
    reward = 0.0
    while not (terminated or truncated):
        try:
            action = bot.replan(actions[-1] if actions else None)
        except Exception:  # upstream's bot has no exception of its own for an episode that it cannot solve
            return None
        images.append(observation["image"])
        directions.append(observation["direction"])
        actions.append(int(action))
        served.append(bot.served)
        observation, reward, terminated, truncated, _ = level.step(action)
    if not (terminated and reward > 0):  # terminated without reward: the wrong object
        return None
    return Demonstration(
        instruction=level.mission,
        grid=np.stack(images).reshape(-1, GRID_SIZE),
        direction=np.array(directions, np.uint8),
        action=np.array(actions, np.int64),
        level=name,
        seed=seed,
        subtasks=tuple(changes(served)),
    )
