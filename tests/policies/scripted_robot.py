"""A robot without hardware for `lerobot-rollout`: joints that swing, cameras that show noise, and faults when told."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from lerobot.robots import Robot, RobotConfig

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
JOINTS = [f"{name}.pos" for name in NAMES]
CAMERAS = ("top", "wrist")


@RobotConfig.register_subclass("scripted_robot")
@dataclass
class ScriptedRobotConfig(RobotConfig):
    """`--robot.type=scripted_robot`.

    Attributes:
        height: Of its pictures.
        width: Of its pictures.
        broken_from: Step from which on a joint's sensor gives NaN; 0: never.
    """

    height: int = 48
    width: int = 64
    broken_from: int = 0


class ScriptedRobot(Robot):
    """Found by LeRobot beside its configuration."""

    config_class = ScriptedRobotConfig
    name = "scripted_robot"
    cameras: ClassVar[dict[str, Any]] = {}
    sent: ClassVar[list[dict[str, float]]] = []  # by all robots of this process

    def __init__(self, config: ScriptedRobotConfig) -> None:
        super().__init__(config)
        self.config, self._connected, self._step = config, False, 0
        self.sent.clear()

    @property
    def observation_features(self) -> dict[str, Any]:
        shape = (self.config.height, self.config.width, 3)
        return {**dict.fromkeys(JOINTS, float), **dict.fromkeys(CAMERAS, shape)}

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(JOINTS, float)

    @property
    def is_connected(self) -> bool:
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self._connected = True

    def disconnect(self) -> None:
        self._connected = False

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def get_observation(self) -> dict[str, Any]:
        self._step += 1
        random = np.random.default_rng(self._step)
        shape = (self.config.height, self.config.width, 3)
        joints = {joint: float(60 * np.sin(self._step / 50 + i)) for i, joint in enumerate(JOINTS)}
        if self.config.broken_from and self._step >= self.config.broken_from:
            joints[JOINTS[0]] = float("nan")
        return {**joints, **{camera: random.integers(0, 256, shape, dtype=np.uint8) for camera in CAMERAS}}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        self.sent.append({joint: float(value) for joint, value in action.items()})
        return action
