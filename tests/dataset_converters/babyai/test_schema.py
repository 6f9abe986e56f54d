"""What the dataset says of BabyAI's symbols and symmetries is true of minigrid's worlds."""

import copy
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from minigrid.core.constants import COLOR_TO_IDX, OBJECT_TO_IDX, STATE_TO_IDX
from minigrid.core.world_object import Ball, Box, Key
from minigrid.envs.babyai.core.verifier import ObjDesc

from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import ACTIONS, DIRECTIONS, Demonstration
from dataset_converters.babyai.generate import GenerateSettings, generate
from dataset_converters.babyai.schema import DIRECTION_SYMBOLS, FEATURES, GRID_SYMBOLS, SYMMETRIES
from lerobot_lisa.envs.babyai.levels import FastLevel, make_level

MIRROR, (COLORS, KINDS) = SYMMETRIES["mirror"], SYMMETRIES["permute"]
CLASSES = {"key": Key, "ball": Ball, "box": Box}
WORDS = {channel["name"]: channel["words"] for channel in GRID_SYMBOLS["channels"]}


def test_the_words_are_minigrids() -> None:
    for name, numbers in (("kind", OBJECT_TO_IDX), ("color", COLOR_TO_IDX), ("state", STATE_TO_IDX)):
        assert {word: number for number, word in enumerate(WORDS[name])} == numbers
    assert np.prod(GRID_SYMBOLS["shape"]) == FEATURES["observation.grid"]["shape"][0]
    assert DIRECTION_SYMBOLS["channels"][0]["words"] == FEATURES["observation.direction"]["names"]["classes"]


def test_lerobot_keeps_the_facts_and_the_card_leaves_them_out(tmp_path: Path) -> None:
    generate(GenerateSettings("GoToObj", 2, tmp_path / "d", "me/d"))
    features = LeRobotDataset("me/d", root=tmp_path / "d").meta.features
    assert features["observation.grid"]["info"] == {"symbols": GRID_SYMBOLS, "symmetries": SYMMETRIES}
    assert features["observation.direction"]["info"] == {"symbols": DIRECTION_SYMBOLS}
    assert "lava" not in (tmp_path / "d/README.md").read_text()


def demonstrations(name: str, count: int = 6) -> Iterator[tuple[FastLevel, Demonstration]]:
    """Demonstrations, each with its level as it was at the start."""
    level = make_level(name)
    for seed in range(1_000_000, 1_000_000 + count):
        demo = demonstrate(level, name, seed)
        assert demo is not None
        level.reset(seed=seed)
        yield level, demo


def descriptions(instruction: Any) -> Iterator[ObjDesc]:
    """Every description of an object in an instruction."""
    for value in vars(instruction).values():
        if isinstance(value, ObjDesc):
            yield value
        elif hasattr(value, "surface") and hasattr(value, "verify"):
            yield from descriptions(value)


def changed(level: FastLevel, world: Callable[[FastLevel], None], words: Callable[[ObjDesc], None]) -> FastLevel:
    """A copy of a level in another world, asking for the same in other words."""
    level = copy.deepcopy(level)
    world(level)
    for description in descriptions(level.instrs):
        words(description)
    level.instrs.reset_verifier(level)
    level.mission = level.instrs.surface(level)
    level.gen_obs()
    return level


def assert_shows(level: FastLevel, instruction: str, grid: np.ndarray, direction: np.ndarray, action: Any) -> None:
    """Acting so in this level shows exactly this, and succeeds."""
    reward, seen = 0, []
    for number in action:
        seen.append((level.view.image.reshape(-1), level.agent_dir))
        _, reward, *_ = level.step(number)
    assert np.array_equal(np.stack([image for image, _ in seen]), grid.reshape(-1, 147))
    assert [heading for _, heading in seen] == list(direction)
    assert reward > 0
    assert level.mission == instruction


def renamed(instruction: str, pairs: dict[str, str]) -> str:
    return " ".join(pairs.get(word.strip(","), word.strip(",")) + "," * word.count(",") for word in instruction.split())


def both_ways(pairs: list[list[str]]) -> dict[str, str]:
    return {old: new for pair in pairs for old, new in (pair, pair[::-1])}


def mirror_world(level: FastLevel) -> None:
    width, grid = level.width, level.grid
    cells = np.array([*grid.grid, None], object)[:-1].reshape(grid.height, width)
    grid.grid = cells[:, ::-1].reshape(-1).tolist()
    for j, i in itertools.product(range(grid.height), range(width)):
        if (cell := grid.get(i, j)) is not None:
            cell.init_pos = cell.cur_pos = (i, j)
    level.agent_pos = np.array([width - 1 - level.agent_pos[0], level.agent_pos[1]])
    level.agent_dir = (2, 1, 0, 3)[level.agent_dir]


@pytest.mark.parametrize("name", ["GoToLocal", "PickupLoc", "PutNextLocal", "Open", "Unlock", "SynthLoc", "BossLevel"])
def test_a_mirrored_episode_is_what_a_mirrored_world_shows(name: str) -> None:
    words = both_ways(MIRROR["swap_words"])

    def other_side(description: ObjDesc) -> None:
        description.loc = words.get(description.loc, description.loc)

    actions, headings = (both_ways(MIRROR["swap_actions"]), both_ways(MIRROR["swap_symbols"]["observation.direction"]))
    for level, demo in demonstrations(name, 60 if name == "PickupLoc" else 6):
        grid = np.flip(demo.grid.reshape(-1, *GRID_SYMBOLS["shape"]), 1 + GRID_SYMBOLS["axes"].index(MIRROR["axis"]))
        direction = [DIRECTIONS.index(headings.get(DIRECTIONS[i], DIRECTIONS[i])) for i in demo.direction]
        action = [ACTIONS.index(actions.get(ACTIONS[i], ACTIONS[i])) for i in demo.action]
        mirrored = changed(level, mirror_world, other_side)
        assert_shows(mirrored, renamed(demo.instruction, words), grid, np.array(direction), action)


def test_some_of_these_instructions_speak_of_sides() -> None:
    spoken = " ".join(demo.instruction for _, demo in demonstrations("PickupLoc", 60))
    assert all(words in spoken for words in ("on your left", "on your right", "behind you", "in front of you"))


def permuted(demo: Demonstration, entry: dict[str, Any], pairs: dict[str, str]) -> np.ndarray:
    """The grid with symbols renamed, as `entry` says."""
    grid = demo.grid.reshape(-1, *GRID_SYMBOLS["shape"]).copy()
    channel = list(WORDS).index(entry["channel"])
    words = WORDS[entry["channel"]]
    table = np.array([words.index(pairs.get(word, word)) for word in words], np.uint8)
    where = np.ones(grid.shape[:-1], bool)
    for name, among in entry.get("where", {}).items():
        where &= np.isin(grid[..., list(WORDS).index(name)], [WORDS[name].index(word) for word in among])
    grid[..., channel] = np.where(where, table[grid[..., channel]], grid[..., channel])
    return grid


@pytest.mark.parametrize("name", ["GoToLocal", "PutNextLocal", "Open", "Unlock", "BossLevel"])
def test_colors_can_be_exchanged_but_for_those_of_walls(name: str) -> None:
    pairs = dict(zip(COLORS["words"], [*COLORS["words"][1:], COLORS["words"][0]], strict=True))

    def recolor(level: FastLevel) -> None:
        for cell in level.grid.grid:
            if cell is not None and cell.type in COLORS["where"]["kind"]:
                cell.color = pairs[cell.color]

    def rename(description: ObjDesc) -> None:
        description.color = pairs.get(description.color, description.color)

    for level, demo in demonstrations(name):
        other = changed(level, recolor, rename)
        grid = permuted(demo, COLORS, pairs)
        assert_shows(other, renamed(demo.instruction, pairs), grid, demo.direction, demo.action)


def exchange_kinds(level: FastLevel, pairs: dict[str, str]) -> None:
    for i, cell in enumerate(level.grid.grid):
        if cell is not None and cell.type in pairs:
            level.grid.grid[i] = made = CLASSES[pairs[cell.type]](cell.color)
            made.init_pos, made.cur_pos = cell.init_pos, cell.cur_pos


def shows_a_locked_door(demo: Demonstration) -> bool:
    cells = demo.grid.reshape(-1, 3)
    looked_for = ((name, words) for name, words in KINDS["unless"].items())
    signs = [
        np.isin(cells[:, list(WORDS).index(name)], [WORDS[name].index(word) for word in words])
        for name, words in looked_for
    ]
    return bool(np.logical_and.reduce(signs).any())


@pytest.mark.parametrize("name", ["GoToLocal", "PutNextLocal", "Open", "BossLevel"])
def test_kinds_can_be_exchanged_where_no_key_is_needed(name: str) -> None:
    pairs = dict(zip(KINDS["words"], [*KINDS["words"][1:], KINDS["words"][0]], strict=True))

    def rename(description: ObjDesc) -> None:
        description.type = pairs.get(description.type, description.type)

    exchanged = 0
    for level, demo in demonstrations(name):
        if not shows_a_locked_door(demo):
            other = changed(level, lambda level: exchange_kinds(level, pairs), rename)
            grid = permuted(demo, KINDS, pairs)
            assert_shows(other, renamed(demo.instruction, pairs), grid, demo.direction, demo.action)
            exchanged += 1
    assert exchanged
    assert all(shows_a_locked_door(demo) for _, demo in demonstrations("Unlock", 3))
