"""The original baselines as policies of LeRobot: BabyAI's recurrent network and LOReL's behaviour cloning."""

from pathlib import Path

import pytest
import tiny_checkpoints
import tiny_datasets
import torch
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from replay import NORMALISED, TASKS, actions_of, assert_rollout_is_training, live_observations
from tiny_policies import Training, config, training

from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.errors import UserError

KINDS = ["babyai_rnn", "lang_bc"]
EACH = pytest.mark.parametrize("kind", KINDS)
DATA = {"babyai_rnn": ["symbolic"], "lang_bc": ["symbolic", "continuous", "pictures"]}
EVERY = pytest.mark.parametrize(("kind", "data"), [(kind, data) for kind in KINDS for data in DATA[kind]])


@EVERY
def test_rollout_is_training(kind: str, data: str, request: pytest.FixtureRequest) -> None:
    settings = {} if data == "symbolic" else {"normalization_mapping": NORMALISED}
    made = training(kind, request.getfixturevalue(data), **settings).warm_up()

    assert_rollout_is_training(made, steps=14)


def test_rollouts_longer_than_any_training_episode(symbolic: Path) -> None:
    assert_rollout_is_training(training("babyai_rnn", symbolic).warm_up(), steps=60)


@EACH
def test_reset_and_another_instruction_forget(kind: str, symbolic: Path) -> None:
    """A batch of environments that were reset together; what only imitates what it sees has nothing to forget."""
    made = training(kind, symbolic).warm_up()
    observations = live_observations(made, 2, 8)
    first = actions_of(made, observations, range(8), TASKS[:2])
    continued = actions_of(made, observations, range(8), TASKS[:2])
    made.policy.reset()
    again = actions_of(made, observations, range(8), TASKS[:2])
    fresh = actions_of(made, observations, range(4, 8), [TASKS[2], TASKS[1]])

    made.policy.reset()
    alone = actions_of(made, observations, range(4, 8), [TASKS[2], TASKS[1]])

    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(fresh, alone, strict=True))
    remembers = not all(torch.allclose(a, b) for a, b in zip(first, continued, strict=True))
    assert remembers == (kind == "babyai_rnn")
    assert not torch.allclose(fresh[0], first[4])


@EACH
def test_rollouts_change_nothing_that_is_saved(kind: str, symbolic: Path) -> None:
    """Norms of BabyAI's network included."""
    made = training(kind, symbolic).warm_up()
    made.policy.train()
    before = {key: value.clone() for key, value in made.policy.state_dict().items()}

    actions_of(made, live_observations(made, 4, 10), range(10), TASKS)

    assert not made.policy.training
    assert all(torch.equal(before[key], value) for key, value in made.policy.state_dict().items())


@EVERY
def test_checkpoints_load_as_lerobot_loads_them(
    kind: str, data: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    make = getattr(tiny_checkpoints, kind)
    folder = make(request.getfixturevalue(data), tmp_path / kind)
    theirs = get_policy_class(kind).from_pretrained(folder, strict=True)
    before, after = make_pre_post_processors(theirs.config, pretrained_path=str(folder))

    policy, preprocess, postprocess, _ = load_checkpoint(load_config(str(folder)))

    assert not policy.training
    for step in range(3):
        torch.manual_seed(step)
        seen = {key: torch.rand(2, *feature.shape) for key, feature in theirs.config.input_features.items()}
        seen["task"] = TASKS[:2]
        ours = postprocess(policy.select_action(preprocess(seen)))
        assert torch.equal(ours, after(theirs.select_action(before(seen))))


@EACH
def test_resuming_is_exact(kind: str, symbolic: Path, tmp_path: Path) -> None:
    """Dropout and the statistics of norms included."""
    made = training(kind, symbolic, dropout=0.3).warm_up()
    made.policy.save_pretrained(tmp_path)
    cfg = type(made.policy.config).from_pretrained(tmp_path)
    cfg.pretrained_path = tmp_path
    torch.manual_seed(123)
    resumed = make_policy(cfg, ds_meta=made.dataset.meta)
    batch = made.batch(made.first_frames())

    losses = []
    for policy in (made.policy, resumed):
        policy.train()
        losses.append(policy.forward(batch)[0])

    assert torch.equal(*losses)
    mine, theirs = made.policy.state_dict(), resumed.state_dict()
    assert [key for key in mine if not torch.equal(mine[key], theirs[key])] == []


@EACH
def test_four_episodes_by_heart(kind: str, tmp_path: Path) -> None:
    root = tiny_datasets.symbolic(tmp_path / "data", lengths=[9, 14, 6, 11])
    made = training(kind, root, dropout=0.0)
    optimizer = torch.optim.Adam(made.policy.get_optim_params())
    for group in optimizer.param_groups:
        group["lr"] = 3e-3
    batch = made.batch(made.first_frames())
    made.policy.train()
    for _ in range(60):
        optimizer.zero_grad()
        loss, metrics = made.policy.forward(batch)
        loss.backward()
        optimizer.step()

    assert metrics["action_accuracy"] > 0.95
    assert metrics.keys() == {"action_loss", "action_accuracy"}


@EVERY
def test_every_parameter_is_in_one_group(kind: str, data: str, request: pytest.FixtureRequest) -> None:
    """And no table of actions is carried along that nothing looks at."""
    made = training(kind, request.getfixturevalue(data), optimizer_lr_language=1e-7)
    groups = made.policy.get_optim_params()

    handed_out = [id(parameter) for group in groups for parameter in group["params"]]
    assert sorted(handed_out) == sorted(id(parameter) for parameter in made.policy.parameters())
    assert {group["name"]: group["lr"] for group in groups} == {"policy": 1e-4, "language_encoder": 1e-7}
    assert not [name for name, _ in made.policy.named_parameters() if "head.embedding" in name]


def test_an_episodes_loss_is_its_own(symbolic: Path) -> None:
    made = training("babyai_rnn", symbolic).warm_up()
    made.policy.eval()

    each, _ = made.policy.forward(made.batch(made.first_frames([0, 4, 4])), reduction="none")
    alone = [made.policy.forward(made.batch(made.first_frames([i])), "none")[0][0] for i in (0, 4, 4)]

    torch.testing.assert_close(each, torch.stack(alone))


@EACH
def test_a_single_frame_dataset_trains(kind: str, tmp_path: Path) -> None:
    made = training(kind, tiny_datasets.symbolic(tmp_path / "data", lengths=[1]))
    loss, _ = made.policy.forward(made.batch([0]))
    assert torch.isfinite(loss)


def test_babyais_network_needs_a_grid(continuous: Path, symbolic: Path) -> None:
    with pytest.raises(UserError, match=r"a grid .* gets observation\.state: choose .*lang_bc") as caught:
        training("babyai_rnn", continuous)
    assert "\n" not in str(caught.value)
    made = training("babyai_rnn", symbolic)
    made.policy.config.feature_info = {"observation.grid": {"symbols": {"shape": [7, 7, 4], "channels": [{}, {}]}}}
    with pytest.raises(UserError, match="babyai_rnn sees a grid"):
        type(made.policy)(made.policy.config)


def test_a_grid_alone_is_enough(symbolic: Path, tmp_path: Path) -> None:
    features = {"observation.grid": tiny_datasets.GRID, "action": tiny_datasets.CLASSES}
    made = training("babyai_rnn", tiny_datasets.write(tmp_path / "data", features)).warm_up()

    assert made.policy.network.others is None
    assert_rollout_is_training(made, steps=5)


@EACH
def test_where_it_looked_is_not_known(kind: str, symbolic: Path) -> None:
    made: Training = training(kind, symbolic).warm_up()
    actions_of(made, live_observations(made, 4, 1), range(1), TASKS)

    assert made.policy.looks is None
    assert config(kind).augment is False
