"""A frozen vision backbone: from torchvision, a folder or the Hub, asked once for each frame; the same in rollouts."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import tiny_datasets
import torch
import transformers
from lerobot.policies.factory import make_pre_post_processors
from lerobot.utils.constants import ACTION
from test_excerpts import rolled_out
from tiny_policies import Training, training

from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.backbones import Backbone

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
SIZES = {"hidden_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 32}
PATCHES = {"image_size": 28, "patch_size": 14}
CLIP = {"vocab_size": 40, "max_position_embeddings": 20, **SIZES}
MODELS = {
    "dinov2": lambda: transformers.Dinov2Model(transformers.Dinov2Config(**SIZES, **PATCHES)),
    "siglip": lambda: transformers.SiglipVisionModel(transformers.SiglipVisionConfig(**SIZES, **PATCHES)),
    "clip": lambda: transformers.CLIPModel(
        transformers.CLIPConfig(text_config=CLIP, vision_config={**SIZES, **PATCHES})
    ),
    "resnet": lambda: transformers.ResNetModel(
        transformers.ResNetConfig(embedding_size=8, hidden_sizes=[8, 16], depths=[1, 1], layer_type="basic")
    ),
}
CAMERA = "observation.images.front"
FROZEN = {"freeze_vision_backbone": True, "dropout": 0.0}
LONGEST = 4  # the episode of 23 steps


def folder(name: str, path: Path, seed: int = 1) -> str:
    """A small model with random weights, as `save_pretrained` leaves it."""
    torch.manual_seed(seed)
    MODELS[name]().save_pretrained(path)
    return str(path)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Of its own for each test: features are kept beside a dataset."""
    return tiny_datasets.pictures(tmp_path / "data")


@contextmanager
def pictures_asked(made: Training) -> Iterator[list[int]]:
    """How many pictures the backbone is shown at a time."""
    asked: list[int] = []
    hook = made.policy.eyes.model.register_forward_hook(lambda _, shown, __: asked.append(len(shown[0])))
    yield asked
    hook.remove()


def predicted(made: Training, frame: int) -> tuple[torch.Tensor, list[int]]:
    """Of the episode that holds a frame, or the part of it that is learned from; and the steps of it."""
    made.policy.eval()
    batch = made.batch([frame])
    frames, packing = made.policy.gather(batch)
    observations = {key: frames[key] for key in made.policy.config.input_features}
    tokens, valid = made.policy.instructions.read(batch)
    outputs, _, _ = made.policy.predict(tokens, valid, observations, frames[ACTION], packing)
    rows = slice(None) if packing.learned_rows is None else packing.learned_rows
    return outputs, packing.steps[rows].tolist()


@BOTH
@pytest.mark.parametrize("model", [*MODELS, "resnet18"])
def test_training_and_rollout_are_one_computation(kind: str, model: str, data: Path, tmp_path: Path) -> None:
    backbone = model if model == "resnet18" else folder(model, tmp_path / model)
    made = training(kind, data, vision_backbone=backbone, excerpt_steps=6, lookback_steps=5, **FROZEN).warm_up()
    expected = rolled_out(made, LONGEST)

    outputs, steps = predicted(made, made.first_frames()[LONGEST] + 13)

    assert len(steps) == 6
    torch.testing.assert_close(outputs, expected[steps], atol=1e-5, rtol=1e-5)


@BOTH
def test_each_frame_is_looked_at_once(kind: str, data: Path, tmp_path: Path) -> None:
    """Also by later runs; another backbone looks anew."""
    backbone = folder("dinov2", tmp_path / "model")
    frames = sum(tiny_datasets.LENGTHS)
    for path, count in ((backbone, frames), (backbone, 0), (folder("dinov2", tmp_path / "other", seed=2), frames)):
        made = training(kind, data, vision_backbone=path, excerpt_steps=0, **FROZEN)
        with pictures_asked(made) as asked:
            made.warm_up(3)
        assert sum(asked) == count


@BOTH
def test_it_stays_as_it_is(kind: str, data: Path, tmp_path: Path) -> None:
    made = training(kind, data, vision_backbone=folder("resnet", tmp_path / "model"), **FROZEN)
    before = {key: value.clone() for key, value in made.policy.eyes.state_dict().items()}
    learned = {id(p) for group in made.policy.get_optim_params() for p in group["params"]}

    made.warm_up()

    assert not made.policy.eyes.training
    assert all(torch.equal(value, before[key]) for key, value in made.policy.eyes.state_dict().items())
    assert learned.isdisjoint(map(id, made.policy.eyes.parameters()))
    assert not [module for module in made.policy.network.modules() if isinstance(module, Backbone)]


@pytest.mark.parametrize("frozen", [True, False])
def test_checkpoints_need_no_folder(frozen: bool, data: Path, tmp_path: Path) -> None:
    backbone = tmp_path / "model"
    settings = {"vision_backbone": folder("siglip", backbone), "freeze_vision_backbone": frozen}
    made = training("lisa", data, **settings).warm_up()
    for part in (made.policy, made.preprocessor, made.postprocessor):
        part.save_pretrained(tmp_path / "checkpoint")
    shutil.rmtree(backbone)

    loaded = type(made.policy).from_pretrained(tmp_path / "checkpoint")
    preprocess, _ = make_pre_post_processors(loaded.config, pretrained_path=str(tmp_path / "checkpoint"))
    analysed = load_checkpoint(load_config(str(tmp_path / "checkpoint"))).policy

    live = {CAMERA: torch.rand(1, 3, 8, 6), "observation.state": torch.rand(1, 3), "task": ["go"]}
    expected = made.policy.action_outputs(made.preprocessor(live))
    assert torch.equal(loaded.action_outputs(preprocess(live)), expected)
    assert torch.equal(analysed.action_outputs(preprocess(live)), expected)


def test_one_that_learns_is_the_one_from_the_folder(data: Path, tmp_path: Path) -> None:
    """For skill predictor and policy each."""
    backbone = folder("dinov2", tmp_path / "model")
    made = training("lisa", data, vision_backbone=backbone, shared_observation_encoder=False)
    expected = transformers.AutoModel.from_pretrained(backbone).state_dict()

    found = [module.model.model for module in made.policy.network.modules() if isinstance(module, Backbone)]

    assert len(found) == 2
    for model in found:
        assert all(torch.equal(value, expected[key]) for key, value in model.state_dict().items())
    made.policy.train().forward(made.batch(made.first_frames()))[0].backward()
    assert all(any(p.grad is not None and p.grad.abs().sum() > 0 for p in model.parameters()) for model in found)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"vision_backbone": "no/such-model"}, r"vision backbone 'no/such-model' is neither a folder nor .* Hub"),
        ({}, r"freeze_vision_backbone=true needs a --policy\.vision_backbone"),
        (
            {"vision_backbone": "resnet18", "normalization_mapping": {"VISUAL": "MEAN_STD"}},
            r"asked once for each frame, as it was recorded",
        ),
    ],
)
def test_what_cannot_be_is_one_line(settings: dict[str, Any], message: str, data: Path) -> None:
    with pytest.raises(UserError, match=message) as caught:
        training("lang_dt", data, **FROZEN, **settings)
    assert "\n" not in str(caught.value)


def test_a_model_of_text_is_one_line(encoder: Path, data: Path) -> None:
    with pytest.raises(UserError, match=r"a DistilBertModel cannot look at pictures alone .* choose a vision model"):
        training("lang_dt", data, vision_backbone=str(encoder), **FROZEN)


@pytest.mark.parametrize(
    ("noted", "message"),
    [
        ({"model_type": "dinov2", "num_hidden_layers": 10**6}, "more than 200 layers"),
        ({"model_type": "no such"}, "Unrecognized model identifier"),
        ({"image_size": 28}, "vision_model describes no encoder"),
    ],
)
def test_a_note_that_describes_no_backbone(noted: dict[str, Any], message: str, data: Path) -> None:
    """A checkpoint's config.json may come from anybody."""
    policy = training("lang_dt", data).policy
    policy.config.vision_backbone, policy.config.vision_model = "somebody/model", noted

    with pytest.raises(UserError, match=message):
        type(policy)(policy.config)
