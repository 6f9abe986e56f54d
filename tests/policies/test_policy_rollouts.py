"""Rollouts through LeRobot's pipelines, replayed through the very forward pass that trains."""

from pathlib import Path
from typing import Any

import pytest
import tiny_datasets
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION
from replay import (
    HORIZON,
    NORMALISED,
    TASKS,
    actions_of,
    assert_rollout_is_training,
    assert_rollouts_change_nothing,
    live_observations,
    step_batch,
)
from tiny_policies import Training, training
from torch import Tensor

from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])


@BOTH
@pytest.mark.parametrize("data", ["symbolic", "continuous", "pictures"])
def test_rollout_is_training(kind: str, data: str, request: pytest.FixtureRequest) -> None:
    settings = {} if data == "symbolic" else {"normalization_mapping": NORMALISED}
    made = training(kind, request.getfixturevalue(data), **settings).warm_up()

    assert_rollout_is_training(made, steps=4 * HORIZON + 2)


@BOTH
@pytest.mark.parametrize("head", ["bins", "mixture"])
def test_other_action_heads(kind: str, head: str, continuous: Path) -> None:
    made = training(kind, continuous, normalization_mapping=NORMALISED, action_head=head).warm_up()

    assert_rollout_is_training(made, steps=2 * HORIZON)


@pytest.mark.parametrize(
    "settings",
    [
        {"shared_observation_encoder": True},
        {"copy_words": False, "ask_observations": False},
        {"quantizer": "continuous"},
        {"quantizer": "continuous", "copy_words": False},
        {"quantizer": "fsq"},
        {"quantizer": "residual_vq", "n_code_parts": 2},
        {"n_code_parts": 2},
        {"n_code_parts": 2, "copy_words": False},
        {"vision_backbone": "resnet18"},
        {"skill_predictor": "mlp"},
        {"termination_stride": 1},
        {"skill_predictor": "mlp", "copy_words": False, "predictor_stride": 1},
    ],
    ids=str,
)
def test_other_kinds_of_lisa(settings: dict[str, Any], pictures: Path) -> None:
    made = training("lisa", pictures, **settings).warm_up()

    assert_rollout_is_training(made, steps=4 * HORIZON + 2)


def test_skills_that_end_before_their_horizon(symbolic: Path) -> None:
    made = training("lisa", symbolic, horizon=6, termination_stride=2).warm_up()
    _, metrics = made.policy.forward(made.batch(made.first_frames()))

    assert_rollout_is_training(made, steps=40)
    assert_rollouts_change_nothing(made)
    assert 1 <= metrics["skill_steps"] <= 6
    assert metrics["termination_loss"] >= 0


@BOTH
def test_without_names(kind: str, symbolic: Path) -> None:
    """Nothing is known by its name, so every token asks every cell; the lexicon still reads codes."""
    made = training(kind, symbolic, names=False).warm_up()
    network = made.policy.network

    assert_rollout_is_training(made, steps=4 * HORIZON + 2)
    assert len(network.language.names()) == 0 < len(training(kind, symbolic).policy.network.language.names())
    assert network.observations.places["observation.grid"] == 49
    assert network.observations.parts["observation_grid"].channels == 3
    if kind == "lisa":
        assert len(made.policy.code_labels) == made.policy.n_codes


@BOTH
def test_rollouts_longer_than_any_training_episode(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic, max_timesteps=5).warm_up()

    assert_rollout_is_training(made, steps=40)


@BOTH
@pytest.mark.parametrize("data", ["symbolic", "continuous", "pictures"])
def test_stored_frames_are_scaled_as_the_preprocessor_scales(
    kind: str, data: str, request: pytest.FixtureRequest
) -> None:
    """The store's path and the loader's path end in the same numbers."""
    settings = {} if data == "symbolic" else {"normalization_mapping": NORMALISED}
    made = training(kind, request.getfixturevalue(data), **settings)
    frames, _ = made.policy.episode_store.gather(torch.arange(made.dataset.num_episodes))
    scaled = made.policy.scaled(frames)
    loaded = made.batch(range(len(made.dataset)))

    for key in [*made.policy.config.input_features, ACTION]:
        ours = scaled[key].float()
        ours = ours / 255 if scaled[key].dtype == torch.uint8 and "images" in key else ours
        torch.testing.assert_close(ours.reshape(loaded[key].shape), loaded[key].float(), atol=1e-6, rtol=1e-6)
        if settings and "images" not in key:
            assert ours.mean().abs() < 0.1
            assert ours.std() == pytest.approx(1, abs=0.1)


@BOTH
def test_actions_have_the_shape_lerobot_wants(kind: str, symbolic: Path, continuous: Path) -> None:
    for root, size in [(symbolic, 1), (continuous, 2)]:
        made = training(kind, root).warm_up()
        observations = live_observations(made, 3, 2)
        batch = step_batch(made, observations, 0, TASKS[:3])

        actions = made.postprocessor(made.policy.select_action(batch))
        made.policy.reset()
        chunk = made.policy.predict_action_chunk(batch)

        assert actions.shape == (3, size)
        assert actions.dtype == torch.float32
        assert chunk.shape == (3, 1, size)


@BOTH
def test_reset_forgets_everything(kind: str, continuous: Path) -> None:
    made = training(kind, continuous).warm_up()
    observations = live_observations(made, 2, 8)
    first = actions_of(made, observations, range(8), TASKS[:2])

    continued = actions_of(made, observations, range(8), TASKS[:2])
    made.policy.reset()
    again = actions_of(made, observations, range(8), TASKS[:2])

    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(torch.allclose(a, b) for a, b in zip(first, continued, strict=True))


@BOTH
def test_another_instruction_starts_over(kind: str, continuous: Path) -> None:
    made = training(kind, continuous).warm_up()
    observations = live_observations(made, 2, 8)
    made.policy.reset()
    fresh = actions_of(made, observations, range(4, 8), ["open a door", "go"])

    made.policy.reset()
    actions_of(made, observations, range(4), ["open a door", "open a door"])
    changed = actions_of(made, observations, range(4, 8), ["open a door", "go"])

    assert all(torch.equal(a, b) for a, b in zip(fresh, changed, strict=True))


@BOTH
def test_drawn_actions_are_exact(kind: str, symbolic: Path) -> None:
    """Rollout k draws the same whatever else uses random numbers; rollouts differ; temperature 0 draws nothing."""
    made = training(kind, symbolic).warm_up()
    observations = live_observations(made, 4, 10)

    def rollouts(policy_of: Training, noise: int) -> list[Tensor]:
        policy_of.policy.rollouts = 0
        torch.manual_seed(noise)
        drawn = []
        for _ in range(2):
            policy_of.policy.reset()
            steps = [policy_of.policy.select_action(step_batch(policy_of, observations, t, TASKS)) for t in range(10)]
            drawn.append(torch.stack(steps))
        return drawn

    first, second = rollouts(made, 0), rollouts(made, 1)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert not torch.equal(first[0], first[1])
    greedy = rollouts(training(kind, symbolic, action_temperature=0.0).warm_up(), 0)
    assert torch.equal(greedy[0], greedy[1])


@BOTH
def test_rollouts_change_no_buffer_and_no_weight(kind: str, symbolic: Path) -> None:
    assert_rollouts_change_nothing(training(kind, symbolic).warm_up())


def test_the_skill_in_use_can_be_read(symbolic: Path) -> None:
    made = training("lisa", symbolic).warm_up()
    assert made.policy.skill_codes is None

    actions_of(made, live_observations(made, 4, 1), range(1), TASKS)

    assert made.policy.skill_codes.shape == (4,)


def test_a_single_frame_dataset_trains(tmp_path: Path) -> None:
    root = tiny_datasets.symbolic(tmp_path / "data", lengths=[1])
    for kind in ("lisa", "lang_dt"):
        loss, _ = training(kind, root).policy.forward(Training.batch(training(kind, root), [0]))
        assert torch.isfinite(loss)


def test_training_needs_a_dataset(symbolic: Path) -> None:
    made = training("lisa", symbolic)
    alone = type(made.policy)(made.policy.config)

    with pytest.raises(UserError, match="learns from whole episodes"):
        alone.forward(made.batch([0]))
    assert isinstance(made.dataset, LeRobotDataset)


@BOTH
def test_where_it_looked(kind: str, symbolic: Path, pictures: Path) -> None:
    """A distribution over the cells or patches of each feature, or over nothing."""
    for root, expected in ((symbolic, {"observation.grid": 49}), (pictures, None)):
        made = training(kind, root).warm_up()
        assert made.policy.looks is None
        made.policy.select_action(step_batch(made, live_observations(made, 3, 1), 0, TASKS[:3]))

        looks = made.policy.looks
        assert looks is not None
        assert {key: value.shape[1] for key, value in looks.items()} == (
            expected or {"observation.images.front": 16, "observation.state": 1}
        )
        assert all((value >= 0).all() for value in looks.values())
        assert (sum(value.sum(1) for value in looks.values()) <= made.policy.questions + 1e-5).all()
        if kind == "lang_dt" and expected:  # "go" names nothing, "pick up the grey key, then put it ... blue box" four
            assert made.policy.questions.tolist()[:2] == [0, 4]
        assert sum(value.sum(1) for value in looks.values()).max() <= (1 if kind == "lisa" else 20) + 1e-5
