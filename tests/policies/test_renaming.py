"""A policy goes on with a dataset whose features have other names, which `--rename_map` translates."""

from pathlib import Path

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.processor import RenameObservationsProcessorStep
from tiny_policies import training

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.renaming import renamed_features

STATE, CAMERA = "observation.state", "observation.images.front"


def test_training_on_renamed_features(pictures: Path) -> None:
    as_it_is = {"STATE": NormalizationMode.IDENTITY}  # LeRobot scales by the dataset's names, of which this has none
    usual = training("lisa", pictures, dropout=0.0, normalization_mapping=as_it_is, shared_observation_encoder=False)
    batch = usual.batch(usual.first_frames())
    expected, _ = usual.policy.forward(batch)

    names = {CAMERA: "observation.images.camera1", STATE: "observation.pose"}
    other = training("lisa", pictures, dropout=0.0, normalization_mapping=as_it_is, shared_observation_encoder=False)
    other.policy.config.input_features = {
        names[key]: feature for key, feature in other.policy.config.input_features.items()
    }
    encoders = (other.policy.network.predictor_observations, other.policy.network.observations)
    for encoder in encoders:  # as a checkpoint that knows only its own names
        encoder.others = {names[key]: name for key, name in encoder.others.items()}
        encoder.places = {names[key]: count for key, count in encoder.places.items()}
    loss, _ = other.policy.forward(RenameObservationsProcessorStep(names).observation(batch))

    torch.testing.assert_close(loss, expected)


def feature(*shape: int) -> PolicyFeature:
    return PolicyFeature(FeatureType.STATE, shape)


def numbers(*shape: int) -> dict:
    return {"dtype": "float32", "shape": shape, "names": None}


def test_what_cannot_be_matched_is_a_user_error() -> None:
    dataset = {"observation.a": numbers(3), "observation.b": numbers(3), "action": numbers(2)}

    assert renamed_features({"observation.a": feature(3)}, dataset, {"observation.a"}) == {}
    assert renamed_features({"observation.x": feature(3)}, dataset, {"observation.x", "observation.b"}) == {
        "observation.a": "observation.x"
    }
    with pytest.raises(UserError, match=r"needs `observation.x`.*pass --rename_map"):
        renamed_features({"observation.x": feature(3)}, dataset, {"observation.a", "observation.b"})
    with pytest.raises(UserError, match=r"may be any of the renamed \['observation.a', 'observation.b'\]"):
        renamed_features({"observation.x": feature(3)}, dataset, {"observation.x"})
