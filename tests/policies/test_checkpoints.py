"""A checkpoint holds everything: weights, codebook, vocabulary, scaling."""

from pathlib import Path

import pytest
import torch
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim.optimizers import load_optimizer_state, save_optimizer_state
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from tiny_policies import Training, training

from lerobot_lisa.policies.base_modeling import EpisodePolicy

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
NORMALISED = {"STATE": NormalizationMode.MEAN_STD, "ACTION": NormalizationMode.MEAN_STD}


def saved(made: Training, folder: Path) -> Path:
    made.policy.save_pretrained(folder)
    made.preprocessor.save_pretrained(folder)
    made.postprocessor.save_pretrained(folder)
    return folder


@BOTH
@pytest.mark.parametrize("data", ["symbolic", "continuous", "pictures"])
def test_everything_comes_back_exactly(kind: str, data: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    settings = {} if data == "symbolic" else {"normalization_mapping": NORMALISED}
    made = training(kind, request.getfixturevalue(data), **settings).warm_up()
    folder = saved(made, tmp_path / "checkpoint")

    loaded = get_policy_class(kind).from_pretrained(folder, strict=True)
    preprocessor, postprocessor = make_pre_post_processors(loaded.config, pretrained_path=str(folder))

    mine, theirs = made.policy.state_dict(), loaded.state_dict()
    assert mine.keys() == theirs.keys()
    assert all(torch.equal(mine[key], theirs[key]) and mine[key].dtype == theirs[key].dtype for key in mine)
    if kind == "lisa":
        assert {"initted", "cluster_size", "embed_avg", "embed"} <= {key.split(".")[-1] for key in mine}
    live = {key: torch.rand(2, *feature.shape) for key, feature in loaded.config.input_features.items()}
    task = ["go to the red ball", "open a door"]
    expected = made.postprocessor(made.policy.select_action(made.preprocessor({**live, "task": task})))
    assert torch.equal(postprocessor(loaded.select_action(preprocessor({**live, "task": task}))), expected)


@BOTH
def test_weights_that_share_memory_are_saved(kind: str, symbolic: Path, tmp_path: Path) -> None:
    """As those of a recurrent network do on a GPU."""
    made = training(kind, symbolic).warm_up()
    weights = [value for name, value in made.policy.named_parameters() if ".gru." in name]
    whole = torch.cat([value.detach().reshape(-1) for value in weights])
    for value, part in zip(weights, whole.split([value.numel() for value in weights]), strict=True):
        value.data = part.view_as(value)

    loaded = get_policy_class(kind).from_pretrained(saved(made, tmp_path / "checkpoint"), strict=True)

    mine, theirs = made.policy.state_dict(), loaded.state_dict()
    assert len(weights) > 1
    assert all(torch.equal(mine[key], theirs[key]) for key in mine)


@BOTH
def test_training_goes_on_from_a_checkpoint(kind: str, continuous: Path, tmp_path: Path) -> None:
    """The next loss after loading is the one that would have come without it."""
    made = training(kind, continuous, dropout=0.0, normalization_mapping=NORMALISED).warm_up()
    folder = saved(made, tmp_path / "checkpoint")
    cfg = PreTrainedConfig.from_pretrained(folder)
    cfg.pretrained_path = folder
    loaded = make_policy(cfg, ds_meta=made.dataset.meta)
    batch = made.batch(made.first_frames())

    losses = []
    for policy in (made.policy, loaded):
        policy.train()
        losses.append(policy.forward(batch)[0])

    assert torch.equal(*losses)


def train(policy: EpisodePolicy, optimizer: torch.optim.Optimizer, batch: dict, steps: int) -> None:
    policy.train()
    for _ in range(steps):
        optimizer.zero_grad()
        policy.forward(batch)[0].backward()
        optimizer.step()


@BOTH
def test_resuming_is_exact_whatever_random_numbers_were_drawn_meanwhile(
    kind: str, symbolic: Path, tmp_path: Path
) -> None:
    """Dropout and the revival of codes included; revival is made certain by a threshold that no code reaches."""
    settings = {"dropout": 0.3, **({"dead_code_threshold": 1e3} if kind == "lisa" else {})}
    made = training(kind, symbolic, **settings)
    batch = made.batch(made.first_frames())
    optimizer = made.policy.config.get_optimizer_preset().build(made.policy.get_optim_params())
    train(made.policy, optimizer, batch, steps=2)
    folder = saved(made, tmp_path / "checkpoint")
    save_optimizer_state(optimizer, tmp_path)
    train(made.policy, optimizer, batch, steps=3)

    torch.manual_seed(123)
    cfg = PreTrainedConfig.from_pretrained(folder)
    cfg.pretrained_path = folder
    resumed = make_policy(cfg, ds_meta=made.dataset.meta)
    optimizer = cfg.get_optimizer_preset().build(resumed.get_optim_params())
    train(resumed, load_optimizer_state(optimizer, tmp_path), batch, steps=3)

    mine, theirs = made.policy.state_dict(), resumed.state_dict()
    assert [key for key in mine if not torch.equal(mine[key], theirs[key])] == []


def test_steps_draw_differently_and_leave_others_alone(symbolic: Path) -> None:
    """What a step draws hangs on its frames in their order, even where other frames stand for the same episodes."""
    made = training("lang_dt", symbolic, dropout=0.5)
    first, second, third = (made.batch([start + i for start in made.first_frames([0, 2, 4])]) for i in range(3))
    made.policy.train()
    before = torch.get_rng_state()

    losses = [made.policy.forward(batch)[0].item() for batch in (first, second, third, first)]

    assert len(set(losses)) == 3
    assert losses[0] == losses[3]
    assert torch.equal(before, torch.get_rng_state())
    assert not any("random" in key or "seed" in key for key in made.policy.state_dict())


@BOTH
def test_a_model_card_is_made(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic)

    card = made.policy.generate_model_card("local/tiny", kind, None, None, None, made.dataset.meta)

    assert "2203.00054" in str(card)
    assert card.data.license == "apache-2.0"
