"""Numbers of every type, range and shape, as robots' datasets have them; and mixed precision under either name."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from tiny_policies import Training, config, training

from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
LENGTH = 12
MOVE = {"dtype": "float32", "shape": (2,), "names": ["dx", "dy"]}


def feature(dtype: str, *shape: int) -> dict[str, Any]:
    names = [f"{dtype}_{i}" for i in range(math.prod(shape))] if len(shape) == 1 else None
    return {"dtype": dtype, "shape": shape, "names": names}


def dataset(root: Path, state: dict[str, Any], values: np.ndarray, action: Any = None, actions: Any = None) -> Path:
    """Two episodes of the same frames, as `lerobot-record` writes them."""
    rng = np.random.default_rng(0)
    features = {"observation.state": state, "action": action or MOVE}
    moves = rng.normal(size=(LENGTH, 2)).astype(np.float32) if actions is None else actions
    recorded = LeRobotDataset.create("local/tiny", 10, features, root, use_videos=False)
    for task in ("go", "stop"):
        for value, move in zip(values, moves, strict=True):
            recorded.add_frame({"observation.state": value, "action": move, "task": task})
        recorded.save_episode()
    recorded.finalize()
    return root


def act(made: Training, state: np.ndarray, task: str = "go") -> torch.Tensor:
    made.policy.reset()
    live = {"observation.state": torch.from_numpy(state)[None], "task": [task]}
    return made.postprocessor(made.policy.select_action(made.preprocessor(live)))


RNG = np.random.default_rng(1)
STATES = {
    "encoder ticks": (feature("int64", 2), RNG.integers(-5000, 5000, (LENGTH, 2))),
    "bytes": (feature("uint8", 3), RNG.integers(0, 256, (LENGTH, 3)).astype(np.uint8)),
    "doubles": (feature("float64", 2), RNG.normal(size=(LENGTH, 2))),
    "a tactile sensor": (feature("float32", 4, 3), RNG.normal(size=(LENGTH, 4, 3)).astype(np.float32)),
    "switches": (feature("bool", 2), RNG.integers(0, 2, (LENGTH, 2)).astype(bool)),
}


@BOTH
@pytest.mark.parametrize("name", STATES)
def test_a_state_of_any_type_is_learned_from_and_acted_on(kind: str, name: str, tmp_path: Path) -> None:
    described, values = STATES[name]
    made = training(kind, dataset(tmp_path / "data", described, values))

    loss, _ = made.policy.train().forward(made.batch(made.first_frames()))
    loss.backward()
    action = act(made, values[0])

    assert loss.isfinite()
    assert action.shape == (1, 2)
    assert action.isfinite().all()
    expected = FeatureType.ENV if name == "switches" else FeatureType.STATE
    assert made.policy.config.input_features["observation.state"].type is expected


ACTIONS = {
    "doubles": (feature("float64", 2), RNG.normal(size=(LENGTH, 2))),
    "ticks of several motors": (feature("int64", 3), RNG.integers(-900, 900, (LENGTH, 3))),
    "switches": (feature("bool", 3), RNG.integers(0, 2, (LENGTH, 3)).astype(bool)),
}


@BOTH
@pytest.mark.parametrize("name", ACTIONS)
def test_actions_of_any_type_are_real_numbers_unless_they_are_a_choice(kind: str, name: str, tmp_path: Path) -> None:
    described, values = ACTIONS[name]
    state, states = STATES["doubles"]
    made = training(kind, dataset(tmp_path / "data", state, states, described, values))

    loss, _ = made.policy.train().forward(made.batch(made.first_frames()))
    loss.backward()
    action = act(made, states[0])

    assert loss.isfinite()
    assert action.shape == (1, values.shape[1])
    assert np.abs(action.numpy()).max() < 10 * np.abs(values).max()
    assert loss < 10  # in units of their deviation


@BOTH
def test_a_joint_that_nobody_moved_may_tremble(kind: str, tmp_path: Path) -> None:
    """Its deviation is 0, or a rounding error: divided by that, a hundredth of a degree would be a million."""
    values = RNG.normal(size=(LENGTH, 2)).astype(np.float32)
    values[:, 1] = 90.3
    made = training(kind, dataset(tmp_path / "data", feature("float32", 2), values), dropout=0.0).warm_up()

    still = act(made, values[0])
    trembling = act(made, values[0] + np.array([0, 0.01], np.float32))

    torch.testing.assert_close(still, trembling, atol=0.05, rtol=0)


def test_the_commitment_loss_means_the_same_in_any_unit(tmp_path: Path) -> None:
    """Degrees or radians: neither loss depends on it, so neither does the weight of one beside the other."""
    states, moves = (RNG.normal(size=(LENGTH, 2)).astype(np.float32) for _ in range(2))
    losses = []
    for name, unit in (("radians", 1.0), ("degrees", 57.3)):
        data = (feature("float32", 2), unit * states, MOVE, (unit * moves).astype(np.float32))
        made = training("lisa", dataset(tmp_path / name, *data), dropout=0.0)
        _, metrics = made.policy.train().forward(made.batch(made.first_frames()))
        losses.append((metrics["action_loss"], metrics["commitment_loss"]))

    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


def test_mixed_precision_under_lerobots_older_name() -> None:
    """LeRobot's training looks at `dtype` where a policy has it, and passes over `use_amp` without a word."""
    assert config("lisa", use_amp=True).dtype == "bfloat16"
    assert config("lisa", use_amp=True, dtype="float16").dtype == "float16"
    assert config("lisa").dtype == "float32"


@BOTH
def test_a_rate_for_what_starts_from_nothing(kind: str, pictures: Path, continuous: Path) -> None:
    rates = {group["name"]: group["lr"] for group in training(kind, pictures).policy.get_optim_params()}
    assert set(rates.values()) == {3e-4}

    papers = {group["name"]: group["lr"] for group in training(kind, continuous).policy.get_optim_params()}
    assert papers["policy"] == 1e-4
    assert papers.get("skill_predictor", 1e-5) == 1e-5


def recorded(root: Path, features: dict[str, dict[str, Any]], frame: dict[str, Any]) -> Path:
    """By LeRobot's own recorder: an episode of three equal frames."""
    dataset = LeRobotDataset.create("local/tiny", 10, features, root=root, use_videos=False)
    for _ in range(3):
        dataset.add_frame(dict(frame))  # which it empties
    dataset.save_episode()
    dataset.finalize()
    return root


JOINTS = {"dtype": "float32", "shape": (2,), "names": ["a", "b"]}


def test_notes_that_were_recorded_are_left_out(tmp_path: Path) -> None:
    """LeRobot takes every `observation.*` for a state."""
    note = {"dtype": "string", "shape": (1,), "names": None}
    joints = np.zeros(2, np.float32)
    frame = {"observation.state": joints, "observation.note": "cold", "action": joints, "task": "go"}
    root = recorded(tmp_path / "data", {"observation.state": JOINTS, "observation.note": note, "action": JOINTS}, frame)

    with pytest.raises(UserError, match=r"`observation\.note` is text, which no policy here sees: leave it out of"):
        training("lisa", root)

    seen = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    assert training("lang_dt", root, input_features=seen).warm_up().policy.config.input_features == seen


def test_a_blank_instruction_is_learned_from_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    joints = np.zeros(2, np.float32)
    frame = {"observation.state": joints, "action": joints, "task": " "}
    with caplog.at_level("WARNING"):
        training("lisa", recorded(tmp_path / "data", {"observation.state": JOINTS, "action": JOINTS}, frame)).warm_up()

    assert [line for line in caplog.messages if "an instruction is blank" in line]
