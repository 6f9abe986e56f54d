"""Parts of episodes through LeRobot's pipelines: as in rollouts, unbiased, and small however long episodes are."""

import json
from pathlib import Path
from typing import Any

import pytest
import tiny_datasets
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.utils.constants import ACTION
from tiny_policies import Training, config, training

from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
SHORT = {"excerpt_steps": 6, "lookback_steps": 5, "dropout": 0.0}
LONGEST = 4  # the episode of 23 steps


@torch.no_grad()
def rolled_out(made: Training, episode: int) -> torch.Tensor:
    """Predictions (T, ...) of a policy that is shown an episode and does as was demonstrated."""
    meta, outputs = made.dataset.meta, []
    first, last = (meta.episodes[f"dataset_{end}_index"][episode] for end in ("from", "to"))
    made.policy.reset()
    for index in range(first, last):
        batch = made.batch([index])
        outputs.append(made.policy.action_outputs(batch))
        made.policy._history.actions = batch[ACTION].reshape(1, -1)
    return torch.cat(outputs)


@BOTH
@pytest.mark.parametrize("settings", [{}, {"image_size": 4}, {"shared_observation_encoder": False}], ids=str)
def test_a_part_of_an_episode_is_predicted_as_in_a_rollout(kind: str, settings: dict[str, Any], pictures: Path) -> None:
    settings = {key: value for key, value in settings.items() if hasattr(config(kind), key)}
    made = training(kind, pictures, **SHORT, **settings).warm_up()
    first = made.first_frames()[LONGEST]
    expected = rolled_out(made, LONGEST)

    made.policy.eval()
    batch = made.batch([first + 13])  # of the part from step 12 to 17
    frames, packing = made.policy.gather(batch)
    tokens, valid = made.policy.instructions.read(batch)
    observations = {key: frames[key] for key in made.policy.config.input_features}
    outputs, _, _ = made.policy.predict(tokens, valid, observations, frames[ACTION], packing)

    assert packing.steps[packing.learned_rows].tolist() == [12, 13, 14, 15, 16, 17]
    torch.testing.assert_close(outputs, expected[12:18], atol=1e-5, rtol=1e-5)


@BOTH
def test_parts_weigh_every_frame_as_whole_episodes_do(kind: str, pictures: Path) -> None:
    """Over all frames of a dataset, the loss is the same to the last digit that float32 has."""
    settings = {**SHORT, "quantizer": "continuous"} if kind == "lisa" else SHORT  # without codes that move
    made = training(kind, pictures, **settings)
    made.policy.eval()
    every = made.batch(range(len(made.dataset)))

    with torch.no_grad():
        parts, _ = made.policy.forward(every, reduction="none")
        made.policy.config.excerpt_steps = 0
        whole, _ = made.policy.forward(every, reduction="none")

    torch.testing.assert_close(parts.mean(), whole.mean(), atol=1e-5, rtol=1e-5)
    assert not torch.allclose(parts, whole)


@BOTH
def test_a_step_does_not_grow_with_episodes(kind: str, tmp_path: Path) -> None:
    frames = []
    for length in (100, 300):
        root = tiny_datasets.pictures(tmp_path / str(length), lengths=[length])
        frames.append(training(kind, root, **SHORT).policy.gather(training(kind, root).batch([length // 2]))[1].total)

    assert frames[0] == frames[1] <= 6 + 10


@BOTH
def test_what_is_left_open_depends_on_whether_there_are_pictures(
    kind: str, pictures: Path, continuous: Path, symbolic: Path
) -> None:
    """BabyAI and LOReL's states are learned from whole episodes, as in the paper."""
    for root, seen in ((pictures, True), (continuous, False), (symbolic, False)):
        chosen = training(kind, root).policy.config
        assert (chosen.excerpt_steps > 0) == (chosen.lookback_steps > 0) == seen
        scaled = NormalizationMode.IDENTITY if root == symbolic else NormalizationMode.MEAN_STD
        assert chosen.normalization_mapping["ACTION"] is scaled
        assert chosen.normalization_mapping["STATE"] is NormalizationMode.MEAN_STD
        if kind == "lisa":
            assert chosen.shared_observation_encoder is seen
            assert chosen.predictor_stride == (chosen.horizon if seen else 1)


def test_what_the_user_says_stays(pictures: Path) -> None:
    said = {"excerpt_steps": 0, "lookback_steps": 0, "predictor_stride": 1, "shared_observation_encoder": False}
    mapping = {"ACTION": NormalizationMode.MIN_MAX}

    chosen = training("lisa", pictures, **said, normalization_mapping=mapping).policy.config

    assert {key: getattr(chosen, key) for key in said} == said
    assert chosen.normalization_mapping["ACTION"] is NormalizationMode.MIN_MAX


def test_settings_that_cannot_work_are_refused(pictures: Path) -> None:
    with pytest.raises(UserError, match=r"horizon=3 must be a multiple of --policy\.predictor_stride=2"):
        config("lisa", predictor_stride=2)
    with pytest.raises(UserError, match=r"made smaller to 4 pixels, so it cannot be normalised before: set"):
        training("lisa", pictures, image_size=4, normalization_mapping={"VISUAL": NormalizationMode.MEAN_STD})


def test_switches_are_symbols() -> None:
    cfg = config("lisa", input_features={"observation.touch": PolicyFeature(FeatureType.STATE, (2,))})

    cfg.set_dataset_feature_metadata({"observation.touch": {"dtype": "bool", "shape": (2,), "names": None}})

    assert cfg.input_features["observation.touch"].type is FeatureType.ENV


@BOTH
def test_a_checkpoint_from_before_there_was_a_choice_acts_as_it_did(kind: str, pictures: Path, tmp_path: Path) -> None:
    """It names none of the settings, and was trained on whole episodes, looking at every step."""
    names = ("excerpt_steps", "lookback_steps", "predictor_stride", "shared_observation_encoder")
    before = {name: 0 for name in names if hasattr(config(kind), name)}
    if kind == "lisa":
        before |= {"predictor_stride": 1, "shared_observation_encoder": False}
    training(kind, pictures, **before).policy.save_pretrained(tmp_path)
    settings = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({k: v for k, v in settings.items() if k not in names}))

    loaded = PreTrainedConfig.from_pretrained(tmp_path)
    loaded.fill_in()

    assert {name: getattr(loaded, name) for name in before} == before
