"""Learned termination: a skill lasts until another code is said, at most H steps, in each environment for itself."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from test_rollout_is_training import random_observations, roll_out
from tiny_networks import CLASSES, WIDTH, Batch, batch, codebook, lisa, run
from torch import Tensor

from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.quantizers import Quantized
from lerobot_lisa.networks.skill_plan import Phase, SkillPlan
from lerobot_lisa.networks.termination import Termination

HORIZON, EVERY = 6, 2
LISA = lisa(HORIZON, every=EVERY, quantizer=codebook(size=2, code_width=None))


def said(codes: list[int], embeddings: Tensor | None = None) -> Quantized:
    """Answers to questions."""
    numbers = torch.tensor(codes)
    return Quantized(
        numbers[:, None, None].float() if embeddings is None else embeddings, numbers, torch.zeros(()), None
    )


def lengths_by_hand(codes: list[list[int]], steps: list[int], horizon: int, every: int) -> list[int]:
    """How long skills last, told step by step as a rollout does."""
    lengths = []
    for answers, length in zip(codes, steps, strict=True):
        for step in range(length):
            asked = step % every == 0
            if asked and (step == 0 or lengths[-1] >= horizon or answers[step // every] != answers[step // every - 1]):
                lengths.append(0)
            lengths[-1] += 1
    return lengths


@given(
    steps=st.lists(st.integers(1, 40), min_size=1, max_size=4),
    every=st.integers(1, 3),
    most=st.integers(1, 4),
    seed=st.integers(0, 99),
)
def test_chunks_are_those_of_a_rollout(steps: list[int], every: int, most: int, seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    codes = [torch.randint(0, 2, (-(-length // every),), generator=random).tolist() for length in steps]
    termination = Termination(most * every, every)

    lasting = termination(said([code for answers in codes for code in answers]), Packing(torch.tensor(steps)))

    expected = lengths_by_hand(codes, steps, most * every, every) if most > 1 else None
    lengths = lasting.chunks.lengths
    assert expected is None or lengths.tolist() == expected
    assert int(lengths.sum()) == sum(steps)
    assert int(lengths.max()) <= most * every
    assert len(lasting.questions) == sum(steps)
    assert torch.equal(lasting.skills.sequence[lasting.questions], lasting.chunks.sequence)


def test_skills_end_early_and_late_and_in_each_environment_for_itself() -> None:
    """What the other tests of rollouts need to say anything: all of this happens in the small network."""
    _, _, codes = roll_out(LISA, random_observations(8, 60), batch([1] * 8))
    ended = (codes[:, 1:] != codes[:, :-1]).nonzero()

    assert (ended[:, 1] % EVERY == EVERY - 1).all()
    assert ((ended[:, 1] + 1) % HORIZON != 0).any()
    assert any(0 < (codes[:, step] != codes[:, step + 1]).sum() < 8 for step in range(59))
    held = [run.shape[0] for row in codes for run in row.tensor_split((row[1:] != row[:-1]).nonzero()[:, 0] + 1)]
    assert max(held) > HORIZON  # the same code twice: the policy begins anew, the code stays


@torch.no_grad()
def acted(words: Batch, seen: dict[str, Tensor], actions: Tensor) -> tuple[Tensor, Tensor]:
    """Predictions and codes (B, T, ...) of a rollout in which given actions (B, T, 1) are taken."""
    history = LISA.begin(words.tokens, words.valid)
    outputs, codes = [], []
    for step in range(actions.shape[1]):
        outputs.append(LISA.act(history, {key: value[:, step] for key, value in seen.items()}))
        history.actions = actions[:, step]
        codes.append(history.codes)
    return torch.stack(outputs, 1), torch.stack(codes, 1)


@pytest.mark.parametrize("seed", range(3))
def test_environments_do_not_depend_on_one_another(seed: int) -> None:
    words, seen = batch([1] * 5, seed=seed), random_observations(5, 40, seed)
    actions = torch.randint(0, CLASSES, (5, 40, 1), generator=torch.Generator().manual_seed(seed))
    together, codes = acted(words, seen, actions)

    for one in range(5):
        own = slice(one, one + 1)
        alone, own_codes = acted(words.part(one), {key: value[own] for key, value in seen.items()}, actions[own])
        assert torch.equal(own_codes[0], codes[one])
        torch.testing.assert_close(alone[0], together[one], atol=1e-5, rtol=1e-5)


def test_the_policy_remembers_its_chunk_alone() -> None:
    """However long the rollout is, and wherever others are in theirs."""
    words, seen = batch([1] * 6), random_observations(6, 300)
    history, sizes = LISA.begin(words.tokens, words.valid), []
    for step in range(300):
        LISA.act(history, {key: value[:, step] for key, value in seen.items()})
        history.actions = torch.zeros(6, 1)
        sizes.append((history.policy.length, int(history.policy.valid.sum(1).max())))

    assert max(valid for _, valid in sizes) <= 2 * HORIZON
    assert max(length for length, _ in sizes) <= 2 * 3 * HORIZON
    assert max(length for length, _ in sizes[:100]) == max(length for length, _ in sizes)


def test_plans_are_followed_and_the_predictor_takes_over_where_they_end() -> None:
    words, seen = batch([1] * 4), random_observations(4, 40)
    history = LISA.begin(words.tokens, words.valid)
    history.plan = SkillPlan((Phase(1, 9), Phase(0, 3), Phase(None, 5), Phase(1, 1)))
    codes, since = [], []
    for step in range(40):
        since.append(None if history.since is None else history.since.clone())
        LISA.act(history, {key: value[:, step] for key, value in seen.items()})
        history.actions = torch.zeros(4, 1)
        codes.append(history.codes)

    assert torch.stack(codes[:9]).eq(1).all()
    assert torch.stack(codes[9:12]).eq(0).all()
    assert codes[17].eq(1).all()
    assert all(after.max() <= HORIZON for after in since[1:])
    assert [int(after[0]) for after in since[1:13]] == [1, 2, 3, 4, 5, 6, 1, 2, 3, 1, 2, 3]


def test_every_answer_that_lets_a_skill_go_on_learns() -> None:
    network = lisa(HORIZON, every=EVERY, quantizer=codebook(size=2, code_width=None), asking=False).train()
    what = batch([23, 14])
    answers = []
    handle = network.source.register_forward_hook(lambda _module, _inputs, out: answers.append(out))
    outputs, *_ = network(what.tokens, what.valid, what.observations, what.actions, what.packing)
    handle.remove()
    answers[0].retain_grad()
    outputs.square().sum().backward()

    assert len(answers[0]) == 12 + 7
    assert (answers[0].grad.flatten(1).abs().sum(1) > 0).all()


def test_haste_is_charged_for_and_its_gradient_draws_answers_together() -> None:
    termination = Termination(HORIZON, EVERY, steps=8, weight=3)
    frames = Packing(torch.tensor([8, 8]))  # 16 steps: two changes are free
    embeddings = torch.tensor([0.0, 0, 2, 0, 2, 2, 0, 2])[:, None, None].requires_grad_()
    hasty, calm = [0, 0, 1, 0, 1, 1, 0, 1], [0, 0, 1, 1, 0, 0, 1, 1]

    lasting = termination(said(hasty, embeddings), frames)
    lasting.loss.backward()

    assert lasting.loss.item() == pytest.approx(3 * (4 * 8 / 16 - 1))
    assert embeddings.grad[2] > 0 > embeddings.grad[6]  # those that stand alone
    assert termination(said(calm), frames).loss == 0
    assert Termination(HORIZON, EVERY, steps=4)(said(hasty), frames).loss == 0
    assert Termination(EVERY, EVERY, steps=4, weight=3)(said(hasty), frames).loss == 0  # asked when they end anyway


@given(seed=st.integers(0, 99), scale=st.floats(0.01, 100))
def test_no_part_shrinks_to_pay_less(seed: int, scale: float) -> None:
    """Not even one that is far smaller than the others: it would change at every question, and gradients would grow."""
    termination = Termination(HORIZON, EVERY, steps=8, weight=1)
    values = torch.randn(8, 2, 3, generator=torch.Generator().manual_seed(seed)) * torch.tensor([[1], [scale]])
    values.requires_grad_()

    termination(said(list(range(8)), values), Packing(torch.tensor([8, 8]))).loss.backward()

    outward = (values.grad * (values - values.mean(0))).sum((0, 2)).detach()
    torch.testing.assert_close(outward, torch.zeros(2), atol=1e-5, rtol=0)
    assert (values.grad.flatten(2).norm(dim=(0, 2)) > 0).all()


def test_before_there_are_codes_skills_last_the_horizon_but_all_lengths_are_trained() -> None:
    network = lisa(HORIZON, every=EVERY, quantizer=codebook(code_width=None, warmup_steps=1000))
    what = batch([60] * 8)
    arguments = (what.tokens, what.valid, what.observations, what.actions, what.packing)

    def lengths(of: Lisa) -> list[int]:
        return of(*arguments)[2].chunks.lengths.tolist()

    assert set(lengths(network)) == {HORIZON}
    network.train()
    torch.manual_seed(0)
    drawn = lengths(network)
    assert set(drawn) == {2, 4, 6}
    assert drawn != lengths(network)
    torch.manual_seed(0)
    assert drawn == lengths(network)


def test_the_future_ends_no_skill() -> None:
    what = batch([40], seed=4)
    _, codes = run(LISA, what)
    for step in (0, 7, 20, 39):
        changed = what.observations["state"].clone()
        changed[step + 1 :] += 10
        what_if = type(what)(
            what.tokens, what.valid, {**what.observations, "state": changed}, what.actions, what.packing
        )
        _, other_codes = run(LISA, what_if)
        assert torch.equal(codes[: step // EVERY + 1], other_codes[: step // EVERY + 1])
    assert LISA.quantizer.embed(codes).shape == (20, 1, WIDTH)
