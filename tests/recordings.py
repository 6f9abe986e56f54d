"""Small recordings, made with LeRobot's own recorder: cameras as video, tasks that change within an episode."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

CAMERAS = ("observation.images.top", "observation.images.wrist")
HEIGHT, WIDTH = 48, 64
FPS = 10


def record(
    root: Path,
    lengths: Sequence[int] = (9, 4, 13),
    task: Callable[[int, int], str] = lambda episode, step: f"do {episode % 2}",
    cameras: Sequence[str] = CAMERAS,
) -> Path:
    """A dataset of joints and cameras whose pictures are all different; `task` is of an episode's step."""
    camera = {"dtype": "video", "shape": (HEIGHT, WIDTH, 3), "names": ["height", "width", "channels"]}
    joints = {"dtype": "float32", "shape": (2,), "names": ["a", "b"]}
    features = {"observation.state": joints, "action": joints, **dict.fromkeys(cameras, camera)}
    dataset = LeRobotDataset.create("local/tiny", FPS, features, root=root, use_videos=bool(cameras))
    for episode, length in enumerate(lengths):
        for step in range(length):
            joint = np.array([episode, step], np.float32)
            pictures = {key: _picture(episode, step, i) for i, key in enumerate(cameras)}
            dataset.add_frame({"observation.state": joint, "action": joint, **pictures, "task": task(episode, step)})
        dataset.save_episode()
    dataset.finalize()
    return root


def _picture(episode: int, step: int, camera: int) -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    picture = np.stack([x * 4, y * 5, np.full_like(x, 60 * camera + 20 * episode)], axis=2).astype(np.uint8)
    picture[10:20, 3 * step : 3 * step + 10] = 255
    return picture
