"""Rows are differences: what they are made of can be read by LeRobot, and a mistake in one is a line."""

import json
from functools import cache
from pathlib import Path

import pytest
from lerobot.configs.train import TrainPipelineConfig
from lerobot_options import read_training

from lerobot_lisa.code_version import SAME_RESULTS
from lerobot_lisa.envs.babyai.levels import LEVELS
from lerobot_lisa.envs.lorel.random_floor import random_floor
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.envs.metaworld_states.tasks import find_tasks
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce import command
from lerobot_lisa.reproduce.command import main
from lerobot_lisa.reproduce.plan import Run, Settings, plan
from lerobot_lisa.reproduce.recipes import in_use
from lerobot_lisa.reproduce.rows import choose, find_configs, read_rows

ROWS = read_rows()
RUNS = plan(ROWS.values(), Settings(ROWS, Path("out")))


def trainings(runs: list[Run]) -> dict[str, tuple[str, ...]]:
    """Commands of all trainings by the policy and what they depend on."""
    steps = {step.key: step for run in runs for step in run.steps if step.kind == "train"}
    return {step.label: tuple(step.command) for step in steps.values()}


@cache
def read(words: tuple[str, ...]) -> TrainPipelineConfig:
    """What `lerobot-train` makes of its options."""
    path = next(word.partition("=")[2] for word in words if word.startswith("--config_path="))
    options = [word for word in words[1:] if not word.startswith(("--config_path=", "--policy.path="))]
    return read_training(path, *options)


def test_every_number_of_the_papers_tables_has_a_row() -> None:
    levels = {f"{level}_{size}" for level in ("gotoseq", "synthseq", "bosslevel") for size in ("1k", "10k", "100k")}
    assert {name for name in ROWS if name.startswith("table1.")} == {
        f"table1.{row}" for row in levels | {"lorel_states", "lorel_images"}
    }
    assert {name for name in ROWS if name.startswith("table3.")} == {f"table3.{row}" for row in levels}
    assert {"table2.compositions", "ablations.horizon_5", "ablations.skills_100", "appendix.lorel_tasks"} <= set(ROWS)
    assert ROWS["table1.gotoseq_1k"].paper["lisa"] == (59.4, 0.9)


def test_lerobot_reads_the_training_of_every_row() -> None:
    commands = trainings(RUNS)
    read_by_lerobot = {label: read(words) for label, words in commands.items() if label.endswith("seed 0")}

    assert len(read_by_lerobot) > 40
    boss = read(commands["table1.bosslevel_10k lisa seed 1"])
    assert (boss.seed, boss.steps, boss.batch_size) == (1, 3000, 32)
    assert (boss.policy.own_codebook_size, boss.policy.quantizer_warmup_steps) == (32, 1500)
    assert boss.env.task == "BossLevel"
    assert boss.dataset.repo_id == "local/bosslevel_10k"
    assert read_by_lerobot["ablations.horizon_50 lisa seed 0"].policy.horizon == 50
    assert all(not config.policy.push_to_hub for config in read_by_lerobot.values())


def test_warm_ups_end_halfway() -> None:
    """What to copy is learned before codes are placed, at every size of data."""
    for label, words in trainings(RUNS).items():
        if label.startswith("table1.") and "lorel" not in label and " lisa seed 0" in label:
            config = read(words)
            assert config.policy.quantizer_warmup_steps == config.steps // 2, label


def test_curves_begin_where_there_are_codes() -> None:
    """During the warm-up of a training from nothing the codebook is empty, and its checkpoints cannot be evaluated."""
    curves = [run for run in RUNS if "@" in run.policy and not run.row.start]
    assert curves
    for run in curves:
        config = read(tuple(run.steps[-2].command))
        assert int(run.policy.partition("@")[2]) > config.policy.quantizer_warmup_steps, run.row.name


def test_a_policy_may_be_evaluated_otherwise() -> None:
    """BabyAI's own network is slow to act, so fewer of its episodes are run."""
    heard = {run.policy: run.step.command for run in RUNS if run.row.name == "table1.gotoseq_1k" and run.seed == 0}
    assert "--n_episodes=500" in heard["lisa"]
    assert "--n_episodes=100" in heard["babyai_rnn"]


@pytest.mark.parametrize("row", [row for row in ROWS.values() if row.table == "table1"], ids=lambda row: row.name)
def test_lisa_and_lang_dt_differ_only_in_the_policy(row: object) -> None:
    """The comparison is of methods: same data, same number of steps, same rates."""
    commands = trainings([run for run in RUNS if run.row is row and run.seed == 0])
    lisa, lang_dt = (read(commands[f"{row.name} {policy} seed 0"]) for policy in ("lisa", "lang_dt"))

    for name in ("batch_size", "steps", "seed", "dataset", "env"):
        assert getattr(lisa, name) == getattr(lang_dt, name), name
    for name in ("optimizer_lr", "scheduler", "scheduler_warmup_steps", "dim_model", "n_heads", "language_encoder"):
        assert getattr(lisa.policy, name) == getattr(lang_dt.policy, name), name


def test_names_agree_with_what_is_made() -> None:
    for row in ROWS.values():
        level = row.data.get("level")
        if level and row.table in ("table1", "table3"):
            assert level in LEVELS
            assert row.name.partition(".")[2].split("_")[0] == level.lower()
            assert row.evaluate.get("env.task", row.evaluate.get("level")) == level
            assert row.title.startswith(f"{level} {row.data['episodes'] // 1000}k")


def test_rows_share_what_is_the_same() -> None:
    """Codes to spare are table 1's, so that ablation is no other training, and unseen words need its data."""
    chosen = {run.row.name: run for run in RUNS if run.seed == 0 and run.policy in ("lisa", "dataset")}
    of_table, of_ablation = chosen["table1.bosslevel_1k"], chosen["ablations.spare_codes"]
    assert of_table.steps[1].key == of_ablation.steps[1].key
    assert of_table.steps[1].key != chosen["ablations.horizon_5"].steps[1].key
    assert of_table.steps[0].folder == chosen["table3.bosslevel_1k"].steps[0].folder


def test_settings_that_are_in_use() -> None:
    settings = {"steps": 5, "seed": 0, "policy": {"horizon": 20, "termination_stride": 0, "skill_plan": None}}
    assert in_use(settings) == {"steps", "policy", "policy.horizon"}


def test_declared_changes_matter_where_a_row_has_their_option() -> None:
    """Otherwise the option is misspelled, and rows are taken for what they are not."""
    used = frozenset().union(*(in_use(step.depends.get("config", {})) for run in RUNS for step in run.steps))
    for change in json.loads(SAME_RESULTS.read_text(encoding="utf-8")):
        assert change.get("unless", "policy") in used


def test_estimates_know_what_a_policy_costs() -> None:
    """BabyAI's network trains 2,000 steps of GoToSeq in hours, as docs/baselines.md says, LISA in minutes."""
    chosen = {run.policy: run for run in RUNS if run.row.name == "table1.gotoseq_1k" and run.seed == 0}
    train = {policy: run.steps[1].seconds / 3600 for policy, run in chosen.items()}
    assert train["lisa"] == train["lang_dt"] < 0.5
    assert 2 < train["babyai_rnn"] < 3


def test_random_actions_are_those_of_the_world() -> None:
    for row in ROWS.values():
        if row.family == "lorel":
            floors = [random_floor(task) for task in SUITES[row.evaluate["env.task"]]]
            assert row.random == round(sum(floors) / len(floors), 1), row.name


def test_a_row_of_meta_world() -> None:
    """Its tasks, demonstrations without pictures, its own world."""
    data, train, heard = next(run.steps for run in RUNS if run.row.name == "ours.metaworld_mt10_states")
    assert data.command[:7] == [
        "python", "-m", "dataset_converters.metaworld", "collect", "--tasks=MT10", "--episodes=50", "--states-only"
    ]  # fmt: skip
    assert "--dataset.repo_id=local/mt10_states_50" in train.command
    assert {"--env.type=metaworld_states", "--env.task=MT10"} <= set(heard.command)
    assert {"metaworld", "mujoco"} == data.depends["versions"].keys()


def test_meta_world_from_pictures() -> None:
    """Pictures are made as small as the demonstrations', and all ten tasks are named: LeRobot has no MT10."""
    data, train, heard = next(run.steps for run in RUNS if run.row.name == "ours.metaworld_mt10")
    assert "--image-size=128" in data.command
    assert train.depends["config"]["policy"]["image_size"] == 128
    (named,) = (word.partition("=")[2] for word in heard.command if word.startswith("--env.task="))
    assert tuple(named.split(",")) == find_tasks("MT10")
    assert data.seconds > 30 * 60


def test_a_policy_without_a_recipe_is_told_of(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    like = "like: table1.bosslevel_1k\npolicies: [nobodys]\nseeds: [0]\npaper: {nobodys: 46}\n"
    (tmp_path / "mine" / "row.yaml").write_text(like)
    assert main(["--list", "mine.row", f"--own-rows={tmp_path}", f"--root={tmp_path}"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if " nobodys 0 " in line)
    assert "no recipe yet" in line
    assert line.rstrip().endswith("46")


@pytest.mark.parametrize(
    ("name", "near"),
    [("gotoseq_1k", "table1.gotoseq_1k"), ("table1.gotosec_10k", "table1.gotoseq_10k"), ("ablation", "ablations")],
)
def test_an_unknown_row_names_near_ones(name: str, near: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: there is no row or table {name!r}: do you mean ")
    assert near in error
    assert error.count("\n") == 1


def test_a_row_nobody_means_is_one_line_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["zzz"]) == 1
    assert capsys.readouterr().err == (
        "error: there is no row or table 'zzz': nothing is called nearly so (all: lisa-reproduce --list)\n"
    )


@pytest.mark.parametrize(
    ("row", "module", "extra"),
    [
        ("ours.gotolocal_1k", "minigrid", "babyai"),
        ("table1.lorel_states", "metaworld", "lorel"),
        ("ours.metaworld_mt10_states", "mujoco", "metaworld"),
        ("table2", "doit", "reproduce"),
    ],
)
def test_a_missing_extra_is_one_line_before_anything_runs(
    row: str,
    module: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None if name == module else name)
    assert main([row, f"--root={tmp_path / 'out'}"]) == 1
    assert capsys.readouterr().err == f'error: {module} is missing: pip install "lerobot_policy_lisa[{extra}]"\n'
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("like: table1.gotoseq_1k\nhorizon: 3\n", "`horizon` is no setting of a row"),
        ("like: tiny.bad\n", "goes round in circles"),
        ("like: table9.nothing\n", "No such file"),
        ("- 1\n", "a row is settings with names"),
        ("a: [\n", "bad.yaml"),
        ("title: x\n", "missing"),
        ("like: table1.gotoseq_1k\nevaluate: 5\n", "`evaluate` holds settings with names, not 5"),
        ("like: table1.gotoseq_1k\noptions: {all: 5}\n", "`options: all` holds settings with names, not 5"),
        ("like: table1.gotoseq_1k\nevaluate_by_policy: {lisa: [1]}\n", "`evaluate_by_policy: lisa` holds settings"),
        ("like: table1.gotoseq_1k\npaper: 59.4\n", "`paper` holds settings with names, not 59.4"),
    ],
)
def test_a_row_that_cannot_be_read_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "tiny").mkdir()
    (tmp_path / "tiny" / "bad.yaml").write_text(text)
    with pytest.raises(UserError) as refused:
        read_rows(tmp_path)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_table_is_all_of_its_rows() -> None:
    assert [row.name for row in choose(["table2", "table2.compositions"], ROWS)] == ["table2.compositions"]
    assert len(choose(["table1"], ROWS)) == 11


def test_recipes_are_no_near_copies() -> None:
    """One for each kind of data and policy; everything else is a row's difference."""
    recipes = find_configs().glob("babyai/*/lisa.yaml")
    assert {path.parent.name for path in recipes} == {"gotolocal_1k", "gotoseq_1k"}
