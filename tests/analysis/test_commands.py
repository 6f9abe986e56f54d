"""Every command of the analysis: what the file system or the parser refuses takes one line; nothing is left over."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from lerobot_lisa.analysis import lorel_random_floor, unseen
from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.control import rollout
from lerobot_lisa.analysis.report import command as report
from lerobot_lisa.analysis.skills import __main__ as skills
from lerobot_lisa.analysis.success import __main__ as success
from lerobot_lisa.analysis.success.__main__ import SuccessConfig
from lerobot_lisa.analysis.training import __main__ as training

COMMANDS = [rollout, report, unseen, skills, success, training, lorel_random_floor]
LEVEL = ["--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=4", "--n_episodes=1"]


@pytest.fixture
def refusal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that ends with exit code 1; returns its one line."""

    def refused(command: ModuleType, *options: str) -> str:
        monkeypatch.setattr("sys.argv", ["command", *options])
        assert command.main() == 1
        *_, last = capsys.readouterr().err.splitlines()
        assert last.startswith("error: ")
        return last

    return refused


def test_an_output_that_cannot_be_a_folder(lisa: Path, tmp_path: Path, refusal: Callable[..., str]) -> None:
    (tmp_path / "file").write_text("precious")
    for command in (rollout, report):
        for output in (tmp_path / "file", tmp_path / "file" / "inside"):
            assert "Not a directory" in refusal(command, f"--policy.path={lisa}", *LEVEL, f"--output_dir={output}")
        long = refusal(command, f"--policy.path={lisa}", *LEVEL, f"--output_dir={tmp_path / ('n' * 5000)}")
        assert "File name too long" in long
        assert len(long) < 300
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("file", "precious")]


def test_links_that_lead_nowhere(lisa: Path, tmp_path: Path, refusal: Callable[..., str]) -> None:
    nothing, loop = tmp_path / "nothing", tmp_path / "loop"
    nothing.symlink_to("absent")
    loop.symlink_to("loop")
    for command, output in ((rollout, nothing), (rollout, loop), (report, nothing)):
        said = refusal(command, f"--policy.path={lisa}", *LEVEL, f"--output_dir={output}")
        assert said == f"error: {output}: a link that leads nowhere: delete it, or make what it names"
    said = refusal(report, f"--policy.path={lisa}", *LEVEL, f"--output_dir={loop}")  # makes a folder in it
    assert said == f"error: {loop}/trace: Too many levels of symbolic links"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["loop", "nothing"]


def test_a_folder_that_may_not_be_written(lisa: Path, refusal: Callable[..., str]) -> None:
    said = refusal(rollout, f"--policy.path={lisa}", *LEVEL, "--output_dir=/proc/nowhere")
    assert said.startswith("error: /proc/nowhere: ")


def test_a_full_disk_in_the_middle_of_an_evaluation(
    lisa: Path, tmp_path: Path, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "steps.parquet.partial")

    monkeypatch.setattr("pyarrow.parquet.write_table", full)
    options = [f"--policy.path={lisa}", *LEVEL, "--n_videos=0", f"--output_dir={tmp_path / 'out'}"]
    assert refusal(rollout, *options) == "error: steps.parquet.partial: No space left on device"
    monkeypatch.undo()
    monkeypatch.setattr("sys.argv", ["lisa-rollout", *options])
    assert rollout.main() == 0  # goes on when there is room again


def test_what_the_file_system_says_without_a_name(tmp_path: Path, refusal: Callable[..., str]) -> None:
    (tmp_path / "eval_info.json").write_text('{"per_task": [{"task_group": "a", "task_id": 0, "metrics": '
                                             '{"successes": [true]}}]}')  # fmt: skip
    said = refusal(success, str(tmp_path / "eval_info.json"), "--json=/dev/full")
    assert said == "error: No space left on device"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--seed=abc"], "Couldn't parse 'abc' into an int"),
        ([f"--seed={2**70}"], "--seed=a number of more than 20 digits: give a number from 0 to"),
        (["--seed=-1"], "--seed=-1: give a number from 0 to"),
        (["--n_episodes=-3"], "--n_episodes=-3: give a number from 1 to"),
        ([f"--batch_size={10**9}"], "--batch_size=1000000000: give a number from 1 to"),
        (
            ["--skill=" + "1" * 5000],
            "error: --skill is no YAML, which LeRobot takes options for: Exceeds the limit (4300",
        ),
        (["--plan", "*20"], "error: --plan is no YAML, which LeRobot takes options for: found undefined alias"),
        (["--env.task={"], "error: --env.task is no YAML"),
        (["--config_path=broken.json"], "error: broken.json: Expecting property name"),
        (["--config_path=broken.yaml"], "error: broken.yaml: while parsing a flow node"),
        (["--policy.device=gpu"], "gpu"),
        (["--policy.type=lisa"], "Cannot specify both --policy.path and --policy.type"),
        (["--config_path=absent.yaml"], "absent.yaml: No such file or directory"),
    ],
)
def test_options_that_cannot_work(
    options: list[str], said: str, lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    for name in ("broken.json", "broken.yaml"):
        Path(name).write_text("{")
    arguments = [f"--policy.path={lisa}", *LEVEL, f"--output_dir={tmp_path / 'out'}", *options]
    monkeypatch.setattr("sys.argv", ["lisa-rollout", *arguments])
    try:
        code: object = rollout.main()
    except SystemExit as ended:  # LeRobot's own parser ends the program after its line
        code = ended.code
    assert code == 1
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("error: ")
    assert said in last
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.__name__.removeprefix("lerobot_lisa."))
def test_unknown_options_are_a_wrong_usage(
    command: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["command", "--no-such-option=1"])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 2
    assert "unrecognized arguments: --no-such-option=1" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.__name__.removeprefix("lerobot_lisa."))
def test_help_lists_options_with_dots_only(
    command: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["command", "--help"])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert not ended.value.code
    options = [word.strip(",") for word in capsys.readouterr().out.split() if word.startswith("--")]
    assert len(options) > 3
    assert not [option for option in options if "-" in option[2:].split("=")[0]]


def test_files_stand_before_the_first_option(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def note(config: SuccessConfig) -> None:
        seen.append((config.files, config.json))

    monkeypatch.setattr("sys.argv", ["success", "a b.json", "c,d.json", "--json", "out.json"])
    assert run_command(note, "files") == 0
    assert seen == [([Path("a b.json"), Path("c,d.json")], Path("out.json"))]
