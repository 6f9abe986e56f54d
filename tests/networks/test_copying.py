"""Copying words: which may be pointed at, and what of them is taken along."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from lerobot_lisa.networks.copying import SHARPNESS, PhraseCopier
from lerobot_lisa.networks.language import Instruction, LanguageEncoder, WordEncoder

WIDTH = 16
RED, BALL, BOX, GO, TO = range(2, 7)
NAMES = [[RED], [BALL], [BOX]]


def said(*tokens: int, names: list[list[int]] = NAMES) -> Instruction:
    """One instruction by an encoder with random weights."""
    words = torch.tensor([tokens])
    return LanguageEncoder(WordEncoder(9, WIDTH), WIDTH, names)(words, torch.ones_like(words, dtype=torch.bool))


@torch.no_grad()
def test_names_end_with_their_last_word() -> None:
    assert said(GO, TO, RED, BALL, GO, BOX).ends.tolist() == [[False, False, False, True, False, True]]
    assert said(RED, RED).ends.tolist() == [[False, True]]


@torch.no_grad()
def test_where_nothing_is_named_any_word_may_be_pointed_at() -> None:
    assert said(GO, TO).ends.all()
    assert said(GO, RED, names=[]).ends.all()


@torch.no_grad()
@given(seed=st.integers(0, 1000), parts=st.integers(1, 3))
def test_the_first_part_is_a_whole_name_that_is_said(seed: int, parts: int) -> None:
    torch.manual_seed(seed)
    instruction = said(GO, TO, RED, BALL, GO, TO, BOX)
    copier = PhraseCopier(WIDTH, WIDTH, parts)
    answers = torch.randn(5, WIDTH)

    phrases = copier(answers, instruction.take(torch.zeros(5, dtype=torch.int64)))

    assert phrases.shape == (5, parts, WIDTH)
    for phrase in phrases[:, 0]:
        assert any(torch.allclose(phrase, instruction.phrases[0, place]) for place in (3, 6))
    for phrase in phrases[:, 1:].flatten(0, 1):
        assert any(torch.allclose(phrase, each) for each in instruction.phrases[0])


@torch.no_grad()
def test_before_there_are_codes_phrases_are_mixed() -> None:
    torch.manual_seed(0)
    instruction = said(RED, BALL, GO, TO, BOX)
    copier = PhraseCopier(WIDTH, WIDTH, 1)

    mixed, pointers = (
        copier(torch.randn(1, WIDTH), instruction, whole=False),
        copier.pointers(torch.ones(1, WIDTH), instruction),
    )

    assert pointers[0, 0].tolist() == [0, pointers[0, 0, 1], 0, 0, pointers[0, 0, 4]]
    between = instruction.phrases[0, 1] - instruction.phrases[0, 4]
    share = ((mixed[0, 0] - instruction.phrases[0, 4]) / between).round(decimals=4).unique()
    assert len(share) == 1
    assert 0 < share < 1


def test_whole_phrases_teach_where_to_point() -> None:
    torch.manual_seed(0)
    instruction = said(RED, BALL, GO, TO, BOX)
    copier = PhraseCopier(WIDTH, WIDTH, 1)
    answers = torch.randn(1, WIDTH, requires_grad=True)

    copier(answers, instruction)[0, 0, 0].backward()

    assert answers.grad.abs().sum() > 0


@torch.no_grad()
def test_made_up_parts_come_last_and_take_no_words() -> None:
    copier = PhraseCopier(WIDTH, WIDTH, 1, own=2, own_width=4)
    answers = torch.randn(3, WIDTH)
    here, there = (said(*words).take(torch.zeros(3, dtype=torch.int64)) for words in ((RED, BALL), (BOX,)))

    assert copier(answers, here).shape == (3, 3, WIDTH)
    torch.testing.assert_close(copier(answers, here)[:, 1:], copier(answers, there)[:, 1:])


@torch.no_grad()
@given(seed=st.integers(0, 1000), size=st.sampled_from([1.0, 1e3]))
def test_a_pointer_never_grows_certain(seed: int, size: float) -> None:
    """However sure the skill predictor is, of two things that are named each stays possible."""
    torch.manual_seed(seed)
    copier = PhraseCopier(WIDTH, WIDTH, 1)

    pointers = copier.pointers(size * torch.randn(4, WIDTH), said(RED, BALL, GO, TO, BOX).take(torch.zeros(4).long()))

    assert pointers[:, 0, [1, 4]].min() > 1 / (1 + torch.e ** (2 * SHARPNESS)) - 1e-6
