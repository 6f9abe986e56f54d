"""BabyAI levels by name: the 19 of the paper and every bonus level of minigrid, fast and quiet."""

from difflib import get_close_matches
from functools import cache
from typing import Any

import gymnasium as gym
import minigrid  # noqa: F401  (registers its levels)
from gymnasium.envs.registration import load_env_creator
from minigrid.envs.babyai.core.levelgen import LevelGen
from minigrid.envs.babyai.core.roomgrid_level import RejectSampling, RoomGridLevel
from minigrid.envs.babyai.core.verifier import ObjDesc, PutNextInstr

from lerobot_lisa.envs.babyai.view import View, partial_view
from lerobot_lisa.errors import UserError

LEVELS = (
    "GoToObj", "GoToRedBallGrey", "GoToRedBall", "GoToLocal", "PutNextLocal", "PickupLoc", "GoToObjMaze",
    "GoTo", "Pickup", "UnblockPickup", "Open", "Unlock", "PutNext", "Synth", "SynthLoc", "GoToSeq", "SynthSeq",
    "GoToImpUnlock", "BossLevel",
)  # fmt: skip
"""The 19 levels of the BabyAI paper (ICLR 2019, table 1), in its order of difficulty."""

_PREFIX = "BabyAI-"


class PutNext(RoomGridLevel):
    """Put one object next to another somewhere in the 3x3 maze: the paper's level, which minigrid lacks."""

    def gen_mission(self) -> None:
        """Place the agent and 18 objects that it can reach, and choose the two of the instruction."""
        self.place_agent()
        self.connect_all()
        objects = self.add_distractors(num_distractors=18, all_unique=False)
        self.check_objs_reachable()
        move, fixed = self._rand_subset(objects, 2)
        self.instrs = PutNextInstr(ObjDesc(move.type, move.color), ObjDesc(fixed.type, fixed.color))


class FastLevel(RoomGridLevel):
    """What `make_level` adds to a minigrid level: a fast view, no printing, and a first observation that is true.

    Attributes:
        view: What the agent sees now: the image and the visible world cells.
    """

    view: View

    def gen_obs(self) -> dict[str, Any]:
        """Observe as minigrid does, by table lookup."""
        self.view = partial_view(self)
        return {"image": self.view.image, "direction": self.agent_dir, "mission": self.mission}

    def reset(self, **kwargs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode.

        minigrid observes before it puts an object in the agent's hands (the `Carrying` levels); this looks after.
        """
        _, info = super().reset(**kwargs)
        return self.gen_obs(), info

    def _gen_grid(self, width: int, height: int) -> None:
        """Draw worlds until one is accepted, as `RoomGridLevel` does, but without printing each rejection."""
        while True:
            try:
                super(RoomGridLevel, self)._gen_grid(width, height)
                self.gen_mission()
                self.validate_instrs(self.instrs)
                break
            except (RecursionError, RejectSampling):
                continue
        self.surface = self.mission = self.instrs.surface(self)


@cache
def level_names() -> tuple[str, ...]:
    """List every level that `make_level` knows: the paper's 19 first, then minigrid's bonus levels by name."""
    bonus = {_short(environment) for environment in gym.registry if environment.startswith(_PREFIX)}
    return LEVELS + tuple(sorted(bonus - set(LEVELS)))


def check_level(name: str) -> str:
    """Find the level that `name` means.

    Args:
        name: A short name such as `GoToLocal`, or minigrid's `BabyAI-GoToLocal-v0`.

    Returns:
        The short name.

    Raises:
        UserError: If there is no such level.
    """
    short = _short(name) if name.startswith(_PREFIX) else name
    if short in level_names():
        return short
    by_lower = {level.lower(): level for level in level_names()}
    close = [by_lower[match] for match in get_close_matches(short.lower(), by_lower, n=3)]
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    raise UserError(
        f"there is no BabyAI level '{name}': {hint}All {len(level_names())} names: "
        'python -c "from lerobot_lisa.envs.babyai.levels import level_names; print(*level_names())"'
    )


def make_level(name: str) -> FastLevel:
    """Build a BabyAI level, ready for its first `reset(seed=...)`.

    Same worlds, instructions, rewards and step limits for the same seeds as minigrid's own environment of that name.

    Args:
        name: A short name such as `GoToLocal`, or minigrid's `BabyAI-GoToLocal-v0`.

    Returns:
        The level as a `MiniGridEnv` that never prints and observes through `partial_view`.

    Raises:
        UserError: If there is no such level.
    """
    level, kwargs = _definition(check_level(name))
    return level(**kwargs)


def max_steps_bound(level: RoomGridLevel) -> int:
    """Bound the step limit of any episode of `level`; BabyAI sets the limit anew in every episode.

    The limit is one room's area x rooms x navigations (`RoomGridLevel.reset`); the instruction sets the last factor.
    """
    if level.fixed_max_steps:
        return level.max_steps
    return level.room_size**2 * level.num_rows * level.num_cols * _navigations_bound(level)


def _navigations_bound(level: RoomGridLevel) -> int:
    """Bound the navigations: a put-next needs two, any other action one, and a sequence joins up to four actions."""
    if not isinstance(level, LevelGen):
        return 2  # one put-next, or two doors in a row
    actions = max({"action": 1, "and": 2, "seq": 4}[kind] for kind in level.instr_kinds)
    return actions * (2 if "putnext" in level.action_kinds else 1)


def _short(environment: str) -> str:
    return environment.removeprefix(_PREFIX).rsplit("-v", 1)[0]


@cache
def _definition(short: str) -> tuple[Any, dict[str, Any]]:
    """Find the class of a level, made fast, and its arguments."""
    level: Any = PutNext
    kwargs: dict[str, Any] = {}
    if short != PutNext.__name__:
        spec = next(spec for name, spec in gym.registry.items() if name.startswith(_PREFIX) and _short(name) == short)
        level, kwargs = load_env_creator(str(spec.entry_point)), spec.kwargs
    return type(level.__name__, (FastLevel, level), {}), kwargs
