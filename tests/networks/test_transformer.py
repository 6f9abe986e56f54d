"""The causal transformer on its own: windows, memory, rows that are asked for."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lerobot_lisa.networks.transformer import PREFIX, CausalTransformer, after_prefix

WIDTH = 8


def transformer(layers: int, window: int | None = None) -> CausalTransformer:
    torch.manual_seed(0)
    return CausalTransformer(WIDTH, layers, heads=2, dropout=0.5, window=window).eval()


def test_prefix_comes_first() -> None:
    assert after_prefix(2, torch.arange(3)).tolist() == [PREFIX, PREFIX, 0, 1, 2]


@given(st.integers(1, 3), st.sampled_from([None, 1, 2, 5]), st.integers(1, 3), st.lists(st.integers(1, 4), max_size=12))
def test_pieces_through_a_memory_equal_the_whole(
    layers: int, window: int | None, prefix: int, pieces: list[int]
) -> None:
    network, length = transformer(layers, window), sum(pieces)
    x, order = torch.randn(2, prefix + length, WIDTH), after_prefix(prefix, torch.arange(length))
    valid = torch.ones(2, prefix + length, dtype=torch.bool)
    valid[1, 1:prefix] = False
    with torch.no_grad():
        whole = network(x, order, valid)
        memory, out = network.new_memory(), []
        for part in torch.arange(prefix + length).split([prefix, *pieces]):
            out.append(network(x[:, part], order[part], valid[:, part], memory=memory))

    torch.testing.assert_close(torch.cat(out, 1)[valid], whole[valid], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("layers", [1, 3])
def test_rows_are_a_selection(layers: int) -> None:
    network, x, order = transformer(layers), torch.randn(2, 7, WIDTH), torch.arange(7)
    rows = torch.tensor([6, 0, 3])

    torch.testing.assert_close(network(x, order, rows=rows), network(x, order)[:, rows])


def test_a_token_sees_exactly_its_window() -> None:
    """With one layer and a window of 3, a token sees itself, two before it, and the prefix."""
    network, x = transformer(1, window=3), torch.randn(1, 2 + 8, WIDTH)
    order = after_prefix(2, torch.arange(8))
    base = network(x, order)
    for position in range(10):
        changed = x.clone()
        changed[0, position] += torch.randn(WIDTH)
        affected = (network(changed, order) != base).any(-1)[0].nonzero()[:, 0].tolist()
        expected = list(range(10)) if position < 2 else list(range(position, min(position + 3, 10)))
        assert affected == expected


def test_dropout_acts_in_training_only() -> None:
    network, x, order = transformer(2), torch.randn(1, 5, WIDTH), torch.arange(5)

    assert torch.equal(network(x, order), network(x, order))
    network.train()
    assert not torch.equal(network(x, order), network(x, order))
