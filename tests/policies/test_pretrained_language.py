"""A pretrained encoder from a folder: frozen or fine-tuned, and afterwards no longer needed."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
import transformers
from lerobot.policies.factory import make_pre_post_processors
from safetensors import safe_open
from tiny_policies import Training, config, training
from torch import Tensor
from transformers import DistilBertModel

from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])


def one_step(made: Training) -> dict[str, Tensor]:
    """A training step; returns the language model's weights from before it."""
    model = made.policy.network.language.encoder.model
    before = {key: value.clone() for key, value in model.state_dict().items()}
    optimizer = made.policy.config.get_optimizer_preset().build(made.policy.get_optim_params())
    made.policy.train()
    made.policy.forward(made.batch(made.first_frames()))[0].backward()
    optimizer.step()
    return before


@BOTH
def test_weights_come_from_the_folder(kind: str, encoder: Path, symbolic: Path) -> None:
    made = training(kind, symbolic, language_encoder=str(encoder))
    model, expected = made.policy.network.language.encoder.model, DistilBertModel.from_pretrained(encoder)

    assert all(torch.equal(model.state_dict()[key], value) for key, value in expected.state_dict().items())
    batch = made.batch(made.first_frames([0]))
    assert batch["observation.language.tokens"].tolist() == [[2, 4, 5, 6, 7, 8, 3]]


@BOTH
def test_frozen(kind: str, encoder: Path, symbolic: Path) -> None:
    made = training(kind, symbolic, language_encoder=str(encoder), freeze_language_encoder=True)
    model = made.policy.network.language.encoder.model
    asked: list[int] = []
    model.register_forward_hook(
        lambda module, args, kwargs, out: asked.append(len(kwargs["input_ids"])), with_kwargs=True
    )

    before = one_step(made)
    one_step(made)

    names = len(set(map(tuple, made.policy.network.language.name_tokens.tolist())))  # of things; many are one unknown
    assert sum(asked) == 5 + names  # six episodes, two of them with the same instruction
    assert all(parameter.grad is None and not parameter.requires_grad for parameter in model.parameters())
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())
    assert not model.training


@BOTH
def test_fine_tuned(kind: str, encoder: Path, symbolic: Path) -> None:
    made = training(kind, symbolic, language_encoder=str(encoder))
    before = one_step(made)

    group = next(g for g in made.policy.get_optim_params() if g["name"] == "language_encoder")
    model = made.policy.network.language.encoder.model
    assert group["lr"] == 1e-6
    assert {id(p) for p in group["params"]} == {id(p) for p in model.parameters()}
    changed = [key for key, value in model.state_dict().items() if not torch.equal(value, before[key])]
    assert any("attention" in key for key in changed)
    for key in changed:  # Adam's first step is the rate itself
        assert (model.state_dict()[key] - before[key]).abs().max() < 1.1e-6 + 1e-7


@BOTH
@pytest.mark.parametrize("frozen", [False, True])
def test_checkpoints_need_no_folder(kind: str, frozen: bool, encoder: Path, symbolic: Path, tmp_path: Path) -> None:
    made = training(kind, symbolic, language_encoder=str(encoder), freeze_language_encoder=frozen).warm_up()
    one_step(made)
    checkpoint = tmp_path / "checkpoint"
    made.policy.save_pretrained(checkpoint)
    made.preprocessor.save_pretrained(checkpoint)
    made.postprocessor.save_pretrained(checkpoint)
    shutil.rmtree(encoder)

    loaded = type(made.policy).from_pretrained(checkpoint)
    preprocessor, _ = make_pre_post_processors(loaded.config, pretrained_path=str(checkpoint))

    mine, theirs = made.policy.state_dict(), loaded.state_dict()
    assert mine.keys() == theirs.keys()
    assert all(torch.equal(mine[key], theirs[key]) for key in mine)
    live = {"observation.grid": torch.ones(2, 147), "observation.direction": torch.ones(2, 1)}
    tasks = ["go to the red ball", "open"]
    expected = made.policy.action_outputs(made.preprocessor({**live, "task": tasks}))
    assert torch.equal(loaded.action_outputs(preprocessor({**live, "task": tasks})), expected)
    with safe_open(checkpoint / "model.safetensors", "pt") as file:
        assert any("transformer" in key for key in file.keys())  # noqa: SIM118


SMALL = {"hidden_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 32}


def replaced(encoder: Path, model: Any) -> str:
    """Another model under the same tokenizer."""
    (encoder / "model.safetensors").unlink()
    model.save_pretrained(encoder)
    return str(encoder)


@pytest.mark.parametrize("name", ["T5EncoderModel", "T5ForConditionalGeneration", "CLIPTextModel", "GPT2Model"])
def test_other_encoders_of_text(name: str, encoder: Path, symbolic: Path, tmp_path: Path) -> None:
    """Of T5 only the encoder is taken, and it comes back from a checkpoint."""
    kinds = {
        "T5": transformers.T5Config(vocab_size=40, d_model=32, d_ff=32, d_kv=16, num_layers=1, num_heads=2),
        "CL": transformers.CLIPTextConfig(vocab_size=40, max_position_embeddings=20, **SMALL),
        "GP": transformers.GPT2Config(vocab_size=40, n_embd=32, n_layer=1, n_head=2),
    }
    path = replaced(encoder, getattr(transformers, name)(kinds[name[:2]]))
    made = training("lang_dt", symbolic, language_encoder=path).warm_up()
    assert not any("decoder" in key for key in made.policy.state_dict())
    made.policy.save_pretrained(tmp_path / "checkpoint")

    loaded = type(made.policy).from_pretrained(tmp_path / "checkpoint")

    batch = made.preprocessor(
        {"observation.grid": torch.ones(1, 147), "observation.direction": torch.ones(1, 1), "task": "go"}
    )
    assert torch.equal(loaded.action_outputs(batch), made.policy.action_outputs(batch))


def test_of_clip_the_half_that_reads(encoder: Path, symbolic: Path, tmp_path: Path) -> None:
    image = {**SMALL, "image_size": 32, "patch_size": 16}
    text = {"vocab_size": 40, "max_position_embeddings": 20, **SMALL}
    whole = transformers.CLIPModel(transformers.CLIPConfig(text_config=text, vision_config=image))
    made = training("lisa", symbolic, language_encoder=replaced(encoder, whole)).warm_up()

    read = made.policy.network.language.encoder.model.state_dict()
    assert read
    assert not [key for key in made.policy.state_dict() if "vision" in key]
    expected = whole.text_model.state_dict()
    assert all(torch.equal(value, expected[key.removeprefix("text_model.")]) for key, value in read.items())


def test_a_model_that_reads_no_text_alone(encoder: Path, symbolic: Path) -> None:
    image = {**SMALL, "image_size": 32, "patch_size": 16}
    model = transformers.ViTModel(transformers.ViTConfig(**image))
    with pytest.raises(UserError, match="a ViTModel cannot read instructions alone: choose an encoder of text"):
        training("lisa", symbolic, language_encoder=replaced(encoder, model))


@pytest.mark.parametrize(
    ("noted", "message"),
    [
        (
            {"model_type": "distilbert", "dim": 65_536, "hidden_dim": 65_536, "n_heads": 2},
            "parameters, 2e\\+09 is the most",
        ),
        ({"model_type": "bert", "num_hidden_layers": 10**6}, "more than 200 layers"),
        ({"model_type": "no such"}, "Unrecognized model identifier"),
        ({"dim": 32}, "describes no encoder"),
        ({"model_type": "distilbert", "dim": -3}, "describes no encoder"),
        ({"model_type": "distilbert", "dim": "wide"}, "describes no encoder"),
    ],
)
def test_a_note_of_an_encoder_that_would_fill_the_memory(noted: dict[str, Any], message: str, symbolic: Path) -> None:
    """A checkpoint's config.json may come from anybody."""
    policy = training("lang_dt", symbolic).policy
    policy.config.language_encoder, policy.config.language_model = "somebody/model", noted

    with pytest.raises(UserError, match=message) as caught:
        type(policy)(policy.config)
    assert "\n" not in str(caught.value)


@BOTH
def test_a_missing_encoder_is_a_user_error(kind: str, symbolic: Path) -> None:
    with pytest.raises(
        UserError, match=r"language encoder 'no/such-model' is neither .* --policy\.language_encoder=words"
    ):
        training(kind, symbolic, language_encoder="no/such-model")


def test_a_folder_without_a_tokenizer_is_a_user_error(encoder: Path, symbolic: Path) -> None:
    for file in encoder.glob("tokenizer*"):
        file.unlink()

    with pytest.raises(UserError, match="knows no word"):
        training("lisa", symbolic, language_encoder=str(encoder))


def test_the_default_is_the_papers_encoder() -> None:
    assert type(config("lisa"))().language_encoder == "distilbert-base-uncased"
