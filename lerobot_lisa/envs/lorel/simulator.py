"""The tabletop's physics: reset, action and state as in the original environment.

    simulator = LorelSimulator()
    simulator.reset(np.random.default_rng(1_000_000))
    before = simulator.state                # (15,) float64, named in lerobot_lisa.envs.lorel.state.STATE_NAMES
    simulator.step(rng.uniform(-1, 1, 5))   # the fourth number, the wrist, has no effect

Pictures of states are made by `Camera` in camera.py, instructions by `describe` in labels.py.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from lerobot_lisa.envs.engine import mujoco
from lerobot_lisa.envs.lorel.scene import ARMS, build_model
from lerobot_lisa.envs.lorel.state import BLACK_X, BLACK_Y, DRAWER, FAUCET, WHITE_X

SUBSTEPS = 5
"""Steps of the engine for each action."""

SETTLE_STEPS = 20
"""The original takes 200: it starts from an arm that is stretched out."""

_REACH = 0.2  # metres that the hand's target moves for an action of 1
_TARGET_LOW, _TARGET_HIGH = np.array([-0.3, 0.4, 0.0]), np.array([0.3, 0.8, 0.15])
_POINTING_DOWN = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
_FINGERS_OPEN = (-1.0, 1.0)


class LorelSimulator:
    """One tabletop.

    Attributes:
        model: The compiled scene, shared by all simulators of a process.
        data: MuJoCo's state of this one.
    """

    def __init__(self, arm: str = "original") -> None:
        """Build the tabletop.

        Args:
            arm: `original`, or `free`, whose numbers compare with nobody's.

        Raises:
            UserError: If metaworld is not installed or there is no such arm.
        """
        self.model = build_model(arm)
        self.data = mujoco.MjData(self.model)
        self._home = ARMS[arm].home

    @property
    def state(self) -> np.ndarray:
        """The 15 joint positions, a copy, float64."""
        return self.data.qpos.copy()

    @property
    def hand(self) -> np.ndarray:
        """Where the hand is, (3,) in metres."""
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.body("hand").xpos.copy()

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode of random play: the hand over the table, objects anywhere near the middle.

        As the world of the original data resets (docs/lorel_environment.md), with a shorter way to the same arm pose.
        Mugs may start inside one another and are then pushed apart.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:7] = self._home
        self.data.qpos[[WHITE_X, BLACK_X]] = -1.0, -1.3  # out of the arm's way
        self._hold_hand(_random_target(rng), SETTLE_STEPS, fingers=(0.0, 0.0))
        self.data.qpos[WHITE_X : BLACK_Y + 1] = np.tile((-0.2, 0.65), 2) + rng.uniform(-0.1, 0.1, 4)
        self.data.qpos[FAUCET] = rng.uniform(-np.pi / 4, np.pi / 4)
        self.data.qpos[DRAWER] = rng.uniform(-0.09, 0)
        mujoco.mj_step(self.model, self.data, nstep=100)

    def reset_for_task(
        self, rng: np.random.Generator, placement: Mapping[int, tuple[float, float]], target: ArrayLike
    ) -> None:
        """Start an episode of a task: as in random play, then some objects placed anew and the hand led to a place.

        Args:
            rng: Source of all randomness.
            placement: Bounds of the uniform distribution of an object's coordinate, by its index in the state.
            target: Where the hand is led, (3,) in metres.
        """
        self.reset(rng)
        for index, (low, high) in placement.items():
            self.data.qpos[index] = rng.uniform(low, high)
        self._hold_hand(target, 100, _FINGERS_OPEN)
        mujoco.mj_step(self.model, self.data, nstep=50)
        self.data.qvel[:] = 0
        self.data.qacc[:] = 0
        mujoco.mj_step(self.model, self.data)

    def step(self, action: ArrayLike) -> None:
        """Move the hand's target and the fingers, then let 12.5 ms pass.

        Args:
            action: Five finite numbers; x, y, z and the fingers are clipped to -1 to 1, the wrist has no effect.

        Raises:
            ValueError: If these are not five finite numbers.
        """
        values = np.asarray(action, np.float64)
        if values.shape != (5,) or not np.isfinite(values).all():
            raise ValueError(f"action is {action!r}: LOReL takes five finite numbers (x, y, z, wrist, gripper)")
        moved = self.data.mocap_pos[0] + _REACH * np.clip(values[:3], -1, 1)
        self.data.mocap_pos[0] = np.clip(moved, _TARGET_LOW, _TARGET_HIGH)
        self.data.ctrl[:] = values[4], -values[4]  # the engine clips
        mujoco.mj_step(self.model, self.data, nstep=SUBSTEPS)

    def set_state(self, state: ArrayLike, target: ArrayLike | None = None) -> None:
        """Put everything at rest in a state.

        Args:
            state: The 15 joint positions.
            target: Where the hand is being led, (3,) in metres, which a state does not say; None for where it is.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = state
        self.data.mocap_quat[0] = _POINTING_DOWN
        self.data.mocap_pos[0] = self.hand if target is None else target
        mujoco.mj_forward(self.model, self.data)

    def _hold_hand(self, target: ArrayLike, steps: int, fingers: tuple[float, float]) -> None:
        self.data.mocap_pos[0] = target
        self.data.mocap_quat[0] = _POINTING_DOWN
        self.data.ctrl[:] = fingers
        mujoco.mj_step(self.model, self.data, nstep=SUBSTEPS * steps)


def _random_target(rng: np.random.Generator) -> np.ndarray:
    """Where the hand is led in a reset; the same numbers are drawn either way."""
    near_the_mugs, (x, y) = rng.random() < 0.5, rng.uniform(-0.05, 0.05, 2)
    return np.array([x - 0.2, y + 0.65, 0.07] if near_the_mugs else [0, 0.5, 0.07])
