"""A rollout replayed through the training forward pass gives the same codes and the same predictions at every step."""

from dataclasses import replace
from random import Random

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_networks import WIDTH, Batch, babyai_rnn, batch, codebook, lang_bc, lang_dt, lisa, run
from torch import Tensor

from lerobot_lisa.networks.actions import CategoricalHead
from lerobot_lisa.networks.codebooks import CodebookSettings, ResidualCodebook
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.excerpts import cut
from lerobot_lisa.networks.lang_dt import LangDT
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.quantizers import FiniteScalars
from lerobot_lisa.networks.transformer import Memory

HORIZON = 3
NETWORKS = {
    "lisa": lisa(HORIZON),
    "lisa_shared_encoder": lisa(HORIZON, shared=True),
    "lisa_as_in_the_paper": lisa(HORIZON, asking=False, copying=False),
    "lisa_copying_only": lisa(HORIZON, asking=False),
    "lisa_asking_only": lisa(HORIZON, copying=False),
    "lisa_two_parts": lisa(HORIZON, quantizer=codebook(size=3, code_width=None, parts=2)),
    "lisa_made_up_part": lisa(HORIZON, quantizer=codebook(size=3, code_width=None, parts=2), own=1),
    "lisa_residual": lisa(HORIZON, quantizer=ResidualCodebook(WIDTH, [3, 3], CodebookSettings(0.99, 0.25, 1.0))),
    "lisa_finite_scalars": lisa(HORIZON, quantizer=FiniteScalars(WIDTH, [3, 3])),
    "lisa_continuous": lisa(HORIZON, categorical=False),
    "lisa_windowed": lisa(HORIZON, window=5),
    "lisa_deep": lisa(HORIZON, window=5, layers=2),
    "lisa_looking_every_horizon": lisa(HORIZON, stride=HORIZON),
    "lisa_looking_every_horizon_windowed": lisa(HORIZON, stride=HORIZON, window=3 * HORIZON, layers=2, shared=True),
    "lisa_looking_twice_a_horizon": lisa(4, stride=2, window=7),
    "lisa_mlp": lisa(HORIZON, stride=HORIZON, mlp=True),
    "lisa_mlp_shown_every_step": lisa(HORIZON, mlp=True, own=1, quantizer=codebook(size=3, code_width=None, parts=2)),
    "lisa_ending": lisa(6, every=1),
    "lisa_ending_every_two": lisa(6, every=2, stride=2, shared=True, window=7, layers=2),
    "lisa_ending_two_parts": lisa(4, every=2, quantizer=codebook(size=2, code_width=None, parts=2), own=1),
    "lisa_ending_residual": lisa(
        6, every=3, quantizer=ResidualCodebook(WIDTH, [2, 2], CodebookSettings(0.99, 0.25, 1.0))
    ),
    "lisa_ending_mlp": lisa(6, every=2, stride=2, mlp=True, categorical=False),
    "lisa_ending_without_codes": lisa(6, every=2, quantizer=codebook(code_width=None, warmup_steps=1000)),
    "lisa_horizon_1": lisa(1),
    "lisa_horizon_1_windowed": lisa(1, window=2),
    "lang_dt": lang_dt(),
    "lang_dt_as_in_the_paper": lang_dt(asking=False),
    "lang_dt_continuous": lang_dt(categorical=False),
    "lang_dt_windowed": lang_dt(window=4),
    "lang_dt_window_of_one": lang_dt(window=1, layers=1),
    "babyai_rnn": babyai_rnn(),
    "babyai_rnn_continuous": babyai_rnn(categorical=False),
    "lang_bc": lang_bc(),
    "lang_bc_continuous": lang_bc(categorical=False),
}
EVERY = pytest.mark.parametrize("name", NETWORKS)


@torch.no_grad()
def roll_out(network: EpisodeNetwork, observations: dict[str, Tensor], words: Batch) -> tuple[Batch, Tensor, Tensor]:
    """Act for T steps in B environments whose observations (B, T, ...) are given.

    Returns:
        What was seen and done as training episodes, predictions (B, T, ...) and the code of every step (B, T).
    """
    history = network.begin(words.tokens, words.valid)
    outputs, codes, actions = [], [], []
    batch_size, steps = observations["state"].shape[:2]
    for step in range(steps):
        outputs.append(network.act(history, {key: value[:, step].float() for key, value in observations.items()}))
        history.actions = network.head.pick(outputs[-1])
        actions.append(history.actions)
        has_codes = isinstance(network, Lisa) and history.codes is not None
        codes.append(history.codes if has_codes else torch.zeros(batch_size))
    replay = batch([steps] * batch_size)
    replay.tokens, replay.valid = words.tokens, words.valid
    replay.observations = {key: value.flatten(0, 1) for key, value in observations.items()}
    replay.actions = torch.stack(actions, 1).flatten(0, 1)
    return replay, torch.stack(outputs, 1), torch.stack(codes, 1)


def random_observations(environments: int, steps: int, seed: int = 0) -> dict[str, Tensor]:
    flat = batch([steps] * environments, seed=seed).observations
    return {key: value.unflatten(0, (environments, steps)) for key, value in flat.items()}


@EVERY
@settings(max_examples=10)
@given(steps=st.integers(1, 8 * HORIZON), environments=st.integers(1, 4), seed=st.integers(0, 3))
def test_same_codes_and_predictions(name: str, steps: int, environments: int, seed: int) -> None:
    network = NETWORKS[name]
    words = batch([1] * environments, seed=seed)

    replay, outputs, codes = roll_out(network, random_observations(environments, steps, seed), words)
    expected, expected_codes = run(network, replay)

    torch.testing.assert_close(outputs.flatten(0, 1), expected, atol=1e-5, rtol=1e-5)
    if isinstance(network, Lisa) and expected_codes is not None:
        assert torch.equal(codes[:, :: network.termination.every].flatten(), expected_codes)


@EVERY
def test_long_rollouts_outlast_memory_and_timesteps(name: str) -> None:
    """150 steps: buffers have grown, windowed memories have forgotten many times, timesteps have run out."""
    network = NETWORKS[name]

    replay, outputs, _ = roll_out(network, random_observations(2, 150), batch([1, 1]))

    torch.testing.assert_close(outputs.flatten(0, 1), run(network, replay)[0], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("name", "window"), [("lisa_windowed", 5), ("lang_dt_windowed", 2 * 4)])
def test_memory_and_time_per_step_are_bounded(name: str, window: int) -> None:
    network, words = NETWORKS[name], batch([1, 1])
    prefix = words.tokens.shape[1]
    history = network.begin(words.tokens, words.valid)
    memory: Memory = history.policy if isinstance(network, LangDT) else history.predictor
    sizes, observations = [], random_observations(2, 200)
    for step in range(200):
        network.act(history, {key: value[:, step] for key, value in observations.items()})
        history.actions = torch.zeros(2, 1)
        sizes.append((memory.length, max(buffer.shape[3] for buffer in memory._keys_values)))

    most = max(length for length, _ in sizes)
    assert most <= 2 * (window + prefix) + HORIZON
    assert most == max(length for length, _ in sizes[:60])  # it has stopped growing
    assert all(capacity <= 64 for _, capacity in sizes)
    if isinstance(network, Lisa):
        assert history.policy.length <= 2 * HORIZON
        assert len(history.unseen) < HORIZON


EXCERPTS = [name for name in NETWORKS if ("window" in name or "deep" in name or "mlp" in name) and "ending" not in name]


@pytest.mark.parametrize("name", EXCERPTS)
@settings(max_examples=15)
@given(lengths=st.lists(st.integers(1, 60), min_size=1, max_size=4), parts=st.integers(1, 4), seed=st.integers(0, 99))
def test_excerpts_are_predicted_as_in_a_rollout(name: str, lengths: list[int], parts: int, seed: int) -> None:
    """What is cut off before an excerpt and its context matters to nothing, so a step may cost the same at any length.

    Whole episodes are what `test_same_codes_and_predictions` compares with rollouts.
    """
    network = NETWORKS[name]
    horizon = network.horizon if isinstance(network, Lisa) else 1
    what, drawn = batch(lengths, network_is_categorical(network), seed=seed), Random(seed)
    steps = torch.tensor([drawn.randrange(length) for length in lengths])
    outputs, codes = run(network, what)

    excerpts = cut(what.packing.lengths, steps, parts * horizon, network.reach, stride_of(network))
    rows = (what.packing.lengths.cumsum(0) - what.packing.lengths)[excerpts.sequence] + excerpts.steps
    cut_out = replace(
        what,
        observations={key: value[rows] for key, value in what.observations.items()},
        actions=what.actions[rows],
        packing=excerpts,
    )
    some, some_codes = run(network, cut_out)

    assert all(steps[i] in excerpts.steps[excerpts.sequence == i] for i in range(len(lengths)))
    torch.testing.assert_close(some, outputs[rows[excerpts.learned_rows]], atol=1e-5, rtol=1e-5)
    if codes is not None:
        chunks = what.packing.split(horizon).sequence[rows[excerpts.learned_rows]]
        assert torch.equal(some_codes, codes[chunks.unique_consecutive()])


@pytest.mark.parametrize("name", EXCERPTS)
def test_excerpts_do_not_grow_with_their_episodes(name: str) -> None:
    network = NETWORKS[name]
    rows = [
        cut(torch.tensor([length]), torch.tensor([length - 1]), 12, network.reach, stride_of(network)).total
        for length in (3000, 30_000)
    ]

    assert rows[0] == rows[1] <= 12 + network.reach


def stride_of(network: EpisodeNetwork) -> int:
    return network.predictor.stride if isinstance(network, Lisa) else 1


def network_is_categorical(network: EpisodeNetwork) -> bool:
    return isinstance(network.head, CategoricalHead)


def test_codes_last_a_horizon() -> None:
    _, _, codes = roll_out(NETWORKS["lisa_as_in_the_paper"], random_observations(8, 12 * HORIZON), batch([1] * 8))

    chunks = codes.unflatten(1, (-1, HORIZON))
    assert (chunks == chunks[..., :1]).all()
    assert (chunks[:, 1:, 0] != chunks[:, :-1, 0]).any()  # the data would show a code that outlives its chunk
