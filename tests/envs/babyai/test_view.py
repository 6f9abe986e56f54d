"""The table-driven view shows exactly what minigrid's own slicing, rotating and shadow casting shows."""

import numpy as np
import pytest
from minigrid.core.world_object import Door, Key
from minigrid.minigrid_env import MiniGridEnv
from minigrid.utils.baby_ai_bot import BabyAIBot

from lerobot_lisa.envs.babyai.levels import LEVELS, FastLevel, level_names, make_level
from lerobot_lisa.envs.babyai.view import partial_view


def check_view(level: FastLevel) -> None:
    view = partial_view(level)
    assert view.image.dtype == np.uint8
    np.testing.assert_array_equal(view.image, MiniGridEnv.gen_obs(level)["image"])
    seen = np.zeros(level.width * level.height, bool)
    seen[view.visible] = True
    np.testing.assert_array_equal(seen, bot_visibility(level))


def bot_visibility(level: FastLevel) -> np.ndarray:
    """Visible world cells according to minigrid's bot, whose mask is indexed [x, y]."""
    bot = object.__new__(BabyAIBot)
    bot.mission, bot.vis_mask, bot.prev_carrying = level, np.zeros((level.width, level.height), bool), None
    bot._process_obs()
    return bot.vis_mask.T.reshape(-1)


@pytest.mark.parametrize("name", LEVELS)
def test_equals_minigrid_on_random_walks(name: str) -> None:
    level, random = make_level(name), np.random.default_rng(0)
    for seed in range(3):
        level.reset(seed=seed)
        for action in random.choice(7, size=100, p=[0.15, 0.15, 0.3, 0.1, 0.1, 0.2, 0]):
            check_view(level)
            level.step(int(action))


@pytest.mark.parametrize("name", level_names()[len(LEVELS) :])
def test_equals_minigrid_on_bonus_levels(name: str) -> None:
    level = make_level(name)
    level.reset(seed=0)
    check_view(level)
    for _ in range(3):
        level.step(level.actions.left)
        check_view(level)


def test_shows_what_is_carried_and_every_kind_of_door() -> None:
    level = make_level("BossLevel")
    level.reset(seed=0)
    x, y = level.agent_pos = (4, 4)
    level.agent_dir = 0
    level.carrying = Key("purple")
    states = []
    for is_open, is_locked in ((True, False), (False, False), (False, True)):
        level.grid.set(x + 1, y, Door("red", is_open, is_locked))
        check_view(level)
        states.append(partial_view(level).image[3, 5].tolist())
    assert states == [[4, 0, 0], [4, 0, 1], [4, 0, 2]]
    assert partial_view(level).image[3, 6].tolist() == [5, 3, 0]


def test_every_position_and_direction_up_to_the_edges() -> None:
    level = make_level("GoTo")
    level.reset(seed=5)
    level.open_all_doors()
    for x in range(level.width):
        for y in range(0, level.height, 3):
            level.agent_pos, level.agent_dir = (x, y), (x + y) % 4
            check_view(level)


def test_views_are_independent() -> None:
    level = make_level("GoToLocal")
    before = level.reset(seed=0)[0]["image"]
    copy = before.copy()
    level.step(level.actions.left)
    np.testing.assert_array_equal(before, copy)
    assert not np.array_equal(level.view.image, before)
