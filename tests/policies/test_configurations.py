"""What a configuration learns from a dataset, and one clear line for everything that cannot work."""

import json
from pathlib import Path
from typing import Any

import draccus
import numpy as np
import pytest
import tiny_datasets
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from tiny_policies import config, training

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.dataset_features import learn_statistics

EVERY = pytest.mark.parametrize("kind", ["lisa", "lang_dt", "babyai_rnn", "lang_bc"])
GRID = PolicyFeature(FeatureType.STATE, (147,))
CAMERA = PolicyFeature(FeatureType.VISUAL, (3, 8, 6))
ACTION = PolicyFeature(FeatureType.ACTION, (1,))
MEAN_STD = {"STATE": NormalizationMode.IDENTITY, "ACTION": NormalizationMode.MEAN_STD}


def described(
    kind: str = "lisa", features: dict[str, Any] | None = None, stats: Any = None, **settings: Any
) -> EpisodePolicyConfig:
    features = features or {"observation.grid": tiny_datasets.GRID, "action": tiny_datasets.CLASSES}
    settings = {"input_features": {"observation.grid": GRID}, "output_features": {"action": ACTION}, **settings}
    cfg = config(kind, **settings)
    cfg.set_dataset_feature_metadata(features)
    learn_statistics(cfg, stats, longest=23)
    return cfg


@EVERY
def test_integer_observations_are_symbols_and_integer_actions_categorical(kind: str) -> None:
    cfg = described(kind)
    cfg.validate_features()

    assert cfg.input_features["observation.grid"] == PolicyFeature(FeatureType.ENV, (147,))
    assert (cfg.action_classes, cfg.max_timesteps) == (7, 23)


def test_real_observations_are_states_whatever_they_are_called() -> None:
    """LeRobot gives `observation.environment_state` the type ENV; its numbers must not be cut to integers."""
    key = "observation.environment_state"
    cfg = described(
        features={key: tiny_datasets.STATE, "action": tiny_datasets.MOVE},
        input_features={key: PolicyFeature(FeatureType.ENV, (3,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
    )

    assert cfg.input_features[key] == PolicyFeature(FeatureType.STATE, (3,))
    assert cfg.action_classes == 0


def test_classes_from_statistics_where_names_do_not_tell() -> None:
    unnamed = {"observation.grid": tiny_datasets.GRID, "action": {"dtype": "int64", "shape": (1,), "names": ["action"]}}

    assert described(features=unnamed, stats={"action": {"max": np.array([4])}}).action_classes == 5
    with pytest.raises(UserError, match=r"pass --policy\.action_classes=N"):
        described(features=unnamed)
    with pytest.raises(UserError, match=r"whose actions are -1 to 1: number them from 0, or pass 0"):
        described(features=unnamed, stats={"action": {"min": np.array([-1]), "max": np.array([1])}})


def test_what_the_user_has_set_stays() -> None:
    cfg = described(action_classes=9, max_timesteps=200)

    assert (cfg.action_classes, cfg.max_timesteps) == (9, 200)


def test_a_real_dataset_is_described_whole(symbolic: Path) -> None:
    cfg = training("lisa", symbolic).policy.config

    assert {key: feature.type for key, feature in cfg.input_features.items()} == {
        "observation.grid": FeatureType.ENV,
        "observation.direction": FeatureType.ENV,
    }
    assert (cfg.action_classes, cfg.max_timesteps) == (7, max(tiny_datasets.LENGTHS))
    assert "ball" in cfg.vocabulary


BAD_FEATURES = {
    "no observation": ({"input_features": {}}, r"needs at least one observation"),
    "no action": ({"output_features": {}}, r"needs a feature called `action`"),
    "action of two axes": (
        {"output_features": {"action": PolicyFeature(FeatureType.ACTION, (2, 3))}},
        r"takes a flat action, but `action` has shape \(2, 3\)",
    ),
    "two categorical actions": (
        {"output_features": {"action": PolicyFeature(FeatureType.ACTION, (2,))}},
        r"chooses one of 7 actions, but `action` here has 2 numbers: evaluate it in the world it was trained in",
    ),
    "normalised categories": ({"normalization_mapping": MEAN_STD}, "a categorical action cannot be normalised"),
    "normalised symbols": (
        {"normalization_mapping": {"ENV": NormalizationMode.MIN_MAX}},
        "ENV features hold symbols, which cannot be normalised",
    ),
    "flat image": (
        {"input_features": {"observation.image": PolicyFeature(FeatureType.VISUAL, (8, 6))}},
        r"image `observation.image` has shape \(8, 6\)",
    ),
    "empty state": (
        {"input_features": {"observation.state": PolicyFeature(FeatureType.STATE, (0,))}},
        r"`observation.state` has the empty shape \(0,\)",
    ),
    "unknown type": (
        {"input_features": {"observation.reward": PolicyFeature(FeatureType.REWARD, (1,))}},
        r"cannot read `observation.reward` of type REWARD",
    ),
    "ignored everything": ({"ignored_action_dimensions": [0]}, "must leave at least one of the 1 dimensions"),
    "ignored nothing there": ({"ignored_action_dimensions": [3]}, r"ignored_action_dimensions=\[3\]"),
}


@EVERY
@pytest.mark.parametrize("case", BAD_FEATURES)
def test_features_that_cannot_work(kind: str, case: str) -> None:
    settings, message = BAD_FEATURES[case]

    with pytest.raises(UserError, match=message) as caught:
        described(kind, **settings).validate_features()
    assert "\n" not in str(caught.value)


NAN, INF = float("nan"), float("inf")
BAD_SETTINGS = {
    "dim_model": (7, 0, -2, 10**9, 10**4000),
    "n_heads": (3, 0, -4),
    "dropout": (-0.1, 1.1, NAN, INF),
    "action_amplification": (-1.0, NAN, INF),
    "action_components": (0, 10**9),
    "action_seed": (-1, 2**70),
    "action_classes": (-1, 10**9),
    "max_timesteps": (0, 10**12),
    "optimizer_lr": (-1e-4, NAN, INF),
    "optimizer_lr_language": (-1e-4, NAN, INF),
    "optimizer_betas": ((0.9, 1.0), (NAN, 0.9)),
    "optimizer_eps": (-1e-8, NAN),
    "optimizer_weight_decay": (-0.1, NAN, INF),
    "optimizer_grad_clip_norm": (-1.0, NAN),
    "scheduler_warmup_steps": (-1,),
    "device": ("gpu", "cuda:x", "x" * 5000),
    "episode_store": "cloud",
    "scheduler": "linear",
    "dtype": "int8",
    "action_head": "diffusion",
    "action_bins": (1, 10**9),
    "action_temperature": (-1.0, NAN, INF),
}
BAD_LISA = {
    "horizon": (0, 10**9),
    "termination_stride": (-1, 2),  # the horizon of these is 3
    "skill_steps": (0.5, NAN),
    "termination_weight": (-1.0, NAN, INF),
    "skill_predictor": "lstm",
    "codebook_size": (0, 10**9),
    "code_width": (0, 10**9),
    "n_predictor_layers": (0, 10**6),
    "n_policy_layers": (0, 10**6),
    "codebook_decay": (1.0, -0.1, NAN),
    "commitment_weight": (-1.0, NAN, INF),
    "dead_code_threshold": (-1.0, NAN, INF),
    "optimizer_lr_skill_predictor": (-1e-5, NAN, INF),
}
BAD_LANG_DT = {"n_layers": (0, 10**6), "padding_waste": (-0.1, 1.5, NAN)}
BAD_BASELINE = {"ask_observations": True, "dropout": (1.5, NAN), "excerpt_steps": 80}
BAD = {
    "lisa": {**BAD_SETTINGS, **BAD_LISA},
    "lang_dt": {**BAD_SETTINGS, **BAD_LANG_DT},
    "babyai_rnn": {**BAD_BASELINE, "memory_width": (0, 10**9)},
    "lang_bc": BAD_BASELINE,
}
CASES = [
    (kind, name, value)
    for kind, settings in BAD.items()
    for name, values in settings.items()
    for value in (values if isinstance(values, tuple) else (values,))
]


@pytest.mark.parametrize(("kind", "name", "value"), CASES)
def test_settings_that_cannot_work(kind: str, name: str, value: Any) -> None:
    with pytest.raises(UserError, match=rf"--policy\.{name}") as caught:
        config(kind, **{name: value})
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "other", [{"quantizer": "continuous"}, {"excerpt_steps": 80}, {"predictor_stride": 3}], ids=str
)
def test_what_learned_termination_cannot_go_with(other: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=r"--policy\.termination_stride") as caught:
        config("lisa", horizon=6, termination_stride=2, **other)
    assert "\n" not in str(caught.value)


TOO_LARGE = {
    "width": {"dim_model": 8192, "n_layers": 100},
    "steps": {"max_timesteps": 10**7, "dim_model": 128},
    "features": {"input_features": {"observation.state": PolicyFeature(FeatureType.STATE, (10**9,))}},
    "actions": {"output_features": {"action": PolicyFeature(FeatureType.ACTION, (10**9,))}},
    "words": {"vocabulary": ["go"] * 4_000_000, "dim_model": 128},
}


@pytest.mark.parametrize("case", TOO_LARGE)
def test_a_configuration_that_would_fill_the_memory(case: str) -> None:
    """Each number alone may pass; whoever wrote the config.json, nothing is allocated."""
    with pytest.raises(UserError, match=r"about \S+ parameters, 5e\+08 is the most"):
        config("lang_dt", **TOO_LARGE[case])


@EVERY
def test_config_json_round_trip(kind: str, tmp_path: Path) -> None:
    cfg = described(
        kind,
        language_encoder="somewhere/else",
        language_model={"model_type": "distilbert", "dim": 32, "dropout": 0.1, "tie": True, "architectures": ["A"]},
        vocabulary=["go", "to"],
        ignored_action_dimensions=[],
        optimizer_lr_language=3e-6,
        normalization_mapping={"STATE": NormalizationMode.MEAN_STD, "ENV": NormalizationMode.IDENTITY},
    )
    cfg.save_pretrained(tmp_path)

    loaded = PreTrainedConfig.from_pretrained(tmp_path)

    assert type(loaded) is type(cfg)
    assert draccus.encode(loaded) == draccus.encode(cfg)
    assert loaded.language_model == cfg.language_model
    assert loaded.input_features == cfg.input_features


@EVERY
def test_a_checkpoint_of_another_version_is_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    described(kind).save_pretrained(tmp_path)
    path = tmp_path / "config.json"
    assert "width" not in json.loads(path.read_text())
    path.write_text(path.read_text().replace('"dim_model"', '"width"').replace('"n_heads"', '"heads"'))

    with pytest.raises(UserError, match=r"`width: 32` is .* of version 0\.1: it is called dim_model") as caught:
        PreTrainedConfig.from_pretrained(tmp_path)
    assert "\n" not in str(caught.value)


def test_action_classes_that_the_dataset_passes_are_refused(symbolic: Path) -> None:
    with pytest.raises(UserError, match=r"--policy\.action_classes=3"):
        training("lisa", symbolic, action_classes=3)


def test_symbols_beyond_the_vocabulary_are_refused(tmp_path: Path) -> None:
    """Cutting them would make different observations alike without a word."""
    features = {
        "observation.count": {"dtype": "int64", "shape": (2,), "names": ["a", "b"]},
        "action": tiny_datasets.CLASSES,
    }
    stats = {"observation.count": {"min": np.array([0, 0]), "max": np.array([3, 16])}}
    inputs = {"observation.count": PolicyFeature(FeatureType.STATE, (2,))}

    with pytest.raises(UserError, match=r"`observation\.count` holds integers from 0 to 16"):
        described(features=features, stats=stats, input_features=dict(inputs), numbers=[])
    stats["observation.count"]["max"][1] = 15
    described(features=features, stats=stats, input_features=inputs, numbers=[]).validate_features()


@pytest.mark.parametrize(
    ("low", "high", "numbers", "kind"),
    [
        (0, 15, None, FeatureType.ENV),
        (0, 16, None, FeatureType.STATE),
        (-3, 2, None, FeatureType.STATE),
        (0, 4095, None, FeatureType.STATE),
        (0, 3, ["observation.count"], FeatureType.STATE),
        (0, 3, [], FeatureType.ENV),
    ],
)
def test_integers_are_symbols_or_numbers(low: int, high: int, numbers: list[str] | None, kind: FeatureType) -> None:
    features = {
        "observation.count": {"dtype": "int64", "shape": (2,), "names": ["a", "b"]},
        "action": tiny_datasets.CLASSES,
    }
    stats = {"observation.count": {"min": np.array([low, 0]), "max": np.array([1, high])}}
    inputs = {"observation.count": PolicyFeature(FeatureType.STATE, (2,))}

    cfg = described(features=features, stats=stats, input_features=inputs, numbers=numbers)

    cfg.validate_features()
    assert cfg.input_features["observation.count"].type is kind
