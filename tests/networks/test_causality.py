"""What cannot be known must change nothing: later observations, later actions, other chunks, the instruction itself."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tiny_networks import CLASSES, WORDS, Batch, babyai_rnn, batch, lang_bc, lang_dt, lisa, run
from torch import Tensor

from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.lisa import Lisa

HORIZON = 3
LISA, LANG_DT, BABYAI_RNN, LANG_BC = lisa(HORIZON), lang_dt(), babyai_rnn(), lang_bc()
MLP = lisa(HORIZON, mlp=True)
LENGTH = st.integers(1, 4 * HORIZON + 1)


def with_other_future(what: Batch, observations_from: int, actions_from: int) -> Batch:
    """One episode, everything from those steps on replaced."""
    changed = {key: value.clone() for key, value in what.observations.items()}
    changed["grid"][observations_from:] = 7 - changed["grid"][observations_from:]
    changed["state"][observations_from:] += 10
    actions = what.actions.clone()
    actions[actions_from:] = (actions[actions_from:] + 1) % CLASSES
    return replace(what, observations=changed, actions=actions)


EVERY = pytest.mark.parametrize(
    "network", [LISA, LANG_DT, BABYAI_RNN, LANG_BC], ids=["lisa", "lang_dt", "babyai_rnn", "lang_bc"]
)


@EVERY
@given(length=LENGTH, data=st.data())
def test_the_future_changes_no_earlier_logit(network: EpisodeNetwork, length: int, data: st.DataObject) -> None:
    """An action may depend on the observation of its own step, but only on actions before it."""
    step = data.draw(st.integers(0, length - 1))
    what = batch([length], seed=length)
    future = with_other_future(what, observations_from=step + 1, actions_from=step)

    logits, codes = run(network, what)
    future_logits, future_codes = run(network, future)

    assert torch.equal(logits[: step + 1], future_logits[: step + 1])
    if codes is not None and future_codes is not None:
        chunks = step // HORIZON + 1
        assert torch.equal(codes[:chunks], future_codes[:chunks])


@pytest.mark.parametrize("network", [LISA, LANG_DT], ids=["lisa", "lang_dt"])
def test_the_present_and_the_past_do_matter(network: EpisodeNetwork) -> None:
    what = batch([HORIZON])
    logits, _ = run(network, what)

    now, _ = run(network, with_other_future(what, observations_from=2, actions_from=2))
    before, _ = run(network, with_other_future(what, observations_from=3, actions_from=1))

    assert not torch.allclose(logits[2], now[2])
    assert not torch.allclose(logits[2], before[2])
    assert torch.equal(logits[1], before[1])


@pytest.mark.parametrize("network", [BABYAI_RNN, LANG_BC], ids=["babyai_rnn", "lang_bc"])
def test_what_the_original_baselines_remember(network: EpisodeNetwork) -> None:
    """BabyAI's network remembers what was seen, behaviour cloning nothing; neither looks at actions."""
    what = batch([HORIZON])
    logits, _ = run(network, what)

    acted, _ = run(network, with_other_future(what, observations_from=HORIZON, actions_from=0))
    seen = with_other_future(what, observations_from=1, actions_from=HORIZON)
    for key in seen.observations:  # only the step before the last one is another
        seen.observations[key][2] = what.observations[key][2]
    remembered, _ = run(network, seen)

    assert torch.equal(logits, acted)
    assert not torch.allclose(logits[1], remembered[1])
    assert torch.allclose(logits[2], remembered[2]) == (network is LANG_BC)


def embeddings(what: Batch, network: Lisa = LISA) -> Tensor:
    """What LISA's skill predictor says at every chunk, before quantising: finer than codes."""
    instruction, (_, seen) = network.language(what.tokens, what.valid), network._look(what.observations, None, None)
    heard = network._ask_words(seen, instruction.naming(), what.packing.sequence)
    return network.predictor(instruction.tokens, what.valid, heard, what.packing, HORIZON)


@pytest.mark.parametrize("network", [LISA, MLP], ids=["transformer", "mlp"])
def test_the_skill_predictor_sees_none_of_the_future_and_all_of_the_past_or_none(network: Lisa) -> None:
    what = batch([4 * HORIZON])
    base = embeddings(what, network)
    for step in range(4 * HORIZON):
        state = what.observations["state"].clone()
        state[step] += 10
        changed = embeddings(replace(what, observations={**what.observations, "state": state}), network)
        for chunk in range(4):
            seen = step == chunk * HORIZON or (network is LISA and step < chunk * HORIZON)
            assert torch.equal(base[chunk], changed[chunk]) == (not seen), (step, chunk)


def test_the_skill_predictor_does_not_look_at_actions() -> None:
    what = batch([4 * HORIZON])

    _, codes = run(LISA, what)
    _, others = run(LISA, with_other_future(what, observations_from=4 * HORIZON, actions_from=0))

    assert torch.equal(codes, others)


def chunk_logits(codes: Tensor, what: Batch) -> Tensor:
    skills, chunks = LISA.quantizer.embed(codes), what.packing.split(HORIZON)
    prefix = LISA.skill_embedding(skills)
    seen, _ = LISA._ask_skill(LISA._look(what.observations, None, None)[0], skills, prefix, chunks.sequence)
    return LISA.action_predictor(prefix, None, seen, what.actions, chunks)


def test_logits_depend_on_the_code_and_the_chunk_alone() -> None:
    """The language reaches the policy only through the code, and other chunks not at all."""
    what = batch([4 * HORIZON])
    logits, codes = run(LISA, what)

    torch.testing.assert_close(chunk_logits(codes, what), logits)
    for chunk in range(4):
        others = with_other_future(what, 0, 0)
        own = slice(chunk * HORIZON, (chunk + 1) * HORIZON)
        for key in others.observations:
            others.observations[key][own] = what.observations[key][own]
        others.actions[own] = what.actions[own]
        other_codes = (codes + 1) % LISA.quantizer.n_codes
        other_codes[chunk] = codes[chunk]

        mixed = chunk_logits(other_codes, others)

        assert torch.equal(mixed[own], chunk_logits(codes, what)[own])
        assert not torch.allclose(mixed, logits)


def test_the_same_code_gives_the_same_logits_whatever_the_instruction() -> None:
    what = batch([2 * HORIZON])
    told, codes = run(LISA, what)
    seen_same = seen_other = False
    for seed in range(200):  # most of a random network's answers do not depend on the words
        random = torch.Generator().manual_seed(seed)
        tokens = torch.randint(1, WORDS, what.tokens.shape, generator=random)
        logits, other_codes = run(LISA, replace(what, tokens=tokens))
        for chunk in range(2):
            own = slice(chunk * HORIZON, (chunk + 1) * HORIZON)
            same = bool(other_codes[chunk] == codes[chunk])
            assert torch.allclose(logits[own], told[own], atol=1e-6) == same
            seen_same, seen_other = seen_same or same, seen_other or not same
    assert seen_same
    assert seen_other


def captured(transformer: torch.nn.Module, call: Callable[[], object]) -> Tensor:
    """Keys and values (B, L, 2 * D) of the last block during a call."""
    seen: list[Tensor] = []
    handle = transformer.blocks[-1].key_value.register_forward_hook(lambda module, args, out: seen.append(out))
    call()
    handle.remove()
    return seen[0]


@pytest.mark.parametrize("network", [lisa(HORIZON, layers=2), LANG_DT], ids=["lisa", "lang_dt"])
def test_instruction_tokens_see_no_observation(network: EpisodeNetwork) -> None:
    """Otherwise what is remembered of the instruction at a rollout's start would differ from training."""
    what = batch([2 * HORIZON])
    other = with_other_future(what, 0, 0)
    transformer = network.action_predictor.transformer if network is LANG_DT else network.predictor.transformer
    words = what.tokens.shape[1]

    before = captured(transformer, lambda: run(network, what))
    after = captured(transformer, lambda: run(network, other))

    assert torch.equal(before[:, :words], after[:, :words])
    assert not torch.allclose(before[:, words:], after[:, words:])


@pytest.mark.parametrize(
    "network", [LISA, MLP, LANG_DT, BABYAI_RNN, LANG_BC], ids=["lisa", "lisa_mlp", "lang_dt", "babyai_rnn", "lang_bc"]
)
def test_every_word_matters_at_every_step(network: EpisodeNetwork) -> None:
    what = batch([2 * HORIZON], seed=3)
    words = what.tokens.shape[1]
    assert words > 2

    def answer(tokens: Tensor) -> Tensor:
        changed = replace(what, tokens=tokens)
        return embeddings(changed, network) if isinstance(network, Lisa) else run(network, changed)[0]

    for word in range(words):
        tokens = what.tokens.clone()
        tokens[0, word] = tokens[0, word] % (WORDS - 1) + 1
        assert (answer(tokens) - answer(what.tokens)).abs().amax(1).min() > 1e-6
