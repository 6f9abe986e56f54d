"""Action heads: losses by hand, how an action is picked, dimensions that do not count."""

import math

import pytest
import torch

from lerobot_lisa.networks.actions import CategoricalHead
from lerobot_lisa.networks.real_actions import BinsHead, MeanHead, MixtureHead, RealHead

LOGITS = torch.tensor([[2.0, 0.0, 0.0], [0.0, 1.0, 5.0]])

BOUNDS = torch.tensor([[-1.0] * 3, [1.0] * 3])


def test_cross_entropy_by_hand() -> None:
    head = CategoricalHead(8, 3)

    loss = head.loss(LOGITS, torch.tensor([[0], [1]]))

    expected = [-math.log(math.e**2 / (math.e**2 + 2)), -math.log(math.e / (1 + math.e + math.e**5))]
    torch.testing.assert_close(loss, torch.tensor(expected))
    assert head.metrics(LOGITS, torch.tensor([[0], [1]]))["action_accuracy"] == 0.5


def test_temperature_zero_takes_the_most_probable_action() -> None:
    picked = CategoricalHead(8, 3, temperature=0).pick(LOGITS)

    assert torch.equal(picked, torch.tensor([[0.0], [2.0]]))  # float, because LeRobot hands floats to environments


def test_actions_are_drawn_in_proportion_and_exactly() -> None:
    head, rows = CategoricalHead(8, 3, temperature=2.0), 20_000
    logits = LOGITS[:1].expand(rows, -1)

    first = head.pick(logits, torch.Generator().manual_seed(3))
    again = head.pick(logits, torch.Generator().manual_seed(3))

    assert torch.equal(first, again)
    shares = torch.bincount(first[:, 0].long(), minlength=3) / rows
    torch.testing.assert_close(shares, torch.softmax(LOGITS[0] / 2, 0), atol=0.015, rtol=0)


def test_categorical_actions_of_any_dtype_embed_alike() -> None:
    head = CategoricalHead(8, 3)

    assert torch.equal(head.embed(torch.tensor([[2]])), head.embed(torch.tensor([[2.0]])))
    assert not torch.equal(head.embed(torch.tensor([[2]])), head.embed(torch.tensor([[1]])))


def test_squared_error_by_hand() -> None:
    head, actions = MeanHead(8, torch.ones(2), BOUNDS[:, :2]), torch.tensor([[1.0, 3.0]])

    assert head.loss(torch.tensor([[0.0, 1.0]]), actions).tolist() == [pytest.approx(2.5)]
    assert head.metrics(torch.tensor([[0.0, 1.0]]), actions)["action_error"] == 1.5
    assert torch.equal(head.pick(actions), actions)


def test_ignored_dimensions_enter_neither_loss_nor_input() -> None:
    head = MeanHead(8, torch.tensor([1.0, 0.0, 1.0]), BOUNDS)
    outputs, actions = torch.zeros(4, 3, requires_grad=True), torch.randn(4, 3)
    noisy = actions + torch.tensor([0.0, 1.0, 0.0]) * 1e3 * torch.randn(4, 1)

    torch.testing.assert_close(head.loss(outputs, noisy), actions[:, [0, 2]].square().mean(1))
    torch.testing.assert_close(head.embed(noisy), head.embed(actions))
    torch.testing.assert_close(head.metrics(outputs, noisy), head.metrics(outputs, actions))
    head.loss(outputs, noisy).sum().backward()
    assert torch.equal(outputs.grad[:, 1], torch.zeros(4))


HEADS = {
    "mean": lambda weights, bounds: MeanHead(8, weights, bounds),
    "amplified": lambda weights, bounds: MeanHead(8, weights, bounds, amplification=1000),
    "bins": lambda weights, bounds: BinsHead(8, weights, bounds, 5, temperature=1.0),
    "mixture": lambda weights, bounds: MixtureHead(8, weights, bounds, 2, temperature=1.0),
}


@pytest.mark.parametrize("name", HEADS)
def test_ignored_dimensions_stay_still(name: str) -> None:
    """Nothing is learned about them, so whatever the network says there must not move a robot."""
    bounds = torch.tensor([[-1.0, 0.5, -1.0], [1.0, 2.0, 1.0]])  # 0 is outside of the second one's
    head: RealHead = HEADS[name](torch.tensor([1.0, 0.0, 1.0]), bounds)
    outputs = head(torch.randn(50, 8))

    picked = head.pick(outputs, torch.Generator().manual_seed(0))

    assert torch.equal(picked[:, 1], torch.full((50,), 0.5))
    assert picked[:, [0, 2]].std(0).min() > 0.01
