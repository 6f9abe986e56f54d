"""Plans of skill codes: what they say, and that a rollout does it exactly as the policy was trained to."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from test_rollout_is_training import random_observations
from tiny_networks import CODES, Batch, batch, lisa
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.skill_plan import Phase, SkillPlan, read_plan

HORIZON = 3
NETWORK = lisa(HORIZON)
CODE = st.none() | st.integers(0, CODES - 1)
PLANS = st.builds(
    lambda phases, last: SkillPlan((*phases, *last)),
    st.lists(st.builds(Phase, CODE, st.integers(1, 2 * HORIZON + 1)), max_size=4),
    st.lists(st.builds(Phase, CODE, st.none()), max_size=1),
)


def find_code(text: str) -> int:
    """Four codes, two of which have names."""
    names = {"red ball": 3, "go to / red ball": 2, **{str(code): code for code in range(4)}}
    if text not in names:
        raise UserError(f"there is no code {text[:10]}")
    return names[text]


@pytest.mark.parametrize(
    ("text", "plan"),
    [
        ("3", SkillPlan((Phase(3, None),))),
        ("3*20,2*20", SkillPlan((Phase(3, 20), Phase(2, 20)))),
        (" ?*10, 0*1 ,?", SkillPlan((Phase(None, 10), Phase(0, 1), Phase(None, None)))),
        ("red ball*20, ?", SkillPlan((Phase(3, 20), Phase(None, None)))),
        ("go to / red ball * 5", SkillPlan((Phase(2, 5),))),
    ],
)
def test_plans_are_read(text: str, plan: SkillPlan) -> None:
    assert read_plan(text, find_code) == plan


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "'' is no part"),
        ("4", "there is no code 4"),
        ("1*0", "'1*0' is no part"),
        ("1*5,", "'' is no part"),
        ("1x5", "there is no code 1x5"),
        ("-1", "there is no code -1"),
        ("9" * 5000, "there is no code 999"),
        ("1*" + "9" * 5000, "is no part"),
        ("1*2*3", "'1*2*3' is no part"),
        ("1,2*3", "nothing can follow '1'"),
    ],
)
def test_nonsense_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(UserError) as error:
        read_plan(text, find_code)

    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


@given(PLANS)
def test_every_step_has_its_code(plan: SkillPlan) -> None:
    """Against the plan written out step by step."""
    written = [(phase.code, step) for phase in plan.phases for step in range(phase.steps or 100)]
    rest = [(None, step) for step in range(100)]

    assert [plan.at(step) for step in range(60)] == [*written, *rest][:60]


@torch.no_grad()
def roll_out(network: Lisa, plan: SkillPlan, words: Batch, observations: dict[str, Tensor]) -> list[Tensor]:
    """Predictions (B, T, ...), actions, codes and the predictor's codes (B, T) of a rollout under a plan."""
    history = network.begin(words.tokens, words.valid)
    history.plan = plan
    torch.manual_seed(0)  # actions are drawn
    steps = []
    for step in range(observations["state"].shape[1]):
        outputs = network.act(history, {key: value[:, step].float() for key, value in observations.items()})
        history.actions = network.head.pick(outputs)
        steps.append((outputs, history.actions, history.codes, history.predicted))
    return [torch.stack(column, 1) for column in zip(*steps, strict=True)]


@settings(max_examples=20)
@given(plan=PLANS, steps=st.integers(1, 20))
@torch.no_grad()
def test_a_plan_is_what_the_policy_was_trained_for(plan: SkillPlan, steps: int) -> None:
    """Each chunk of a planned rollout gives the predictions of the training forward pass on it and its code."""
    words, observations = batch([1, 1]), random_observations(2, steps)

    outputs, actions, codes, predicted = roll_out(NETWORK, plan, words, observations)

    begins = [step for step in range(steps) if plan.at(step)[1] % HORIZON == 0]
    lengths = torch.tensor([*begins[1:], steps]) - torch.tensor(begins)
    frames = {key: value.flatten(0, 1) for key, value in observations.items()}
    skills = NETWORK.quantizer.embed(codes[:, begins].flatten())
    prefix = NETWORK.skill_embedding(skills)
    chunks = Packing(lengths.repeat(2))
    looked, predictor_looked = NETWORK._look(frames, None, None)
    seen, _ = NETWORK._ask_skill(looked, skills, prefix, chunks.sequence)
    expected = NETWORK.action_predictor(prefix, None, seen, actions.flatten(0, 1), chunks)
    torch.testing.assert_close(outputs.flatten(0, 1), expected, atol=1e-5, rtol=1e-5)

    instruction, episodes = NETWORK.language(words.tokens, words.valid), Packing(torch.tensor([steps] * 2))
    heard = NETWORK._ask_words(predictor_looked, instruction.naming(), episodes.sequence)
    answers = NETWORK.predictor(instruction.tokens, words.valid, heard, episodes, 1)
    chosen = NETWORK.quantizer(NETWORK.source(answers, instruction.take(episodes.sequence))).codes
    assert torch.equal(predicted[:, begins], chosen.unflatten(0, (2, steps))[:, begins])
    planned = torch.tensor([-1 if plan.at(step)[0] is None else plan.at(step)[0] for step in range(steps)])
    assert torch.equal(codes, torch.where(planned < 0, predicted, planned))


def test_codes_of_the_predictor_by_hand_change_nothing() -> None:
    words, observations = batch([1]), random_observations(1, 4 * HORIZON)
    own = roll_out(NETWORK, SkillPlan(), words, observations)

    chosen = own[2][0, ::HORIZON].tolist()
    by_hand = roll_out(NETWORK, SkillPlan(tuple(Phase(code, HORIZON) for code in chosen)), words, observations)

    assert all(torch.equal(a, b) for a, b in zip(own, by_hand, strict=True))
