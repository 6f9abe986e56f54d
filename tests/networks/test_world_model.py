"""The model of the world imagines in a rollout what it learned to, and knows what a state does not show."""

import pytest
import torch
from torch import Tensor

from lerobot_lisa.networks.world_model import WorldModel

STEPS, SIZE, ACTIONS = 7, 3, 2


def model(size: int = SIZE, actions: int = ACTIONS, width: int = 16) -> WorldModel:
    torch.manual_seed(0)
    return WorldModel(size, actions, width, 0.0)


@pytest.mark.parametrize("last_seen", [0, 3, STEPS - 1])
def test_a_rollout_imagines_what_training_does(last_seen: int) -> None:
    world, states, actions = model(), torch.randn(4, STEPS, SIZE), torch.randn(4, STEPS, ACTIONS)
    trained, _ = world(states, actions, torch.full((4,), last_seen))

    memory = None
    for step in range(last_seen):
        one = world.imagine(states[:, step], actions[:, step : step + 1], memory)
        torch.testing.assert_close(one[:, 0], trained[:, step])
        memory = world.remember(states[:, step], actions[:, step], memory)
    imagined = world.imagine(states[:, last_seen], actions[:, last_seen:], memory)

    torch.testing.assert_close(imagined, trained[:, last_seen:])


def test_what_comes_after_the_last_state_that_is_seen_is_not_looked_at() -> None:
    world, states, actions = model(), torch.randn(2, STEPS, SIZE), torch.randn(2, STEPS, ACTIONS)
    last_seen = torch.tensor([1, 4])  # each episode its own
    changed = states.clone()
    changed[0, 2:], changed[1, 5:] = 100, 100

    assert torch.equal(world(states, actions, last_seen)[0], world(changed, actions, last_seen)[0])
    assert not torch.equal(world(states, actions, last_seen)[0], world(states, actions, last_seen + 1)[0])


def led(episodes: int, seed: int) -> tuple[Tensor, Tensor]:
    """States (B, STEPS, 1) of a hand that follows a place that actions (B, STEPS, 1) move and nobody sees."""
    random = torch.Generator().manual_seed(seed)
    actions = 2 * torch.rand(episodes, STEPS, 1, generator=random) - 1
    states = [torch.randn(episodes, 1, generator=random)]
    place = states[0]
    for step in range(STEPS - 1):
        place = place + actions[:, step]
        states.append(states[-1] + (place - states[-1]) / 4)
    return torch.stack(states, 1), actions


def test_it_knows_what_a_state_does_not_show() -> None:
    """From the fourth state on; what the newest state and action alone tell explains less than half of it."""
    world = model(1, 1, 32)
    optimizer = torch.optim.Adam(world.parameters(), lr=5e-3)
    for step in range(400):
        states, actions = led(64, step)
        imagined, _ = world(states, actions, torch.randint(0, STEPS - 1, (64,)))
        optimizer.zero_grad()
        (imagined - states.roll(-1, 1))[:, :-1].square().mean().backward()
        optimizer.step()

    states, actions = led(500, 1000)
    with torch.no_grad():
        imagined, _ = world(states, actions, torch.full((500,), 3))
    moved = states[:, -1] - states[:, 3]
    assert (imagined[:, -2] - states[:, -1]).square().mean() < 0.1 * moved.square().mean()
    known = torch.cat([states[:, 3], actions[:, 3:-1, 0], torch.ones(500, 1)], 1)  # without what was done before
    rest = moved - known @ torch.linalg.lstsq(known, moved).solution
    assert rest.square().mean() > 0.3 * moved.square().mean()
