"""Augmentation: whatever is changed, is changed in grid, actions and words alike, and nothing else is."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from dataset_converters.babyai.schema import FEATURES
from lerobot_lisa.episodes.symmetries import Symmetries, Told, symmetry_words
from lerobot_lisa.networks.packing import Packing

GRID, DIRECTION, ACTION = "observation.grid", "observation.direction", "action"
WORDS = ["go", "to", "the", "on", "your", *symmetry_words(FEATURES)]
TOKENS = {word: 2 + number for number, word in enumerate(WORDS)}
KINDS, COLORS, STATES = (channel["words"] for channel in FEATURES[GRID]["info"]["symbols"]["channels"])
KEY, BALL, BOX, DOOR, WALL = (KINDS.index(kind) for kind in ("key", "ball", "box", "door", "wall"))


def tokens(*instructions: str) -> Tensor:
    rows = [[TOKENS[word] for word in text.split()] for text in instructions]
    longest = max(map(len, rows))
    return torch.tensor([row + [0] * (longest - len(row)) for row in rows])


def words(row: Tensor) -> str:
    names = {number: word for word, number in TOKENS.items()}
    return " ".join(names[int(token)] for token in row if token)


def episodes(count: int = 40, length: int = 3) -> tuple[Told, Packing]:
    """In each, a red ball at the left of the view, a grey wall ahead, emptiness elsewhere, and a turn to the left."""
    grid = torch.zeros(count * length, 7, 7, 3, dtype=torch.uint8)
    grid[..., 0] = KINDS.index("empty")
    grid[:, 1, 4] = torch.tensor([BALL, COLORS.index("red"), 0], dtype=torch.uint8)
    grid[:, :, 0] = torch.tensor([WALL, COLORS.index("grey"), 0], dtype=torch.uint8)
    frames = {
        GRID: grid.flatten(1),
        DIRECTION: torch.zeros(count * length, 1, dtype=torch.uint8),  # to the right
        ACTION: torch.zeros(count * length, 1, dtype=torch.int64),  # left
        "observation.state": torch.arange(count * length)[:, None].float(),
    }
    told = tokens(*["go to the red ball on your left"] * count)
    return Told(frames, told), Packing(torch.full((count,), length))


def symmetries() -> Symmetries:
    return Symmetries(GRID, FEATURES, TOKENS)


def ball_of(grid: Tensor) -> tuple[bool, str, str]:
    """Whether the thing is at the right of a view, its color and its kind."""
    cells = grid.view(7, 7, 3)
    side = 5 if cells[5, 4, 0] in (KEY, BALL, BOX) else 1
    kind, color, _ = cells[side, 4].tolist()
    return side == 5, COLORS[color], KINDS[kind]


@given(seed=st.integers(0, 1000))
def test_what_is_said_is_what_is_seen_and_done(seed: int) -> None:
    told, packing = episodes()
    torch.manual_seed(seed)

    frames, changed = symmetries()(told, packing)

    seen = set()
    for episode, row in enumerate(changed):
        first = 3 * episode
        right, color, kind = ball_of(frames[GRID][first])
        assert words(row) == f"go to the {color} {kind} on your {'right' if right else 'left'}"
        assert frames[ACTION][first : first + 3].flatten().tolist() == [int(right)] * 3
        assert frames[DIRECTION][first : first + 3].flatten().tolist() == [2 if right else 0] * 3
        assert all(torch.equal(frames[GRID][first], frames[GRID][first + step]) for step in range(3))
        seen.add((right, color, kind))
    assert len(seen) > 15  # of 36


def test_all_else_stays() -> None:
    told, packing = episodes()

    frames, _ = symmetries()(told, packing)

    grid = frames[GRID].view(-1, 7, 7, 3)
    assert (grid[:, :, 0] == torch.tensor([WALL, COLORS.index("grey"), 0])).all()
    assert (grid[..., 0] == KINDS.index("empty")).sum() == (told.frames[GRID].view(-1, 7, 7, 3)[..., 0] == 1).sum()
    assert (grid[grid[..., 0] == KINDS.index("empty")][:, 1] == 0).all()
    assert torch.equal(frames["observation.state"], told.frames["observation.state"])
    assert {key: value.dtype for key, value in frames.items()} == {k: v.dtype for k, v in told.frames.items()}
    assert torch.equal(told.frames[GRID], episodes()[0].frames[GRID])  # what was given is as it was


def test_only_a_key_opens_a_locked_door() -> None:
    told, packing = episodes()
    told.frames[GRID].view(-1, 7, 7, 3)[1::3, 3, 3] = torch.tensor(
        [DOOR, COLORS.index("blue"), STATES.index("locked")], dtype=torch.uint8
    )

    frames, changed = symmetries()(told, packing)

    for episode, row in enumerate(changed):
        door = frames[GRID].view(-1, 7, 7, 3)[3 * episode + 1, 3, 3].tolist()
        assert ball_of(frames[GRID][3 * episode])[2] == "ball"
        assert "ball" in words(row)
        assert (door[0], door[2]) == (DOOR, STATES.index("locked"))
    assert (
        len({frames[GRID].view(-1, 7, 7, 3)[3 * e + 1, 3, 3, 1].item() for e in range(40)}) > 3
    )  # doors are recolored


def test_words_that_are_never_said_are_never_made_up() -> None:
    """Colors without a token stay, and so do things of these colors."""
    told, packing = episodes()
    known = {word: token for word, token in TOKENS.items() if word not in ("grey", "yellow")}

    _, changed = Symmetries(GRID, FEATURES, known)(told, packing)

    assert not {"grey", "yellow"} & {word for row in changed for word in words(row).split()}


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int64, torch.float32])
def test_any_dtype_of_the_grid(dtype: torch.dtype) -> None:
    told, packing = episodes(4)
    told.frames[GRID] = told.frames[GRID].to(dtype)

    frames, _ = symmetries()(told, packing)

    assert frames[GRID].dtype == dtype
