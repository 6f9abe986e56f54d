"""One clear line for a rollout that cannot work: no instruction, wrong shapes, broken sensors, another world."""

from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.policies.factory import get_policy_class
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError

GRID = {"observation.grid": torch.ones(2, 147), "observation.direction": torch.ones(2, 1)}
STATE = {"observation.state": torch.zeros(2, 3)}


def act(made: Training, observation: dict[str, Any], **more: Any) -> torch.Tensor:
    return made.policy.select_action(made.preprocessor({**observation, **more}))


BAD = {
    "no task": ({}, {}, "put the task string into the batch under the key `task`"),
    "no string": ({}, {"task": [None, "go"]}, "an instruction is a string, but `task` holds None"),
    "no instruction": ({}, {"task": []}, "`task` is empty"),
    "one instruction for two": ({}, {"task": ["go"]}, r"`observation\.grid` has shape \(2, 147\), .* \(1, 147\)"),
    "no batch dimension": (
        {"observation.grid": torch.ones(147)},
        {"task": ["go", "go"]},
        r"`observation\.grid` has shape \(147,\), .* \(2, 147\)",
    ),
    "a smaller grid": (
        {"observation.grid": torch.ones(2, 75)},
        {"task": ["go", "go"]},
        r"`observation\.grid` has shape \(2, 75\)",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_batches(case: str, symbolic: Path) -> None:
    change, more, message = BAD[case]

    with pytest.raises(UserError, match=message) as caught:
        act(training("lisa", symbolic), {**GRID, **change}, **more)
    assert "\n" not in str(caught.value)


def test_without_the_preprocessor(symbolic: Path) -> None:
    with pytest.raises(UserError, match="pass it through the policy's preprocessor"):
        training("lisa", symbolic).policy.select_action({**GRID, "task": ["go", "go"]})


@pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
def test_a_feature_that_goes_missing(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic).warm_up()
    act(made, GRID, task=["go", "go"])

    with pytest.raises(UserError, match=r"trained on observation\.direction, but the .* shows observation\.grid"):
        act(made, {"observation.grid": GRID["observation.grid"]}, task=["go", "go"])


@pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_broken_sensor(kind: str, value: float, continuous: Path) -> None:
    made = training(kind, continuous).warm_up()
    act(made, STATE, task=["go", "go"])
    broken = STATE["observation.state"].clone()
    broken[1, 2] = value

    with pytest.raises(UserError, match=r"`observation\.state` holds NaN or infinite numbers: look at the sensor"):
        act(made, {"observation.state": broken}, task=["go", "go"])


@pytest.mark.parametrize("temperature", [0.0, 1.0])
def test_broken_weights(temperature: float, symbolic: Path) -> None:
    made = training("lang_dt", symbolic, action_temperature=temperature)
    for parameter in made.policy.network.head.parameters():
        parameter.data.fill_(float("nan"))

    with pytest.raises(UserError, match="weights make predictions that are NaN"):
        act(made, GRID, task=["go", "go"])


def test_instructions_of_unknown_words_are_told_apart(symbolic: Path) -> None:
    """Their tokens are the same; where a batch brings no texts, tokens have to do."""
    policy = (made := training("lisa", symbolic)).policy
    for task in ("jump high", "run away", "run away"):
        batch = made.preprocessor({**GRID, "task": [task] * 2})
        policy.select_action(batch)
    assert policy.rollouts == 2

    policy.reset()
    del batch["task"]
    for _ in range(2):
        policy.select_action(batch)
    assert policy.rollouts == 3


def test_weights_that_are_missing_or_do_not_fit(symbolic: Path, tmp_path: Path) -> None:
    """Random weights would act without a word."""
    from safetensors.torch import load_file, save_file

    made = training("lang_dt", symbolic)
    made.policy.save_pretrained(tmp_path)
    path, load = tmp_path / "model.safetensors", get_policy_class("lang_dt").from_pretrained
    weights = load_file(path)
    name = next(key for key in weights if key.endswith("logits.weight"))

    save_file({**weights, "randomness.seed": torch.zeros(())}, path)  # what version 0.1 kept there
    load(tmp_path)
    save_file({**weights, name: torch.zeros(3, 32)}, path)
    with pytest.raises(UserError, match=r"model\.safetensors: the weights do not fit .* the world it was trained"):
        load(tmp_path)
    save_file({key: value for key, value in weights.items() if key != name}, path)
    with pytest.raises(UserError, match=r"missing or unknown \(.*logits\.weight\)"):
        load(tmp_path)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(UserError, match=r"model\.safetensors: the weights do not fit"):
        load(tmp_path)
    path.unlink()
    with pytest.raises(UserError, match=r"model\.safetensors: the weights do not fit .*No such file"):
        load(tmp_path)
