"""Frames equal minigrid's own pixel by pixel, keep their size, and cost little."""

import time

import numpy as np
import pytest

from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.envs.babyai.levels import make_level
from lerobot_lisa.envs.babyai.render import Renderer
from lerobot_lisa.errors import UserError


@pytest.mark.parametrize("name", ["GoToLocal", "Unlock", "BossLevel", "UnlockPickup"])
def test_equals_minigrids_frame(name: str) -> None:
    level, renderer, random = make_level(name), Renderer(8), np.random.default_rng(0)
    for seed in range(2):
        level.reset(seed=seed)
        for action in random.choice(6, size=40, p=[0.15, 0.15, 0.3, 0.15, 0.1, 0.15]):
            level.step(int(action))
            np.testing.assert_array_equal(renderer.frame(level), level.get_frame(highlight=True, tile_size=8))


def test_shape_and_change() -> None:
    level, renderer = make_level("UnlockPickup"), Renderer(16)
    level.reset(seed=0)
    before = renderer.frame(level)
    assert (before.shape, before.dtype) == ((level.height * 16, level.width * 16, 3), np.uint8)
    level.step(level.actions.left)
    assert not np.array_equal(before, renderer.frame(level))


def test_the_agent_is_red_and_objects_keep_their_color() -> None:
    level, renderer = make_level("GoToObj"), Renderer(16)
    level.reset(seed=0)
    frame = renderer.frame(level).reshape(level.height, 16, level.width, 16, 3).astype(int)
    x, y = level.agent_pos
    red, green, blue = frame[y, :, x].mean((0, 1))
    assert red > 1.5 * max(green, blue)


@pytest.mark.parametrize("tile_size", [0, -2, 15])
def test_refuses_tiles_that_no_codec_takes(tile_size: int) -> None:
    with pytest.raises(UserError, match=f"tile_size is {tile_size}"):
        Renderer(tile_size)


def test_is_much_cheaper_than_minigrid() -> None:
    level, renderer = make_level("BossLevel"), Renderer(16)
    level.reset(seed=0)
    renderer.frame(level)
    level.get_frame(tile_size=16)

    def seconds(draw) -> float:
        start = time.process_time()
        for _ in range(20):
            draw()
        return time.process_time() - start

    assert seconds(lambda: renderer.frame(level)) < seconds(lambda: level.get_frame(tile_size=16)) / 3


@pytest.mark.parametrize(("level", "pixels"), [("GoToLocal", 8 * 16), ("BossLevel", 22 * 8)])
def test_frames_of_mazes_stay_small_because_lerobot_keeps_them_all(level: str, pixels: int) -> None:
    env = BabyAIEnv(level)
    env.reset(seed=0)

    assert env.render().shape == (pixels, pixels, 3)
