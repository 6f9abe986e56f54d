"""Rollouts of small policies, and the same frames through the forward pass that trains."""

from typing import Any

import torch
from lerobot.configs import NormalizationMode
from lerobot.utils.constants import ACTION
from tiny_policies import Training
from torch import Tensor

from lerobot_lisa.networks.packing import Packing

HORIZON = 3
NORMALISED = {
    "STATE": NormalizationMode.MEAN_STD,
    "ACTION": NormalizationMode.MEAN_STD,
    "VISUAL": NormalizationMode.MEAN_STD,
    "ENV": NormalizationMode.IDENTITY,
}
TASKS = ["go", "pick up the grey key, then put it next to the blue box", "open a door", "go to the red ball"]


def live_observations(made: Training, environments: int, steps: int) -> dict[str, Tensor]:
    """What LeRobot hands a policy in a rollout, (B, T, *shape): float32, pictures in 0..1."""
    random = torch.Generator().manual_seed(5)
    batches = {}
    for key, feature in made.policy.config.input_features.items():
        shape = (environments, steps, *feature.shape)
        if made.dataset.meta.features[key]["dtype"] == "uint8":
            batches[key] = torch.randint(0, 11, shape, generator=random).float()
        elif feature.type.value == "VISUAL":
            batches[key] = torch.randint(0, 256, shape, generator=random).float() / 255
        else:
            batches[key] = 5 + 3 * torch.randn(shape, generator=random)
    return batches


def step_batch(made: Training, observations: dict[str, Tensor], step: int, tasks: list[str]) -> dict[str, Any]:
    now = {key: value[:, step] for key, value in observations.items()}
    return made.preprocessor({**now, "task": tasks})


@torch.no_grad()
def assert_rollout_is_training(made: Training, steps: int) -> None:
    """Act, then predict the same frames and actions as whole episodes."""
    policy, observations = made.policy, live_observations(made, len(TASKS), steps)
    policy.reset()
    outputs, actions, codes = [], [], []
    for step in range(steps):
        batch = step_batch(made, observations, step, TASKS)
        outputs.append(policy.action_outputs(batch))
        actions.append(policy._history.actions)
        codes.append(getattr(policy, "skill_codes", None))
    frames = made.policy.scaled(
        {
            **{key: value.flatten(0, 1) for key, value in observations.items()},
            ACTION: torch.zeros(steps * len(TASKS), policy.config.action_feature.shape[0]),
        }
    )
    frames.pop(ACTION)
    tokens, valid = batch["observation.language.tokens"], batch["observation.language.attention_mask"]
    packing = Packing(torch.full((len(TASKS),), steps))
    expected, _, _ = policy.predict(tokens, valid, frames, torch.stack(actions, 1).flatten(0, 1), packing)

    torch.testing.assert_close(torch.stack(outputs, 1).flatten(0, 1), expected, atol=1e-5, rtol=1e-5)
    if codes[0] is not None:
        _, skills, _ = policy.network(tokens, valid, frames, torch.stack(actions, 1).flatten(0, 1), packing)
        assert torch.equal(torch.stack(codes[:: policy.config.question_stride], 1).flatten(), skills.codes)


def actions_of(made: Training, observations: dict[str, Tensor], steps: range, tasks: list[str]) -> list[Tensor]:
    return [made.policy.action_outputs(step_batch(made, observations, step, tasks)) for step in steps]


def assert_rollouts_change_nothing(made: Training) -> None:
    """No weight and no buffer; and the policy is in evaluation mode afterwards."""
    made.policy.train()
    before = {key: value.clone() for key, value in made.policy.state_dict().items()}

    actions_of(made, live_observations(made, 4, 10), range(10), TASKS)

    assert not made.policy.training
    assert all(torch.equal(before[key], value) for key, value in made.policy.state_dict().items())
