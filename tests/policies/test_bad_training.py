"""One clear line for data that training cannot use, and statistics of a checkpoint that goes on with other data."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny_datasets
import torch
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors
from tiny_policies import training

from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_modeling import EpisodePolicy

MEAN_STD = {"STATE": NormalizationMode.MEAN_STD, "ACTION": NormalizationMode.MEAN_STD}


@pytest.mark.parametrize(("size", "classes"), [(1, 2), (3, 0)])
def test_actions_that_are_switches(size: int, classes: int, tmp_path: Path) -> None:
    """One switch is a choice of two, several are numbers."""
    switches = {"dtype": "bool", "shape": (size,), "names": [*"abc"][:size]}
    features = {"observation.state": tiny_datasets.STATE, "action": switches}
    frames = {
        "observation.state": np.zeros((8, 3), np.float32),
        "action": np.arange(8 * size).reshape(8, size) % 2 == 0,
    }
    write_dataset(tmp_path / "data", DatasetLayout("local/tiny", 10, features), [Episode("go", frames)])

    made = training("lisa", tmp_path / "data")
    loss, _ = made.policy.forward(made.batch([0, 5]))

    assert made.policy.config.action_classes == classes
    assert torch.isfinite(loss)
    live = made.preprocessor({"observation.state": torch.zeros(1, 3), "task": "go"})
    assert made.policy.select_action(live).shape == (1, size)


def test_resuming_on_data_whose_statistics_have_changed(continuous: Path, tmp_path: Path) -> None:
    """LeRobot takes the checkpoint's statistics to resume with and the dataset's to fine-tune with; so must we."""
    made = training("lisa", continuous, normalization_mapping=MEAN_STD)
    made.policy.save_pretrained(tmp_path)
    made.preprocessor.save_pretrained(tmp_path)
    made.postprocessor.save_pretrained(tmp_path)
    made.dataset.meta.stats["observation.state"]["mean"] = made.dataset.meta.stats["observation.state"]["mean"] + 1
    cfg = PreTrainedConfig.from_pretrained(tmp_path)
    cfg.pretrained_path = tmp_path
    policy = make_policy(cfg, ds_meta=made.dataset.meta)
    frames = torch.utils.data.default_collate([made.dataset[i] for i in (0, 9)])

    resumed, _ = make_pre_post_processors(cfg, pretrained_path=str(tmp_path))
    assert_scales_as_its_batch(policy, resumed(frames))
    policy = make_policy(cfg, ds_meta=made.dataset.meta)
    tuned, _ = make_pre_post_processors(
        cfg,
        pretrained_path=str(tmp_path),
        preprocessor_overrides={"normalizer_processor": {"stats": made.dataset.meta.stats}},
    )
    assert_scales_as_its_batch(policy, tuned(frames))
    policy = make_policy(cfg, ds_meta=made.dataset.meta)
    batch = tuned(frames)
    batch["observation.state"] = batch["observation.state"] + 3
    with pytest.raises(UserError, match=r"scales `observation\.state` by other statistics"):
        policy.forward(batch)


def assert_scales_as_its_batch(policy: EpisodePolicy, batch: dict[str, Any]) -> None:
    stored, packing = policy.gather(batch)
    first = packing.lengths.cumsum(0) - packing.lengths
    rows = first + batch["index"] - policy.episode_store.starts[policy.episode_store.holding(batch["index"])]
    torch.testing.assert_close(stored["observation.state"][rows], batch["observation.state"], atol=1e-5, rtol=1e-5)
