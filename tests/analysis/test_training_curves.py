"""Reading lerobot-train's log: counted steps, every curve, clear refusals."""

from pathlib import Path

import pytest

from lerobot_lisa.analysis.training_curves import Run, draw, read_log, write_table
from lerobot_lisa.errors import UserError

LOG = """ 'log_freq': 500,
INFO ot_train.py:641 step:500 smpl:16K ep:218 lr:4.6e-04 perplexity:8.7 action_loss:0.279
Training: 3%INFO ot_train.py:641 step:1K smpl:32K ep:436 loss:0.2 lr:1e-05 perplexity:9.5 action_loss:0.2
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "lisa.log"
    path.write_text(LOG)
    return path


def test_steps_are_counted_because_the_log_rounds_them(log: Path) -> None:
    assert read_log(log) == Run("lisa", [500, 1000], {"action_loss": [0.279, 0.2], "perplexity": [8.7, 9.5]})


def test_figure_and_table(log: Path, tmp_path: Path) -> None:
    flat = Run("flat", [500], {"action_loss": [0.5]})

    draw([read_log(log), flat], tmp_path / "curves.png")
    write_table([read_log(log), flat], tmp_path / "curves.csv")

    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    rows = (tmp_path / "curves.csv").read_text().splitlines()
    assert rows[0] == "run,step,curve,value"
    assert rows[-1] == "flat,500,action_loss,0.5"
    assert len(rows) == 1 + 4 + 1


@pytest.mark.parametrize("text", ["", "nothing of the kind\n"])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(text)
    with pytest.raises(UserError, match=r"notes\.txt: no lines of lerobot-train's log"):
        read_log(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"absent\.log: No such file"):
        read_log(tmp_path / "absent.log")
