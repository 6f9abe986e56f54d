"""The quick start: its plan, going on after an interruption, refusing, one line for a failure.

The same commands run, smaller, in test_readme.py; `make quickstart` runs them as they are.
"""

import json
import tomllib
from pathlib import Path

import pytest
from lerobot_options import read_training

import lerobot_lisa
from lerobot_lisa import quickstart
from lerobot_lisa.errors import UserError
from lerobot_lisa.quickstart import Step, find_recipe, main, plan, run

RECIPE = find_recipe()


def writes(file: Path, name: str = "write") -> Step:
    """A step that writes a file and says so."""
    return Step(name, ["python", "-c", f"open({str(file)!r}, 'a').write('x'); print('wrote')"], file)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    (tmp_path / "logs").mkdir()
    return tmp_path / "logs"


def test_the_recipe_is_one_that_lerobot_train_reads() -> None:
    config = read_training(RECIPE)
    assert (config.policy.type, config.dataset.repo_id) == ("lisa", quickstart.REPO_ID)
    assert config.steps % config.save_freq == 0
    assert not config.policy.push_to_hub


def test_training_goes_on_from_the_last_checkpoint(tmp_path: Path) -> None:
    fresh = plan(tmp_path, 3, RECIPE)[1].command
    assert "--seed=3" in fresh
    assert "--resume=true" not in fresh
    saved = tmp_path / "lisa" / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    saved.parent.mkdir(parents=True)
    saved.touch()
    assert plan(tmp_path, 3, RECIPE)[1].command == ["lerobot-train", f"--config_path={saved}", "--resume=true"]


def test_a_command_is_shown_and_logged(tmp_path: Path, logs: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code = "import sys; print('x step:9 loss:1', file=sys.stderr); print('done')"
    run(Step("count", ["python", "-c", code], tmp_path / "any"), logs)
    command, *rest = capfd.readouterr().out.strip().splitlines()
    assert command.startswith("$ python -c ")
    assert sorted(rest) == ["done", "step:9 loss:1"]
    assert (logs / "count.log").read_text() == "x step:9 loss:1\n"


def test_a_failure_is_one_line(tmp_path: Path, logs: Path) -> None:
    failing = Step("fail", ["python", "-c", "raise SystemExit('no such thing')"], tmp_path / "never")
    with pytest.raises(UserError, match=r"^`python` ended with exit code 1: no such thing \(all of it: .*fail\.log\)$"):
        run(failing, logs)


def test_finished_steps_are_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, first, second = tmp_path / "run", tmp_path / "first", tmp_path / "second"
    monkeypatch.setattr(quickstart, "plan", lambda *_: [writes(first, "first"), writes(second, "second")])
    first.write_text("before")
    folder.mkdir()
    overall = {"percent": 81.25, "low": 70.0, "high": 90.0, "episodes": 16}
    rates = {"success": {"percent": 75.0}, "told_otherwise": {"percent": 12.5}}
    heard = {"heard": {"points": 50.0, "low": 25.5, "high": 70.25}, "spl": {"value": 0.666}, "budgets": {"2": rates}}
    for path, numbers in (("success.json", overall), ("listening/heard.json", heard)):
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(json.dumps({"rates": {"overall": numbers}}))

    assert main(["--dir", str(folder)]) == 0

    assert (first.read_text(), second.read_text()) == ("before", "x")
    closing = capsys.readouterr().out.splitlines()[-4:]
    assert closing[0] == "Success rate on GoToLocal within 15 steps: 81.2 % (95 % interval 70.0 to 90.0 %, n = 16)"
    assert closing[1] == "Within twice the bot's steps: 75.0 %, and 12.5 % when told something else; SPL 0.67"
    assert closing[2].endswith("something else is told: 50.0 points (95 % interval 25.5 to 70.2)")
    assert closing[3].endswith("skill_words_by_skill.png")


def test_another_seed_needs_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(quickstart, "plan", lambda *_: [Step("stop", ["python", "-c", "exit(3)"], tmp_path / "never")])
    assert main(["--dir", str(tmp_path), "--seed", "0"]) == 1
    assert "ended with exit code 3" in capsys.readouterr().err
    assert main(["--dir", str(tmp_path), "--seed", "1"]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path} was made with seed 0: give another --dir for seed 1\n"


def test_every_extra_that_it_needs_is_installed_by_the_setup() -> None:
    root = Path(lerobot_lisa.__file__).parents[1]
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert f'".[{",".join(extras)}]"' in (root / ".ci" / "setup").read_text()
