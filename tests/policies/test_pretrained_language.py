"""A pretrained encoder from a folder: frozen or fine-tuned, and afterwards no longer needed."""

import shutil
from pathlib import Path

import pytest
import torch
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

    assert sum(asked) == 5  # six episodes, two of them with the same instruction
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
