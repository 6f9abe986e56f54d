"""Processes that train together keep one codebook: statistics are reduced over ranks."""

from itertools import pairwise

import pytest
import torch
from codebook_ranks import RANKS, STEPS, batch, run
from tiny_networks import codebook

from lerobot_lisa.networks.codebooks import Codebook

State = dict[str, torch.Tensor]
CODES = "quantizers.0._codebook.embed"


@pytest.fixture(scope="module")
def started() -> Codebook:
    """A codebook whose codes k-means has placed."""
    torch.manual_seed(0)
    alone = codebook(dead_code_threshold=0).train()
    alone(batch(STEPS, 0)[:, None])
    return alone


@pytest.fixture(scope="module")
def together(started: Codebook, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, list[State]]]:
    """What two processes have kept of their steps: one item for each of them."""
    folder = tmp_path_factory.mktemp("ranks")
    torch.multiprocessing.spawn(run, (folder, started.state_dict()), nprocs=RANKS)
    return [torch.load(folder / f"{rank}.pt") for rank in range(RANKS)]


@pytest.mark.parametrize("kind", ["continued", "fresh"])
def test_both_have_the_same_codes(kind: str, together: list[dict[str, list[State]]]) -> None:
    """To the bit, with k-means and revived codes too, although the processes draw different random numbers."""
    first, second = (rank[kind] for rank in together)
    for step, (one, other) in enumerate(zip(first, second, strict=True)):
        assert all(torch.equal(one[key], other[key]) for key in one), step
    moved = max((later[CODES] - now[CODES]).abs().max() for now, later in pairwise(first))
    assert moved > 0.5 if kind == "fresh" else 0 < moved < 0.5  # a code was put elsewhere, or none


def test_they_are_one_process_with_the_joint_batch(started: Codebook, together: list[dict[str, list[State]]]) -> None:
    for step, state in enumerate(together[0]["continued"]):
        started(torch.cat([batch(step, rank) for rank in range(RANKS)])[:, None])
        for key, value in started.state_dict().items():
            torch.testing.assert_close(state[key], value, atol=1e-5, rtol=1e-5)
