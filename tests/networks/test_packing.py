"""Index arithmetic over sequences of any lengths."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from lerobot_lisa.networks.packing import Packing, by_length

LENGTHS = st.lists(st.integers(1, 13), min_size=1, max_size=7)
HORIZONS = st.integers(1, 14)


def rows_of(lengths: list[int]) -> Tensor:
    """Different values in every row, (N, 2)."""
    return torch.arange(2.0 * sum(lengths)).view(-1, 2)


@given(LENGTHS)
def test_unpad_undoes_pad(lengths: list[int]) -> None:
    packing, rows = Packing(torch.tensor(lengths)), rows_of(lengths)

    padded = packing.pad(rows)

    assert padded.shape == (len(lengths), max(lengths), 2)
    assert torch.equal(packing.unpad(padded), rows)
    assert torch.equal(padded[packing.valid], rows)
    assert torch.equal(packing.unpad(torch.cat([padded, padded], dim=1)), rows)  # wider than needed


@given(LENGTHS)
def test_steps_and_sequences_count_from_zero(lengths: list[int]) -> None:
    packing = Packing(torch.tensor(lengths))

    assert packing.steps.tolist() == [t for n in lengths for t in range(n)]
    assert packing.sequence.tolist() == [i for i, n in enumerate(lengths) for _ in range(n)]
    assert packing.total == sum(lengths)


@given(LENGTHS, HORIZONS)
def test_chunks_start_at_multiples_of_the_horizon(lengths: list[int], horizon: int) -> None:
    packing = Packing(torch.tensor(lengths))
    chunks = packing.split(horizon)
    expected = [min(horizon, n - first) for n in lengths for first in range(0, n, horizon)]

    assert chunks.lengths.tolist() == expected
    assert chunks.steps.tolist() == [t % horizon for n in lengths for t in range(n)]
    assert packing.count_chunks(horizon).lengths.tolist() == [-(-n // horizon) for n in lengths]


@given(LENGTHS, st.data())
def test_rows_and_means_of_sequences(lengths: list[int], data: st.DataObject) -> None:
    packing, rows = Packing(torch.tensor(lengths)), rows_of(lengths)
    each = rows.split(lengths)
    chosen = data.draw(st.lists(st.integers(0, len(lengths) - 1), min_size=1))

    assert torch.equal(rows[packing.rows(torch.tensor(chosen))], torch.cat([each[i] for i in chosen]))
    torch.testing.assert_close(packing.mean(rows[:, 0]), torch.stack([part[:, 0].mean() for part in each]))


@given(st.lists(st.integers(1, 90), min_size=1, max_size=30), st.floats(0, 1))
def test_grouping_by_length_partitions_and_limits_padding(lengths: list[int], waste: float) -> None:
    groups = by_length(torch.tensor(lengths), waste)

    assert sorted(torch.cat(groups).tolist()) == list(range(len(lengths)))
    for group in groups:
        longest = max(lengths[i] for i in group)
        assert 1 - sum(lengths[i] for i in group) / (longest * len(group)) <= waste + 1e-9
    longest_first = [max(lengths[i] for i in group) for group in groups]
    assert longest_first == sorted(longest_first)


def test_grouping_extremes() -> None:
    lengths = torch.tensor([5, 2, 5, 9])

    assert [group.tolist() for group in by_length(lengths, 0.0)] == [[1], [0, 2], [3]]
    assert [group.tolist() for group in by_length(lengths, 1.0)] == [[1, 0, 2, 3]]


def test_gradients_reach_every_row_and_nothing_else() -> None:
    packing = Packing(torch.tensor([3, 1, 2]))
    rows = torch.randn(6, 4, requires_grad=True)

    packing.unpad(packing.pad(rows)).sum().backward()

    assert torch.equal(rows.grad, torch.ones(6, 4))
