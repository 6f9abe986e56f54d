"""The original baselines as policies of LeRobot: they act as they train, learn, load, and say what they cannot do."""

from pathlib import Path

import pytest
import tiny_checkpoints
import tiny_datasets
import torch
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from replay import (
    NORMALISED,
    TASKS,
    actions_of,
    assert_rollout_is_training,
    assert_rollouts_change_nothing,
    live_observations,
    step_batch,
)
from tiny_policies import Training, config, training

from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.errors import UserError

KINDS = ["babyai_rnn", "lang_bc"]
EACH = pytest.mark.parametrize("kind", KINDS)
DATA = {"babyai_rnn": ["symbolic"], "lang_bc": ["symbolic", "continuous", "pictures"]}
IMITATE = [(kind, data) for kind in KINDS for data in DATA[kind]]
EVERY = pytest.mark.parametrize(("kind", "data"), IMITATE)


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
    assert_rollouts_change_nothing(training(kind, symbolic).warm_up())


@pytest.mark.parametrize(("kind", "data"), [*IMITATE, ("lorel_planner", "continuous"), ("kmeans_skills", "symbolic")])
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
    groups, rate = made.policy.get_optim_params(), 3e-4 if data == "pictures" else 1e-4

    handed_out = [id(parameter) for group in groups for parameter in group["params"]]
    assert sorted(handed_out) == sorted(id(parameter) for parameter in made.policy.parameters())
    assert {group["name"]: group["lr"] for group in groups} == {"policy": rate, "language_encoder": 1e-7}
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


# LOReL's planner.


def test_the_planner_trains_and_plans(continuous: Path) -> None:
    made = training("lorel_planner", continuous).warm_up()
    made.policy.train()
    _, metrics = made.policy.forward(made.batch(made.first_frames()))
    losses, _ = made.policy.forward(made.batch(made.first_frames()), reduction="none")
    observations = live_observations(made, 2, 3)
    made.policy.reset()
    first = [made.policy.select_action(step_batch(made, observations, step, TASKS[:2])) for step in range(3)]
    made.policy.reset()
    second = [made.policy.select_action(step_batch(made, observations, step, TASKS[:2])) for step in range(3)]
    made.policy.reset()
    made.policy.rollouts = 0
    again = [made.policy.select_action(step_batch(made, observations, step, TASKS[:2])) for step in range(3)]

    assert metrics.keys() == {"model_loss", "judge_loss", "judge_accuracy"}
    assert losses.shape == (len(tiny_datasets.LENGTHS),)
    assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))
    assert not torch.equal(first[0], second[0])  # another rollout searches with other random numbers
    bounds = made.policy.network.head.bounds
    assert all((action >= bounds[0]).all() and (action <= bounds[1]).all() for action in first)


def test_a_planner_that_plans_within_a_frame_of_data(tmp_path: Path) -> None:
    features = {"observation.state": tiny_datasets.STATE, "action": tiny_datasets.MOVE}
    made = training("lorel_planner", tiny_datasets.write(tmp_path / "data", features, lengths=[1]))
    loss, metrics = made.policy.forward(made.batch([0]))
    assert loss == 0
    assert metrics["judge_accuracy"] == 0


@pytest.mark.parametrize("data", ["symbolic", "pictures"])
def test_a_planner_needs_states(data: str, request: pytest.FixtureRequest) -> None:
    with pytest.raises(UserError, match=r"lorel_planner imagines states, and has no model of `observation\.") as caught:
        training("lorel_planner", request.getfixturevalue(data))
    assert "\n" not in str(caught.value)


def test_more_elites_than_plans() -> None:
    with pytest.raises(UserError, match=r"--policy\.plan_elites=30 are the best of --policy\.plan_samples=20"):
        config("lorel_planner", plan_elites=30)


# Skills by k-means.


@pytest.mark.parametrize("data", ["symbolic", "continuous"])
def test_rollouts_with_kmeans_skills_are_training(data: str, request: pytest.FixtureRequest) -> None:
    settings = {} if data == "symbolic" else {"normalization_mapping": NORMALISED}
    made = training("kmeans_skills", request.getfixturevalue(data), **settings).warm_up()

    assert made.policy.n_codes == 5
    assert_rollout_is_training(made, steps=14)


def test_kmeans_clusters_the_whole_dataset_once(symbolic: Path) -> None:
    made, others = (training("kmeans_skills", symbolic) for _ in range(2))
    made.policy.train()
    made.policy.forward(made.batch(made.first_frames([0])))
    centers = made.policy.network.quantizer.centers.clone()
    vectors = made.policy._vectors(made.batch([0]))
    before = torch.get_rng_state()
    others.policy.train()
    others.policy.forward(others.batch(others.first_frames([3])))  # whatever it is trained on first
    made.warm_up(3)

    assert vectors.shape == (sum(tiny_datasets.LENGTHS), 32 + 148)
    assert torch.equal(made.policy.network.quantizer.centers, centers)
    assert torch.equal(others.policy.network.quantizer.centers, centers)
    assert torch.equal(before, torch.get_rng_state())
    nearest = torch.cdist(vectors, centers).argmin(1)
    for code in nearest.unique():  # k-means has come to rest
        torch.testing.assert_close(vectors[nearest == code].mean(0), centers[code], atol=1e-4, rtol=1e-4)


def test_kmeans_learns_nothing_of_language_and_what_it_clusters(symbolic: Path) -> None:
    made = training("kmeans_skills", symbolic).warm_up()
    loss, metrics = made.policy.forward(made.batch(made.first_frames()))
    loss.backward()

    learned = {name.split(".")[1] for name, p in made.policy.named_parameters() if p.grad is not None and p.grad.any()}
    assert learned == {"observations", "skill_embedding", "action_predictor"}
    assert {"codes_used", "perplexity", "mutual_information"} <= metrics.keys()


def test_kmeans_skills_can_be_steered_and_loaded(symbolic: Path, tmp_path: Path) -> None:
    folder = tiny_checkpoints.kmeans_skills(symbolic, tmp_path / "kmeans")
    policy, preprocess, _, _ = load_checkpoint(load_config(str(folder), ["--skill_plan=4"]))
    seen = {key: torch.ones(2, *feature.shape) for key, feature in policy.config.input_features.items()}
    policy.select_action(preprocess({**seen, "task": TASKS[:2]}))

    assert policy.skill_codes.tolist() == [4, 4]
    assert policy.code_labels is None


@pytest.mark.parametrize(
    "setting", [{"copy_words": True}, {"quantizer": "fsq"}, {"n_code_parts": 2}, {"skill_predictor": "mlp"}]
)
def test_what_only_learned_skills_can_do(setting: dict[str, object], symbolic: Path) -> None:
    with pytest.raises(UserError, match=rf"--policy\.{next(iter(setting))}=.* skills of kmeans_skills are not learned"):
        config("kmeans_skills", **setting)


def test_kmeans_wants_no_pictures(pictures: Path) -> None:
    with pytest.raises(UserError, match="clusters states and symbols"):
        training("kmeans_skills", pictures)
