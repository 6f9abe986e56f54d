"""Reading what lerobot-train logged: every step and curve, clear refusals."""

import math
from pathlib import Path

import pandas as pd
import pytest

from lerobot_lisa.analysis.training.__main__ import main
from lerobot_lisa.analysis.training.logs import Run, labels, read_log
from lerobot_lisa.errors import UserError

LOG = """ 'log_freq': 500, 'policy': {'codebook_size': 20, 'horizon': 10, 'type': 'lisa'}, 'seed': 3,
INFO ot_train.py:641 step:500 smpl:16K ep:218 lr:4.6e-04 perplexity:8.7 action_loss:0.279
Training: 3%INFO ot_train.py:641 step:1K smpl:32K ep:436 loss:0.2 lr:1e-05 perplexity:9.5 action_loss:0.2
"""
SETTINGS = {"policy": "lisa", "K": "20", "H": "10", "seed": "3"}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "lisa.log"
    path.write_text(LOG)
    return path


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """The log of a run with more codes, a shorter horizon and another number in it."""
    path = tmp_path / "other.log"
    text = LOG.replace("'codebook_size': 20, 'horizon': 10", "'codebook_size': 50, 'horizon': 5")
    path.write_text(text.replace("perplexity:", "mutual_information:"))
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    """The command in this process."""
    monkeypatch.setattr("sys.argv", ["training", *map(str, arguments)])
    return main()


def test_steps_are_counted_because_the_log_rounds_them(log: Path) -> None:
    values = {"action_loss": [0.279, 0.2], "perplexity": [8.7, 9.5]}
    assert read_log(log) == Run("lisa", [500, 1000], values, SETTINGS)


def test_what_is_logged_later_only_has_no_number_before(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of codes, which are placed after a while."""
    log.write_text(LOG.replace(" perplexity:8.7", ""))
    first, second = read_log(log).values["perplexity"]
    assert math.isnan(first)
    assert second == 9.5
    assert run(monkeypatch, log, f"--output_dir={tmp_path / 'out'}") == 0
    table = pd.read_csv(tmp_path / "out" / "training_curves.csv")
    assert table[table["curve"] == "perplexity"]["step"].tolist() == [1000]


def test_a_log_that_breaks_off_gives_what_there_is(log: Path) -> None:
    log.write_text(LOG[: LOG.index(" step:1K")])
    assert read_log(log).steps == [500]


def test_runs_are_called_by_what_differs(log: Path, other: Path) -> None:
    assert labels([read_log(log), read_log(other)]) == ["K 20, H 10", "K 50, H 5"]
    assert labels([read_log(log)]) == ["lisa"]
    assert labels([read_log(log), read_log(log)._replace(name="again")]) == ["lisa", "again"]


def test_figure_and_table(log: Path, other: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, log, other, f"--output_dir={tmp_path / 'out'}") == 0
    assert (tmp_path / "out" / "training_curves.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "out" / "training_curves.pdf").is_file()
    table = pd.read_csv(tmp_path / "out" / "training_curves.csv")
    assert list(table.columns) == ["run", "step", "curve", "value"]
    assert len(table) == 4 + 4
    assert table.iloc[-1].tolist() == ["K 50, H 5", 1000, "mutual_information", 9.5]


def test_chosen_curves(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, log, "--curves=[perplexity]", f"--output_dir={tmp_path}") == 0
    assert set(pd.read_csv(tmp_path / "training_curves.csv")["curve"]) == {"perplexity"}
    assert run(monkeypatch, log, "--curves=[codes_used]", f"--output_dir={tmp_path / 'new'}") == 1
    assert "nothing of codes_used was logged" in capsys.readouterr().err
    assert run(monkeypatch, log, "--curves=[los]", f"--output_dir={tmp_path / 'new'}") == 1
    assert "error: --curves: there is no 'los': choose from action_loss" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("name", "text"), [("notes.txt", ""), ("notes.txt", "nothing of the kind\n")])
def test_other_files_are_refused(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(UserError, match=r"notes\.txt: no lines of lerobot-train's log"):
        read_log(path)


def test_a_missing_file_and_a_folder_take_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path / "absent.log") == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'absent.log'}: No such file or directory\n"
    assert run(monkeypatch, tmp_path) == 1
    assert capsys.readouterr().err == f"error: {tmp_path}: Is a directory\n"


def test_the_log_of_a_resumed_run_alone_is_refused(log: Path) -> None:
    log.write_text(LOG.replace("step:500 smpl", "step:8K smpl"))
    with pytest.raises(UserError, match=r"starts at step 8K, so it is of a resumed run"):
        read_log(log)
