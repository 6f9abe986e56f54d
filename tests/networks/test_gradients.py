"""Every step of a chunk, full or partial, teaches the skill predictor; every parameter learns."""

import pytest
import torch
from tiny_networks import Batch, babyai_rnn, batch, codebook, lang_bc, lang_dt, lisa
from torch import Tensor

from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.lisa import Lisa

HORIZON = 4
LENGTHS = [HORIZON + 2, 1, 2 * HORIZON]  # chunks of 4 and 2; 1; 4 and 4


def choosing(**settings: bool) -> Lisa:
    """LISA in training, with a part that it makes up: what an instruction names may leave no choice."""
    return lisa(HORIZON, quantizer=codebook(size=3, code_width=None, parts=2), own=1, **settings).train()


def losses_and_embeddings(network: Lisa, what: Batch) -> tuple[Tensor, Tensor]:
    """Loss (N,) of every frame, and what the skill predictor said (C, D)."""
    said: list[Tensor] = []
    handle = network.predictor.register_forward_hook(lambda module, args, out: said.append(out))
    outputs, *_ = network(what.tokens, what.valid, what.observations, what.actions, what.packing)
    handle.remove()
    return network.head.loss(outputs, what.actions), said[0]


@pytest.mark.parametrize("categorical", [True, False])
def test_every_step_reaches_its_own_chunk_and_no_other(categorical: bool) -> None:
    network, what = choosing(categorical=categorical), batch(LENGTHS, categorical)
    loss, embeddings = losses_and_embeddings(network, what)
    chunk_of_step = what.packing.split(HORIZON).sequence

    for step in range(what.packing.total):
        (gradient,) = torch.autograd.grad(loss[step], embeddings, retain_graph=True)
        reached = (gradient.abs().sum(1) > 1e-9).nonzero()[:, 0].tolist()
        assert reached == [int(chunk_of_step[step])], step


def test_gradients_flow_on_to_language_and_early_observations() -> None:
    """Loss on the last chunk alone moves the words and the observations of the first chunk."""
    network, what = choosing(), batch([3 * HORIZON])
    states = what.observations["state"].requires_grad_()
    loss, _ = losses_and_embeddings(network, what)

    loss[-HORIZON:].sum().backward()

    assert (states.grad[: 2 * HORIZON].abs().sum(1) > 0).all()
    words = network.language.encoder.embedding.weight.grad[what.tokens.unique()]
    assert (words.abs().sum(1) > 0).all()


@pytest.mark.parametrize("make", [lisa, lang_dt, babyai_rnn, lang_bc])
@pytest.mark.parametrize("categorical", [True, False])
def test_every_parameter_learns(make: type[EpisodeNetwork], categorical: bool) -> None:
    network, what = make(categorical=categorical).train(), batch([9] * 6, categorical)
    out = network(what.tokens, what.valid, what.observations, what.actions, what.packing)
    outputs, extra = (out[0], out[1].commitment) if isinstance(network, Lisa) else (out, 0)

    (network.head.loss(outputs, what.actions).mean() + extra).backward()

    idle = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any() or p.grad.isnan().any()]
    assert idle == []
