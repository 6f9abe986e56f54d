"""Decoding a recording's videos into the episode store, against LeRobot's random access and against bare decoding.

The recording is made on the spot with LeRobot's recorder and its default codec: two cameras of 480 x 640 that look at
something with texture, move, and have a sensor's noise: 24 kB a frame, as from a camera. A drawn picture decodes
several times faster.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from benchmarks.measuring import contest
from benchmarks.table import Row, ratio_row
from lerobot_lisa.episodes.pictures import resize
from lerobot_lisa.episodes.pictures_on_disk import PicturesOnDisk

EPISODES, LENGTH, HEIGHT, WIDTH, FPS = 3, 120, 480, 640, 30
CAMERAS = ("observation.images.top", "observation.images.wrist")
IMAGE_SIZE = 128  # of the longer side
DRAWN = 60  # frames that LeRobot reads, drawn at random


def rows(options: argparse.Namespace) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        dataset = record(Path(folder) / "data")
        pictures = PicturesOnDisk(dataset.meta, CAMERAS, IMAGE_SIZE)
        _check(dataset, pictures)
        ours = _decodes_all(pictures)
        drawn = contest(ours, _reads_drawn(dataset), options.repeats, warm_up=False)
        limit = contest(ours, _decodes_bare(dataset), options.repeats, warm_up=False)
    what = f"videos of two cameras, {HEIGHT} x {WIDTH}, to pictures of {IMAGE_SIZE}"
    return [
        ratio_row(what, "LeRobot's random access, PyAV", 3, drawn, "frames"),
        ratio_row(what, "decoding from front to back, nothing kept (the limit)", 0.7, limit, "frames"),
    ]


def record(root: Path, episodes: int = EPISODES, length: int = LENGTH) -> LeRobotDataset:
    """A recording of six joints and two cameras."""
    joints = {"dtype": "float32", "shape": (6,), "names": [f"joint_{i}" for i in range(6)]}
    camera = {"dtype": "video", "shape": (HEIGHT, WIDTH, 3), "names": ["height", "width", "channels"]}
    features = {"observation.state": joints, "action": joints, **dict.fromkeys(CAMERAS, camera)}
    dataset = LeRobotDataset.create("local/recording", FPS, features, root=root, use_videos=True)
    film, joint = _Film(), np.zeros(6, np.float32)
    for _ in range(episodes):
        for step in range(length):
            picture = film.frame(step)
            shown = {CAMERAS[0]: picture, CAMERAS[1]: picture[:, ::-1].copy()}
            dataset.add_frame({"observation.state": joint, "action": joint, **shown, "task": "wipe the table"})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset("local/recording", root=root, video_backend="pyav", return_uint8=True)


class _Film:
    """A camera that moves over a texture of all sizes."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(0)
        self._texture = 120 + sum(6 * octave * self._noise(2**octave) for octave in range(1, 7))

    def _noise(self, size: int) -> np.ndarray:
        cells = self._random.normal(size=(2 * HEIGHT // size + 2, 2 * WIDTH // size + 2, 3))
        tensor = torch.from_numpy(cells).permute(2, 0, 1)[None]
        grown = torch.nn.functional.interpolate(tensor, scale_factor=size, mode="bicubic")
        return grown[0, :, : 2 * HEIGHT, : 2 * WIDTH].permute(1, 2, 0).numpy()

    def frame(self, step: int) -> np.ndarray:
        """(HEIGHT, WIDTH, 3), bytes."""
        y, x = int(HEIGHT / 2 * (1 + np.sin(step / 40)) / 2), int(WIDTH / 2 * (1 + np.cos(step / 55)) / 2)
        seen = self._texture[y : y + HEIGHT, x : x + WIDTH]
        return (seen + self._random.normal(0, 2, seen.shape)).clip(0, 255).astype(np.uint8)


def _check(dataset: LeRobotDataset, pictures: PicturesOnDisk) -> None:
    pictures.fetch(range(EPISODES))
    for key in CAMERAS:
        assert torch.equal(torch.from_numpy(pictures.columns[key][17]), resize(dataset[17][key], IMAGE_SIZE))


def _decodes_all(pictures: PicturesOnDisk) -> Callable[[], float]:
    def work() -> float:
        pictures.forget()
        pictures.fetch(range(EPISODES))
        return EPISODES * LENGTH * len(CAMERAS)

    return work


def _reads_drawn(dataset: LeRobotDataset) -> Callable[[], float]:
    def work() -> float:
        for frame in np.random.default_rng(0).integers(0, len(dataset), DRAWN):
            dataset[int(frame)]
        return DRAWN * len(CAMERAS)

    return work


def _decodes_bare(dataset: LeRobotDataset) -> Callable[[], float]:
    def work() -> float:
        frames = 0
        for path in sorted(Path(dataset.root).rglob("*.mp4")):
            with av.open(str(path)) as container:
                container.streams.video[0].codec_context.thread_count = 1
                frames += sum(1 for _ in container.decode(video=0))
        return frames

    return work
