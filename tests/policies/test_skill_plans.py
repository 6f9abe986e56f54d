"""Plans of skill codes from the command line and from Python."""

from pathlib import Path

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from test_policy_rollouts import TASKS, actions_of, live_observations
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError


def codes_of(made: Training, steps: int) -> list[list[int]]:
    """Skill codes of each step, (T, B)."""
    observations = live_observations(made, 2, steps)
    made.policy.reset()
    codes = []
    for step in range(steps):
        actions_of(made, observations, range(step, step + 1), TASKS[:2])
        codes.append(made.policy.skill_codes.tolist())
    return codes


def test_a_policy_follows_a_plan(continuous: Path) -> None:
    made = training("lisa", continuous).warm_up()
    own = codes_of(made, 8)

    made.policy.follow("4*2,1*3,?")
    steered = codes_of(made, 8)
    made.policy.follow(None)

    assert steered[:5] == [[4, 4]] * 2 + [[1, 1]] * 3
    assert codes_of(made, 8) == own


def test_the_predictors_choice_is_known_under_a_plan(continuous: Path) -> None:
    made = training("lisa", continuous).warm_up()
    chosen = codes_of(made, 1)[0]
    made.policy.follow("3")

    assert codes_of(made, 1) == [[3, 3]]
    assert made.policy.predicted_codes.tolist() == chosen


def test_the_loss_is_the_same(continuous: Path) -> None:
    made = training("lisa", continuous, dropout=0.0).warm_up().policy.eval()
    batch = training("lisa", continuous).batch([0, 8])
    before, _ = made.forward(batch)

    made.follow("3")

    assert torch.equal(made.forward(batch)[0], before)


def test_a_plan_is_an_option_of_every_lerobot_program(continuous: Path, tmp_path: Path) -> None:
    training("lisa", continuous).policy.save_pretrained(tmp_path)

    for plan in ("3", "3*20,2*20", "?*10,4"):
        assert PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[f"--skill_plan={plan}"]).skill_plan == plan


def test_bad_plans_are_refused(continuous: Path) -> None:
    policy = training("lisa", continuous).policy

    with pytest.raises(UserError, match="is no part of a plan"):
        policy.follow("all of them")
    assert policy.config.skill_plan is None
    with pytest.raises(UserError, match=r"'9{20}' is no part of a plan") as caught:
        policy.follow("9" * 5000)
    assert len(str(caught.value)) < 300
    with pytest.raises(UserError, match="codes 0 to 4"):
        training("lisa", continuous, skill_plan="5")
