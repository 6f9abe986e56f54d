"""Steps: done once, stale when what they depend on changes, gone on with after whatever ends them."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lerobot_lisa import code_version
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce import outcomes, run
from lerobot_lisa.reproduce import plan as planning
from lerobot_lisa.reproduce.outcomes import NOT_RUN, RUN, STALE, STARTED, keep, read_published, state
from lerobot_lisa.reproduce.perform import perform
from lerobot_lisa.reproduce.plan import Run, Settings, plan
from lerobot_lisa.reproduce.results import publish
from lerobot_lisa.reproduce.slurm import stages
from lerobot_lisa.reproduce.steps import NOTE, Step, difference
from lerobot_lisa.reproduce.tables import by_policy

Writes = Callable[..., Step]


def content(step: Step) -> str:
    return (step.folder / step.result).read_text()


def test_a_step_is_done_once_and_says_how(writes: Writes) -> None:
    step = writes("a")
    for _ in range(2):
        assert run.run_here([step], 1) == []
    assert content(step) == "x"
    note = json.loads((step.folder / NOTE).read_text())
    assert note["command"].startswith("python -c ")
    assert note["commit"] == code_version.commit()
    assert note["depends"] == {"name": "a"}


def test_another_configuration_is_another_result(writes: Writes) -> None:
    before, now = writes("a", horizon=10), writes("a", horizon=5)
    run.run_here([before], 1)
    assert now.note is None
    run.run_here([now], 1)
    assert before.folder != now.folder
    assert content(before) == "x"  # nothing is lost


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_needs_another_waits_for_it(writes: Writes, jobs: int) -> None:
    first = writes("first", "time.sleep(0.3)")
    second = writes("second", f"assert pathlib.Path({str(first.folder / NOTE)!r}).is_file()", (first,))
    assert run.run_here([second, writes("third")], jobs) == []
    assert content(second) == "x"


def test_a_failure_is_a_line_and_others_go_on(writes: Writes) -> None:
    failing = writes("failing", "sys.exit('no such thing')")
    needing, other = writes("needing", "", (failing,)), writes("other")
    failures = run.run_here([needing, other], 1)
    assert len(failures) == 1
    assert failures[0].startswith("failing: `python` ended with exit code 1: no such thing (all of it: ")
    assert content(other) == "x"
    assert needing.note is None


def test_two_processes_do_not_do_the_same(writes: Writes) -> None:
    step = writes("a")
    step.folder.mkdir(parents=True)
    from filelock import FileLock

    with FileLock(step.folder / "lock"), pytest.raises(UserError, match="another process is at work"):
        perform(step)


def test_training_goes_on_from_its_last_checkpoint(writes: Writes) -> None:
    step = replace(writes("a"), going_on="run/train_config.json")
    assert step.next_command == step.command
    saved = step.folder / step.going_on
    saved.parent.mkdir(parents=True)
    saved.touch()
    assert step.next_command == ["lerobot-train", f"--config_path={saved}", "--resume=true"]


def test_training_without_a_checkpoint_begins_anew(writes: Writes) -> None:
    """LeRobot refuses a folder that is there."""
    step = replace(writes("a"), going_on="run/checkpoints/last/train_config.json")
    (step.folder / "run" / "half").mkdir(parents=True)
    perform(step)
    assert not (step.folder / "run").exists()


def test_an_interruption_ends_the_program_and_leaves_no_note(writes: Writes, monkeypatch: pytest.MonkeyPatch) -> None:
    step = writes("a", "print('step:1 of many', flush=True); time.sleep(60)")

    def interrupted(_: str) -> None:
        if "step:1" in _:
            raise KeyboardInterrupt

    monkeypatch.setattr(run, "_say", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.run_here([step], 1)
    assert step.note is None
    assert not (step.folder / step.result).exists()


def finished(of: Run, percent: float = 50.0) -> None:
    """Write what the run's commands would."""
    for step in of.steps:
        result = step.folder / step.result
        result.parent.mkdir(parents=True, exist_ok=True)
        rate = {"successes": 1, "episodes": 2, "percent": percent, "low": 1.0, "high": 99.0}
        env = {"type": "babyai", "task": "GoToLocal", "max_episode_steps": 15}
        result.write_text(json.dumps({"rates": {"overall": {"success": rate}}, "evaluation": {"env": env}}))
        step.write_note("abc1234", 60)


def test_a_changed_row_makes_its_results_stale(settings: Settings) -> None:
    row = settings.rows["tiny.gotolocal"]
    before = plan([row], settings)[0]
    assert state(before, settings, []).word == NOT_RUN
    finished(before)
    assert state(before, settings, []).word == RUN
    keep([before], settings)

    options = {**row.options, "all": {**row.options["all"], "steps": 301}}
    after = plan([replace(row, options=options)], settings)[0]

    at = state(after, settings, [])
    assert (at.word, at.why) == (STALE, "config.steps 300 -> 301")
    assert at.outcome is not None
    assert at.outcome["commit"] == "abc1234"
    assert after.step is not None
    assert after.step.note is None  # it is shown, and not used


def test_other_code_makes_results_stale(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    before = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    finished(before)
    keep([before], settings)
    monkeypatch.setattr(code_version, "_meaning", lambda path, _: f"{path.name} means something else")

    at = state(plan([settings.rows["tiny.gotolocal"]], settings)[0], settings, [])

    assert at.word == STALE
    assert at.why.startswith("code of ")
    assert "networks" in at.why


def test_what_is_begun_says_how_far_it_is(settings: Settings) -> None:
    begun = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    (begun.steps[0].folder / "data" / "meta").mkdir(parents=True)
    (begun.steps[0].folder / begun.steps[0].result).touch()
    begun.steps[0].write_note("abc1234", 1)
    begun.steps[1].folder.mkdir(parents=True)
    assert state(begun, settings, [])[::2] == (STARTED, "1 of 3 steps done")


def test_published_runs_count_where_nothing_was_made_here(settings: Settings) -> None:
    run_here = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    assert run_here.step is not None
    published = {"name": "tiny.gotolocal", "policy": "lisa", "seed": 0, "depends": dict(run_here.step.depends)}
    assert state(run_here, settings, [published]).word == RUN
    by_hand = {
        "row": "GoToLocal tiny", "policy": "lisa", "seed": 0, "commit": "3b4ad07", "env": {"max_episode_steps": 15}
    }  # fmt: skip
    assert state(run_here, settings, [by_hand])[::2] == (STALE, "made before rows had files")


def test_runs_are_published_in_the_place_of_those_before(settings: Settings, tmp_path: Path) -> None:
    folder = tmp_path / "checkout" / "docs" / "results" / "babyai"
    folder.mkdir(parents=True)
    by_hand = {
        "row": "GoToLocal tiny", "policy": "lisa", "seed": 0, "commit": "3b4ad07", "env": {"max_episode_steps": 15}
    }  # fmt: skip
    (folder / "old.json").write_text(json.dumps(by_hand))
    done = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    finished(done)

    (path,) = publish([(done, state(done, settings, []))], tmp_path / "checkout")

    assert [each.name for each in folder.iterdir()] == [path.name] == ["tiny.gotolocal_lisa_seed0.json"]
    kept = json.loads(path.read_text())
    assert (kept["commit"], kept["env"]["max_episode_steps"]) == ("abc1234", 15)
    assert kept["commands"]["train"].startswith("lerobot-train --config_path=")
    assert str(tmp_path) not in path.read_text()
    table = by_policy(read_published(folder.parent), [settings.rows["tiny.gotolocal"]])
    assert "| GoToLocal tiny | 15 | LISA | **50.0 %**" in table
    assert "| 50 ± 1.5 % | [abc1234](results/babyai/tiny.gotolocal_lisa_seed0.json) |" in table
    assert "| GoToLocal tiny | 15 | Lang-DT | not run |" in table


def test_what_nobody_else_could_make_is_not_published(settings: Settings, tmp_path: Path) -> None:
    (tmp_path / "docs" / "results").mkdir(parents=True)
    done = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    finished(done)
    done.steps[1].write_note("abc1234+changes", 60)
    with pytest.raises(UserError, match="train was made with changes that are not committed"):
        publish([(done, state(done, settings, []))], tmp_path)


def test_where_nothing_has_been_run_nothing_is_published(settings: Settings, tmp_path: Path) -> None:
    (tmp_path / "docs" / "results").mkdir(parents=True)
    left = plan([settings.rows["tiny.gotolocal"]], settings)[0]
    with pytest.raises(UserError, match="none of these rows has been run here"):
        publish([(left, state(left, settings, []))], tmp_path)


def test_bits_of_a_training_are_kept_with_its_numbers(settings: Settings) -> None:
    one, _ = plan([settings.rows["tiny.gotolocal"]], settings)
    assert outcomes._information(one) == []  # no log
    log = next(step.folder for step in one.steps if step.kind == "train") / "log.txt"
    log.parent.mkdir(parents=True, exist_ok=True)
    first, second = "step:100 smpl:1 loss:0.5", "step:200 smpl:2 loss:0.4 mutual_information:1.25"
    log.write_text(f"'log_freq': 100\n{first}\n{second}\n")
    assert outcomes._information(one) == [(200, 1.25)]  # codes are placed after a while
    log.write_text(f"'log_freq': 100\n{second}\n")
    assert outcomes._information(one) == []  # not from the first step on
    log.write_text(f"'log_freq': 100\n{first}\n{second}\n{second}\n{second}\n")
    assert outcomes._information(one) == []  # more steps than there were: gone on with, some are told twice


def test_stages_of_a_cluster_wait_for_one_another(settings: Settings) -> None:
    runs = plan([settings.rows["tiny.gotolocal"]], settings)
    whole = stages([run.step for run in runs if run.step])
    assert [[step.kind for step in stage] for stage in whole] == [["data"], ["train", "train"], ["heard", "heard"]]
    finished(runs[0])
    assert [len(stage) for stage in stages([run.step for run in runs if run.step])] == [1, 1]


def test_comments_and_layout_mean_nothing(tmp_path: Path) -> None:
    texts = ['"""Says one."""\nx = 1  # one\n', "x = (\n    1\n)\n", "x = 2\n"]
    files = [tmp_path / f"{number}.py" for number in range(3)]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text)
    one, same, other = map(code_version._meaning, files)
    assert one == same != other


def test_a_release_for_another_device_is_the_same_release(monkeypatch: pytest.MonkeyPatch) -> None:
    releases = {"torch": "2.11.0+cu130", "transformers": "5.5.4"}
    monkeypatch.setattr(planning, "version", releases.__getitem__)
    assert planning._versions(*releases) == {"torch": "2.11.0", "transformers": "5.5.4"}


def test_code_that_is_not_imported_changes_nothing() -> None:
    used = code_version._closure(("lerobot_lisa.policies.lang_dt.modeling_lang_dt",))
    assert "lerobot_lisa.networks.lang_dt" in used
    assert "lerobot_lisa.networks.lisa" not in used
    assert set(code_version.fingerprint(["lerobot_lisa.policies.lisa.modeling_lisa"])) >= {"networks", "episodes"}


def test_differences_are_told_in_a_few_words() -> None:
    before = {"config": {"steps": 1, "policy": {"horizon": 5}}, "code": {"networks": "a"}}
    now = {"config": {"steps": 2, "policy": {"horizon": 5}}, "code": {"networks": "b"}}
    assert difference(before, now) == "config.steps 1 -> 2, code of networks"
    many = {f"n{number}": number for number in range(9)}
    assert difference(many, {}).endswith(", 6 settings more")
