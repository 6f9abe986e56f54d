"""One episode of a scripted expert in LeRobot's own environment, from a seed; drawn afterwards, if it is to be seen.

LeRobot's environment draws a picture of 480 x 480 pixels at every step, which costs hundreds of times what the
simulation does, and hides from policies what experts must know: where things are. So the expert acts in the simulator
inside. Whoever wants pictures repeats the actions in the environment, which must show the same states again.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

import lerobot_lisa.envs.engine  # noqa: F401  imports MuJoCo, as LeRobot's module would, but chooses before how to draw
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.envs.metaworld import MetaworldEnv


@dataclass(frozen=True)
class MetaworldEpisode:
    """A demonstration of T steps: frame t is what is seen before action t, and the last action succeeds.

    Attributes:
        task: Name such as `reach-v3`.
        seed: Of the reset.
        state: float32 (T, 4), the hand's place and how far the gripper is open.
        action: float32 (T, 4), as executed: within -1..1.
        pictures: uint8 (T, height, width, 3), or None.
    """

    task: str
    seed: int
    state: np.ndarray
    action: np.ndarray
    pictures: np.ndarray | None = None


def engine() -> str:
    """What an episode depends on beside its task and seed."""
    return ", ".join(f"{name} {version(name)}" for name in ("metaworld", "mujoco", "lerobot"))


@contextmanager
def world(task: str) -> Iterator["MetaworldEnv"]:
    """LeRobot's environment of a task, with what a policy is shown by default."""
    from lerobot.envs.metaworld import MetaworldEnv

    env = MetaworldEnv(task, obs_type="pixels_agent_pos")
    try:
        yield env
    finally:
        env.close()


def demonstrate(env: "MetaworldEnv", seed: int) -> MetaworldEpisode | None:
    """Let the task's expert act until it succeeds; None if it does not within the environment's limit.

    Args:
        env: From `world`; it is reset.
        seed: Of the reset.
    """
    env._ensure_env()
    simulator, expert = env._env, type(env.expert_policy)()  # experts may remember the episode before
    simulator.seed(seed)
    known, _ = simulator.reset(seed=seed)
    width = env.observation_space["agent_pos"].shape[0]  # of what policies are shown of it
    states, actions, success, over = [], [], False, False
    while not success and not over:
        states.append(known[:width])
        actions.append(_action(env, expert, known))
        known, _, _, over, info = simulator.step(actions[-1])
        success = bool(info["success"])
    return MetaworldEpisode(env.task, seed, np.array(states, np.float32), np.array(actions)) if success else None


def _action(env: "MetaworldEnv", expert: Any, known: np.ndarray) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # experts ask for more than the arm can do; LeRobot's actions end at 1
        action = expert.get_action(known)
    return np.clip(action, env.action_space.low, env.action_space.high).astype(np.float32)


def draw(env: "MetaworldEnv", episode: MetaworldEpisode) -> Iterator[np.ndarray]:
    """What LeRobot's environment shows before each action of an episode, uint8 (480, 480, 3) each.

    Args:
        env: From `world`; it is reset.
        episode: What `demonstrate` gave.

    Raises:
        UserError: This machine simulates otherwise than the one that made the episode.
    """
    shown, _ = env.reset(seed=episode.seed)
    for t, state in enumerate(episode.state):
        if not np.array_equal(shown["agent_pos"].astype(np.float32), state):
            raise UserError(
                f"{episode.task}, seed {episode.seed}: repeating the actions leads elsewhere, so the episode was made "
                "on another machine: delete the unfinished run and begin anew"
            )
        yield shown["pixels"]
        if t < len(episode.action) - 1:  # what the last action leads to is in no frame
            shown, *_ = env.step(episode.action[t])
