"""Asking what is seen: names find their things before anything is learned, and nothing else answers."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from lerobot_lisa.networks.language import LanguageEncoder, WordEncoder
from lerobot_lisa.networks.observations import AskingSpec, ObservationEncoder, ObservationSpec
from lerobot_lisa.networks.parts import PartAttention, spread
from lerobot_lisa.networks.symbols import SymbolNames

WIDTH, CELLS, SYMBOLS = 128, 9, 8
WORDS = ["ball", "box", "key", "red", "blue", "green"]
NAMES = SymbolNames(((-1, -1, 0, 1, 2), (3, 4, 5)))  # symbols 0 and 1 are emptiness and wall
EMPTY, WALL, BALL, BOX, KEY = range(5)
RED, BLUE, GREEN = range(3)
SPEC = ObservationSpec("symbols", (3, 3, 2), SYMBOLS, NAMES)


class World:
    """A language, an encoder of grids, and somebody who asks, none of them trained."""

    def __init__(self, seed: int = 0) -> None:
        torch.manual_seed(seed)
        self.language = LanguageEncoder(WordEncoder(len(WORDS) + 2, WIDTH), WIDTH, [[2 + n] for n in range(len(WORDS))])
        self.encoder = ObservationEncoder({"grid": SPEC}, WIDTH, asking=AskingSpec(WIDTH, 8))
        self.asks = PartAttention(WIDTH, WIDTH, 8, WIDTH, WIDTH)

    def looks(self, grid: Tensor, text: str) -> Tensor:
        """Where the last word of an instruction looks in grids (N, 3, 3, 2): attention (N, CELLS)."""
        tokens = torch.tensor([[2 + WORDS.index(word) for word in text.split()]]).expand(len(grid), -1)
        said = self.language(tokens, torch.ones_like(tokens, dtype=torch.bool))
        seen = self.encoder({"grid": grid}, self.language.names())
        _, looks = self.asks(seen.parts, said.phrases[:, -1:], said.tokens[:, -1:])
        return spread(seen.parts, looks, CELLS)


def grid(**things: tuple[int, int]) -> Tensor:
    """One grid (1, 3, 3, 2) with things at cells c0 to c8."""
    cells = torch.zeros(1, CELLS, 2, dtype=torch.uint8)
    for name, thing in things.items():
        cells[0, int(name[1:])] = torch.tensor(thing, dtype=torch.uint8)
    return cells.view(1, 3, 3, 2)


@torch.no_grad()
@given(seed=st.integers(0, 100), cell=st.integers(0, CELLS - 1))
def test_a_name_finds_its_thing_untrained(seed: int, cell: int) -> None:
    others = [(BALL, BLUE), (BOX, RED), (WALL, RED), (KEY, GREEN)]
    free = [n for n in range(CELLS) if n != cell]
    things = {f"c{cell}": (BALL, RED), **{f"c{n}": other for n, other in zip(free, others, strict=False)}}

    looks = World(seed).looks(grid(**things), "red ball")[0]

    assert looks.argmax() == cell
    assert looks[cell] > 0.3
    assert looks[cell] > 4 * looks[free].max()


@torch.no_grad()
def test_nobody_answers_to_a_name_that_is_not_there() -> None:
    for seed in range(20):
        looks = World(seed).looks(grid(c0=(BOX, BLUE), c4=(KEY, GREEN), c8=(WALL, RED)), "red ball")

        assert looks.sum() < 0.1


@torch.no_grad()
def test_without_using_names_every_cell_is_a_part_whose_key_is_learned() -> None:
    """An ablation: what belongs to a cell is still known, what it is called is not."""
    unused = replace(SPEC, names=replace(NAMES, used=False))
    encoder = ObservationEncoder({"grid": unused}, WIDTH, asking=AskingSpec(WIDTH, 8))
    world, seen = World(), grid(c2=(BALL, RED), c5=(BALL, BLUE))
    parts = encoder({"grid": seen}, world.language.names()).parts
    (keys,) = parts.keys

    assert parts.places.tolist() == [list(range(CELLS))]
    assert keys.table is encoder.parts["grid"].keys.weight  # to which no name is added
    assert keys.rows.view(CELLS, 2)[[0, 2, 5]].tolist() == [[0, SYMBOLS], [BALL, SYMBOLS + RED], [BALL, SYMBOLS + BLUE]]
    assert encoder.places == {"grid": CELLS} == world.encoder.places


@torch.no_grad()
def test_cells_without_a_thing_are_no_parts() -> None:
    world = World()
    parts = world.encoder({"grid": torch.cat([grid(c2=(BALL, RED)), grid()])}, world.language.names()).parts

    assert parts.places.shape[1] == 1
    assert parts.places[0].tolist() == [2]
    assert parts.bias[1].tolist() == [float("-inf")]
    assert torch.isfinite(world.looks(grid(), "red ball")).all()


@torch.no_grad()
def test_company_changes_nothing() -> None:
    """How many parts another frame of the batch has, or where it comes in the batch."""
    world = World()
    lonely, crowded = grid(c2=(BALL, RED)), grid(**{f"c{n}": (2 + n % 3, n % 3) for n in range(CELLS)})

    alone, together = world.looks(lonely, "red ball"), world.looks(torch.cat([crowded, lonely]), "red ball")

    torch.testing.assert_close(together[1], alone[0])


def test_questions_that_are_none_say_nothing() -> None:
    world = World()
    tokens = torch.tensor([[5, 2, 0]])
    said = world.language(tokens, torch.tensor([[True, True, False]]))
    parts = world.encoder({"grid": grid(c2=(BALL, RED))}, world.language.names()).parts

    padded, _ = world.asks(parts, said.phrases, said.tokens, said.valid)
    cut, _ = world.asks(parts, said.phrases[:, :2], said.tokens[:, :2], said.valid[:, :2])

    torch.testing.assert_close(padded, cut)


@pytest.mark.parametrize(
    ("spec", "places"),
    [
        (ObservationSpec("symbols", (5,), SYMBOLS), 5),
        (ObservationSpec("state", (4,)), 1),
        (ObservationSpec("image", (3, 32, 40)), 16),
    ],
)
def test_parts_without_names_can_learn_to_answer(spec: ObservationSpec, places: int) -> None:
    torch.manual_seed(0)
    encoder = ObservationEncoder({"it": spec}, WIDTH, asking=AskingSpec(WIDTH, 8))
    asks = PartAttention(16, WIDTH, 8, 16, WIDTH)
    what = torch.randint(0, 4, (6, *spec.shape)) if spec.kind == "symbols" else torch.rand(6, *spec.shape)
    seen = encoder({"it": what}, torch.zeros(0, WIDTH))

    answers, looks = asks(seen.parts, torch.randn(6, 2, 16), torch.randn(6, 2, 16))
    answers.sum().backward()

    assert encoder.all_places == places
    assert looks.shape == (6, 2, places)
    assert looks.sum(-1).min() > 0.2  # it is not turned away before it has learned anything
    assert all(p.grad is not None and p.grad.any() for p in encoder.parts.parameters() if p.numel() > 1)


def test_places_of_several_features_are_numbered_through() -> None:
    specs = {"state": ObservationSpec("state", (4,)), "grid": SPEC}
    encoder = ObservationEncoder(specs, WIDTH, asking=AskingSpec(WIDTH, 8))
    seen = encoder({"state": torch.rand(1, 4), "grid": grid(c2=(BALL, RED))}, torch.zeros(len(WORDS), WIDTH))

    assert encoder.places == {"state": 1, "grid": CELLS}
    assert sorted(seen.parts.places[0].tolist()) == [0, 1 + 2]
