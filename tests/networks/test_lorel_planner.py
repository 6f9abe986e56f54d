"""LOReL's planner learns a world, what is done in it, and to do what it is told, in a world that can be calculated."""

import torch
from tiny_networks import WIDTH, WORDS
from torch import Tensor

from lerobot_lisa.networks.cross_entropy import CrossEntropySearch
from lerobot_lisa.networks.language import LanguageEncoder, WordEncoder
from lerobot_lisa.networks.lorel_planner import LorelPlanner, PlannedActions
from lerobot_lisa.networks.packing import Packing

STEPS = 6
TOLD = torch.tensor([[3, 4], [3, 5]])  # move right, move left


def planner(dropout: float = 0.0) -> LorelPlanner:
    """In a world of two numbers that the first two of three actions move; the third one is ignored."""
    torch.manual_seed(0)
    bounds = torch.tensor([[-1.0, -1.0, -3.0], [1.0, 1.0, 3.0]])
    return LorelPlanner(
        language=LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH),
        keys=["x", "y"],
        size=2,
        width=WIDTH,
        dropout=dropout,
        head=PlannedActions(torch.tensor([1.0, 1.0, 0.0]), bounds),
        steps=3,
        search=CrossEntropySearch(samples=60, elites=8, rounds=3),
    )


def random_play(episodes: int, seed: int) -> tuple[Tensor, dict[str, Tensor], Tensor, Packing]:
    """Which instruction (B,) describes each episode, what was seen, what was done."""
    random = torch.Generator().manual_seed(seed)
    actions = 2 * torch.rand(episodes, STEPS, 3, generator=random) - 1
    actions[..., 2] *= 3
    states = torch.randn(episodes, 1, 2, generator=random) + actions[..., :2].cumsum(1) - actions[..., :2]
    told = (states[:, -1, 0] < states[:, 0, 0]).long()
    flat = states.flatten(0, 1)
    return told, {"x": flat[:, :1], "y": flat[:, 1:]}, actions.flatten(0, 1), Packing(torch.full((episodes,), STEPS))


def trained(steps: int = 250) -> LorelPlanner:
    network = planner()
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    for step in range(steps):
        told, observations, actions, packing = random_play(64, step)
        tokens = TOLD[told]
        predicted, judged = network(tokens, tokens > 0, observations, actions, packing)
        error = (predicted - network.state(observations).roll(-1, 0)).square().mean(1)
        optimizer.zero_grad()
        (error[packing.steps < STEPS - 1].mean() + judged.judge_loss).backward()
        optimizer.step()
    return network.eval()


def test_it_does_what_it_is_told() -> None:
    network, environments = trained(), 8
    state = torch.zeros(environments, 2)
    told = torch.arange(environments) % 2
    history = network.begin(TOLD[told], TOLD[told] > 0)
    history.generator = torch.Generator().manual_seed(0)
    for _ in range(STEPS):
        action = network.head.pick(network.act(history, {"x": state[:, :1], "y": state[:, 1:]}))
        history.actions = action
        assert (action[:, 2] == 0).all()  # ignored: it stays still
        assert (action.abs() <= 1).all()
        state = state + action[:, :2]

    assert ((state[:, 0] > 0.5) == (told == 0)).all()
    assert ((state[:, 0] < -0.5) == (told == 1)).all()
    assert torch.equal(history.start, torch.zeros(environments, 2))  # judged from where the rollout began


def test_the_ignored_action_changes_nothing_that_is_imagined() -> None:
    network, states = planner(), torch.randn(5, 2)
    actions = torch.randn(5, 4, 3)
    other = actions.clone()
    other[:, :, 2] += 7

    def imagined(plans: Tensor) -> Tensor:
        return network.world.imagine(states, network.head.embed(plans), None)

    assert torch.equal(imagined(actions), imagined(other))
    assert not torch.equal(imagined(actions), imagined(actions + 1))


def test_every_parameter_learns() -> None:
    network = planner().train()
    told, observations, actions, packing = random_play(8, 0)
    predicted, judged = network(TOLD[told], TOLD[told] > 0, observations, actions, packing)

    (predicted.square().mean() + judged.judge_loss).backward()

    idle = [
        name for name, p in network.named_parameters() if p.grad is None or not p.grad.any() or p.grad.isnan().any()
    ]
    assert idle == []


def test_what_says_nothing_is_not_judged() -> None:
    """Episodes of one frame have not changed anything, and the same instruction is no other one."""
    network = planner()
    _, observations, actions, _ = random_play(2, 0)
    one = {key: value[:2] for key, value in observations.items()}
    _, still = network(TOLD, TOLD > 0, one, actions[:2], Packing(torch.tensor([1, 1])))
    assert (still.judge_loss, still.judge_accuracy) == (0, 0)

    same = TOLD[[0, 0]]
    packing = Packing(torch.tensor([STEPS, STEPS]))
    _, alike = network(same, same > 0, observations, actions, packing)
    first, last = network.state(observations)[[0, STEPS]], network.state(observations)[[STEPS - 1, 2 * STEPS - 1]]
    sentences = network.language(same, same > 0).sentence()
    there, back = network.judge(first, last, sentences), network.judge(last, first, sentences)
    expected = -(there.sigmoid().log().mean() / 2 + (1 - back.sigmoid()).log().mean() / 4)
    torch.testing.assert_close(alike.judge_loss, expected)
