"""The judge of what was told learns from labels that name many things at once what each of them means."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from tiny_networks import WIDTH, WORDS
from torch import Tensor

from lerobot_lisa.networks.judge import Judge, _is_made_of, _is_part, _pairs
from lerobot_lisa.networks.language import LanguageEncoder, WordEncoder, pad_tokens

AND = 2
WORD = st.integers(2, 5)
SAID = st.lists(WORD, min_size=1, max_size=6)


def padded(*rows: list[int]) -> Tensor:
    tokens, valid = pad_tokens(rows)
    return tokens.masked_fill(~valid, -1)


@given(inner=SAID, outer=SAID)
def test_what_is_said_within(inner: list[int], outer: list[int]) -> None:
    tokens = padded(inner, outer)
    runs = [outer[i : i + len(inner)] for i in range(len(outer))]

    assert bool(_is_part(tokens[:1], tokens[1:])) == (inner in runs)
    assert bool(_is_made_of(tokens[:1], tokens[1:])) == (set(inner) <= set(outer))


@given(episodes=st.integers(1, 12), random=st.booleans())
def test_an_episode_is_held_against_others(episodes: int, random: bool) -> None:
    own, other = _pairs(episodes, random, torch.device("cpu"))
    pairs = set(zip(own.tolist(), other.tolist(), strict=True))

    assert len(pairs) == len(own) == episodes * min(episodes - 1, 8)
    assert all(one != another for one, another in pairs)


def random_play(episodes: int, seed: int) -> tuple[Tensor, Tensor, list[list[int]]]:
    """First and last states (B, 3) and labels: tokens of the numbers that grew, "3 and 5", in any order."""
    random = torch.Generator().manual_seed(seed)
    first = torch.randn(episodes, 3, generator=random)
    change = torch.randn(episodes, 3, generator=random)
    labels = []
    for row in change:
        grown = [3 + i for i in torch.randperm(3, generator=random).tolist() if row[i] > 0]
        labels.append([token for number in grown for token in (AND, number)][1:] or [7])
    return first, first + change, labels


def test_it_knows_each_of_many_things_done_at_once() -> None:
    """Most labels that name a thing name others, too: held against such a label, the thing alone would be false."""
    torch.manual_seed(0)
    language, judge = LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH), Judge(3, WIDTH, 0.0)
    optimizer = torch.optim.Adam([*language.parameters(), *judge.parameters()], lr=1e-2)
    for step in range(200):
        first, last, labels = random_play(64, step)
        tokens, valid = pad_tokens(labels)
        judged = judge.learn(first, last, language(tokens, valid).sentence(), tokens, valid)
        optimizer.zero_grad()
        judged.judge_loss.backward()
        optimizer.step()

    first, last, _ = random_play(500, 1000)
    for number in range(3):
        tokens, valid = pad_tokens([[3 + number]])
        with torch.no_grad():
            said = judge(first, last, language(tokens, valid).sentence().expand(500, -1))
        done = (last > first)[:, number]
        assert (said[done][:, None] > said[~done]).float().mean() > 0.95  # the area under its curve
        assert (said > 0)[done].float().mean() > 0.8  # with whole labels alone less than half
