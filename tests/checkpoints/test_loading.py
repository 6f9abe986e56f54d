"""Sound checkpoints are loaded as LeRobot loads them, and old ones still are."""

import re
from pathlib import Path
from typing import Any

import pytest
import tiny_checkpoints
import torch
from checkpoint_copy import Copy
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors

from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

PAGE = Path(__file__).parents[2] / "docs" / "checkpoints.md"


def frame() -> dict[str, object]:
    return {
        "observation.grid": torch.randint(0, 11, (2, 147)).float(),
        "observation.direction": torch.randint(0, 4, (2, 1)).float(),
        "task": ["go to the red ball", "open a door"],
    }


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"shared_observation_encoder": True},
        {"quantizer": "continuous"},
        {"quantizer": "residual_vq", "n_code_parts": 2},
        {"quantizer": "fsq"},
        {"copy_words": False},
    ],
)
def test_the_policy_acts_as_lerobots(settings: dict[str, bool], symbolic: Path, tmp_path: Path) -> None:
    folder = tiny_checkpoints.lisa(symbolic, tmp_path / "lisa", **settings)
    theirs = get_policy_class("lisa").from_pretrained(folder)
    before, after = make_pre_post_processors(theirs.config, pretrained_path=str(folder))

    policy, preprocess, postprocess, _ = load_checkpoint(load_config(str(folder)), BabyAIEnvConfig())

    assert not policy.training
    for _ in range(5):
        seen = frame()
        assert torch.equal(
            postprocess(policy.select_action(preprocess(seen))), after(theirs.select_action(before(seen)))
        )


def test_loading_warns_of_no_words_that_nobody_has_said(
    symbolic: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A policy is tried on an instruction before it is trusted."""
    folder = tiny_checkpoints.lisa(symbolic, tmp_path / "lisa")
    config = load_config(str(folder))
    assert "red" in config.vocabulary
    config.vocabulary = ["lift" if word == "red" else word for word in config.vocabulary]

    load_checkpoint(config)

    assert not [line for line in caplog.messages if "no training instruction has" in line]


def test_the_pages_snippet(lisa: Path) -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    found: dict[str, Any] = {}
    exec(snippet.replace("outputs/lisa/checkpoints/last/pretrained_model", str(lisa)), found)
    assert found["policy"].config.action_temperature == 0
    assert len(found["identity"].sha256) == 64


def test_a_bad_setting_is_said_of_the_option_that_was_given(lisa: Path) -> None:
    with pytest.raises(UserError, match=r"^--policy\.dropout=9\.0 must be between 0 and 1"):
        load_config(str(lisa), ["--dropout=9"])


def test_lang_dt(symbolic: Path, tmp_path: Path) -> None:
    folder = tiny_checkpoints.lang_dt(symbolic, tmp_path / "lang_dt")
    policy, preprocess, postprocess, _ = load_checkpoint(load_config(str(folder), ["--action_temperature=0"]))
    assert policy.config.action_temperature == 0
    assert postprocess(policy.select_action(preprocess(frame()))).shape == (2, 1)


def test_scaling_is_the_checkpoints(continuous: Path, tmp_path: Path) -> None:
    mapping = {"STATE": "MEAN_STD", "ACTION": "MIN_MAX"}
    folder = tiny_checkpoints.lisa(continuous, tmp_path / "lisa", normalization_mapping=mapping)
    theirs = make_pre_post_processors(load_config(str(folder)), pretrained_path=str(folder))
    _, *ours, _ = load_checkpoint(load_config(str(folder)))
    action = torch.rand(3, *load_config(str(folder)).action_feature.shape)
    assert torch.equal(ours[1](action), theirs[1](action))
    assert not torch.equal(ours[1](action), action)


SMALL_ENCODERS: dict[str, dict[str, Any]] = {
    "distilbert": {"dim": 16, "n_layers": 1, "n_heads": 2, "hidden_dim": 16},
    "t5": {"d_model": 16, "d_kv": 8, "d_ff": 16, "num_layers": 1, "num_heads": 2},
    "clip_text_model": {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2},
}


@pytest.mark.parametrize("kind", SMALL_ENCODERS)
def test_a_pretrained_language_encoder_is_built_from_its_note(kind: str, copy: Copy) -> None:
    """What would choose code, such as another attention, is left out of the note."""
    note = {"model_type": kind, "vocab_size": 30, **SMALL_ENCODERS[kind]}
    config = load_config(str(copy.folder))
    config.language_encoder, config.language_model, config.pretrained_path = "me/encoder", note, None
    make_policy(config, env_cfg=BabyAIEnvConfig()).save_pretrained(copy.folder)
    copy.edit_tensors("model.safetensors", lambda tensors: [v.fill_(1) for k, v in tensors.items() if "initted" in k])
    copy.edit("config.json", lambda content: content["language_model"].update(attn_implementation="evil/kernels"))

    policy = load_checkpoint(load_config(str(copy.folder))).policy

    assert policy.config.language_model == note


def test_numbers_of_the_training_steps_may_come_and_go(copy: Copy) -> None:
    copy.edit_tensors(
        "model.safetensors",
        lambda tensors: [tensors.pop(f"randomness.{name}", None) for name in ("seed", "steps")],
    )
    load_checkpoint(load_config(str(copy.folder)))
    copy.edit_tensors(
        "model.safetensors",
        lambda tensors: tensors.update({f"randomness.{name}": torch.tensor(3) for name in ("seed", "steps")}),
    )
    load_checkpoint(load_config(str(copy.folder)))


def test_weights_that_do_not_fit_an_override(lisa: Path) -> None:
    with pytest.raises(UserError, match=r"model\.safetensors: .* leave out --policy options that change the network"):
        load_checkpoint(load_config(str(lisa), ["--codebook_size=8"]))


def test_a_policy_of_another_world(lisa: Path) -> None:
    with pytest.raises(UserError, match=r"acts with 1 numbers, --env\.type=lorel takes 5: .* another world"):
        load_checkpoint(load_config(str(lisa)), LorelEnvConfig())


def test_the_configuration_given_stays_as_it_is(lisa: Path) -> None:
    config = load_config(str(lisa))
    again = load_config(str(lisa))
    load_checkpoint(config, BabyAIEnvConfig())
    assert config == again
    assert isinstance(config, LisaConfig)
