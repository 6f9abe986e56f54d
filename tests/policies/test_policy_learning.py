"""Both policies learn: four episodes by heart, with the numbers they log and the parameters they hand out."""

from itertools import chain
from pathlib import Path

import pytest
import tiny_datasets
import torch
from lerobot.optim.factory import make_optimizer_and_scheduler
from lerobot.optim.optimizers import load_optimizer_state, save_optimizer_state
from tiny_policies import Training, config, training

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])


@BOTH
def test_four_episodes_by_heart(kind: str, tmp_path: Path) -> None:
    root = tiny_datasets.symbolic(tmp_path / "data", lengths=[9, 14, 6, 11])
    made = training(kind, root, dim_model=64, dropout=0.0)
    optimizer = torch.optim.Adam(made.policy.get_optim_params(), lr=1e-3)
    for group in optimizer.param_groups:
        group["lr"] = 3e-3
    batch, steps = made.batch(made.first_frames()), 0
    made.policy.train()
    accuracy = 0.0
    while accuracy <= 0.99 and steps < 200:
        optimizer.zero_grad()
        loss, metrics = made.policy.forward(batch)
        loss.backward()
        optimizer.step()
        accuracy, steps = metrics["action_accuracy"], steps + 1

    made.policy.eval()
    _, metrics = made.policy.forward(batch)
    assert metrics["action_accuracy"] > 0.99, steps


@BOTH
def test_loss_averages_over_frames_within_and_then_over_episodes(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic, dropout=0.0).warm_up()
    made.policy.eval()
    batch = made.batch(made.first_frames([0, 4, 4]))

    each, metrics = made.policy.forward(batch, reduction="none")
    mean, _ = made.policy.forward(batch)
    alone = torch.stack([made.policy.forward(made.batch(made.first_frames([i])), "none")[0][0] for i in (0, 4, 4)])

    assert each.shape == (3,)
    torch.testing.assert_close(each.mean(), mean)
    torch.testing.assert_close(each - _commitment(metrics), alone - _commitment(metrics), atol=1e-5, rtol=1e-4)


def _commitment(metrics: dict[str, float]) -> float:
    """Zero in evaluation mode."""
    assert metrics.get("commitment_loss", 0.0) == 0.0
    return 0.0


@BOTH
def test_any_frame_of_an_episode_stands_for_it(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic, dropout=0.0).warm_up()
    made.policy.eval()
    first = made.first_frames([4])[0]

    losses = [made.policy.forward(made.batch([frame]))[0] for frame in (first, first + 5, first + 22)]

    assert torch.equal(losses[0], losses[1])
    assert torch.equal(losses[0], losses[2])


@BOTH
def test_logged_numbers_are_plain_and_in_range(kind: str, symbolic: Path, continuous: Path) -> None:
    for root, score in [(symbolic, "action_accuracy"), (continuous, "action_error")]:
        made = training(kind, root)
        _, metrics = made.policy.forward(made.batch(made.first_frames()))

        assert all(type(value) is float for value in metrics.values())  # LeRobot drops everything else
        names = {"action_loss", score}
        if kind == "lisa":
            names |= {"commitment_loss", "perplexity", "codes_used", "mutual_information"}
            assert 1 <= metrics["perplexity"] <= metrics["codes_used"] + 1e-4 <= 5.1
            assert -1e-5 <= metrics["mutual_information"] <= 2.33
        assert metrics.keys() == names


def groups_of(made: Training) -> list[dict]:
    return [{**group, "params": list(group["params"])} for group in made.policy.get_optim_params()]


@BOTH
@pytest.mark.parametrize("data", ["symbolic", "pictures"])
def test_every_parameter_is_in_one_group(kind: str, data: str, request: pytest.FixtureRequest) -> None:
    made = training(kind, request.getfixturevalue(data), optimizer_lr_language=1e-7)
    groups = groups_of(made)

    handed_out = [id(parameter) for parameter in chain(*(group["params"] for group in groups))]
    assert len(handed_out) == len(set(handed_out))
    assert set(handed_out) == {id(parameter) for parameter in made.policy.parameters()}
    expected = {"policy": 1e-4, "skill_predictor": 1e-5, "language_encoder": 1e-7}
    if kind == "lang_dt":
        del expected["skill_predictor"]
    settings = made.policy.config
    rates = {"policy": settings.optimizer_lr, "language_encoder": 1e-7}
    if kind == "lisa":
        rates["skill_predictor"] = settings.optimizer_lr_skill_predictor
    assert {group["name"]: group["lr"] for group in groups} == rates
    assert rates.keys() == expected.keys()


def test_rates_by_default() -> None:
    assert config("lisa", language_encoder="words").language_rate == 1e-4
    assert config("lisa", language_encoder="words", optimizer_lr=3e-4).language_rate == 3e-4
    assert config("lisa", language_encoder="distilbert-base-uncased").language_rate == 1e-6
    assert config("lisa", optimizer_lr_language=0.0).language_rate == 0.0


@BOTH
@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_lerobot_builds_and_restores_the_optimizer(kind: str, schedule: str, symbolic: Path, tmp_path: Path) -> None:
    from lerobot.configs.default import DatasetConfig
    from lerobot.configs.train import TrainPipelineConfig

    made = training(kind, symbolic, scheduler=schedule, scheduler_warmup_steps=2)
    cfg = TrainPipelineConfig(dataset=DatasetConfig("local/tiny"), policy=made.policy.config, steps=10)
    cfg.optimizer, cfg.scheduler = cfg.policy.get_optimizer_preset(), cfg.policy.get_scheduler_preset()
    optimizer, scheduler = make_optimizer_and_scheduler(cfg, made.policy)
    rates = [group["initial_lr"] for group in optimizer.param_groups]
    for _ in range(6):
        made.policy.forward(made.batch(made.first_frames()))[0].backward()
        optimizer.step()
        scheduler.step()

    now = [group["lr"] for group in optimizer.param_groups]
    assert {round(lr / rate, 6) for lr, rate in zip(now, rates, strict=True)} == {round(now[0] / rates[0], 6)}
    assert (now == rates) == (schedule == "constant")
    save_optimizer_state(optimizer, tmp_path)
    other, _ = make_optimizer_and_scheduler(cfg, made.policy)
    load_optimizer_state(other, tmp_path)
    assert [group["lr"] for group in other.param_groups] == now
    for index, state in optimizer.state_dict()["state"].items():
        assert torch.equal(state["exp_avg"], other.state_dict()["state"][index]["exp_avg"])
