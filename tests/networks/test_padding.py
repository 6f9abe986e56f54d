"""An episode's codes and logits are its own: neither the rest of the batch nor padding changes them."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from tiny_networks import babyai_rnn, batch, lang_bc, lang_dt, lisa, run

from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.packing import Packing

HORIZON = 3
NETWORKS = pytest.mark.parametrize(
    "network",
    [lisa(HORIZON), lisa(HORIZON, mlp=True), lang_dt(), lang_dt(waste=1.0), babyai_rnn(), lang_bc()],
    ids=["lisa", "lisa_mlp", "lang_dt", "lang_dt_one_group", "babyai_rnn", "lang_bc"],
)
NEAR_HORIZON = st.sampled_from([1, HORIZON - 1, HORIZON, HORIZON + 1, 2 * HORIZON, 3 * HORIZON + 1])


@NETWORKS
@given(lengths=st.lists(NEAR_HORIZON, min_size=1, max_size=5), seed=st.integers(0, 5))
def test_alone_or_in_a_batch(network: EpisodeNetwork, lengths: list[int], seed: int) -> None:
    what = batch(lengths, seed=seed)
    logits, codes = run(network, what)
    chunks = what.packing.count_chunks(HORIZON)

    for episode in range(len(lengths)):
        alone_logits, alone_codes = run(network, what.part(episode))
        torch.testing.assert_close(logits[what.packing.rows(torch.tensor([episode]))], alone_logits)
        if codes is not None:
            assert torch.equal(codes[chunks.rows(torch.tensor([episode]))], alone_codes)


@NETWORKS
def test_more_padding_of_the_instruction(network: EpisodeNetwork) -> None:
    what = batch([4, 7, 1])
    wider = replace(what, tokens=F.pad(what.tokens, (0, 5), value=3), valid=F.pad(what.valid, (0, 5)))

    for one, other in zip(run(network, what), run(network, wider), strict=True):
        if one is not None:
            torch.testing.assert_close(one, other)


@NETWORKS
def test_order_of_the_batch(network: EpisodeNetwork) -> None:
    what = batch([4, 7, 1, 7])
    order = torch.tensor([2, 0, 3, 1])
    rows = what.packing.rows(order)
    shuffled = replace(
        what,
        tokens=what.tokens[order],
        valid=what.valid[order],
        observations={key: value[rows] for key, value in what.observations.items()},
        actions=what.actions[rows],
        packing=Packing(what.packing.lengths[order]),
    )

    torch.testing.assert_close(run(network, what)[0][rows], run(network, shuffled)[0])


def test_the_codebook_never_sees_padding() -> None:
    """Statistics and moving averages count chunks of real steps, each once."""
    network = lisa(HORIZON)
    what = batch([1, HORIZON, 3 * HORIZON + 1])
    _, skills, _ = network(what.tokens, what.valid, what.observations, what.actions, what.packing)

    assert len(skills.codes) == len(skills.distances) == 1 + 1 + 4
