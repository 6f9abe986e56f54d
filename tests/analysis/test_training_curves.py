"""Reading what lerobot-train logged, to a file or to wandb: every step and curve, clear refusals."""

import json
from pathlib import Path

import pandas as pd
import pytest
from wandb.proto.wandb_internal_pb2 import Record
from wandb.sdk.internal.datastore import DataStore

from lerobot_lisa.analysis.runs.log import read_log
from lerobot_lisa.analysis.runs.run import Run, labels
from lerobot_lisa.analysis.runs.wandb_file import read_wandb
from lerobot_lisa.analysis.training_curves import main, read
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
def wandb_folder(tmp_path: Path) -> Path:
    """An output folder with a file as wandb writes it, with what LeRobot logs, and evaluations in between."""
    folder = tmp_path / "outputs" / "wandb" / "offline-run-20260101_000000-abc"
    folder.mkdir(parents=True)
    store = DataStore()
    store.open_for_write(str(folder / "run-abc.wandb"))
    config = {"policy": {"type": "lisa", "codebook_size": 50, "horizon": 5}, "seed": 3}
    start = Record()
    for key, value in config.items():
        start.run.config.update.add(key=key, value_json=json.dumps(value))
    store.write(start)
    for step in (5, 10):
        store.write(history(step, {"train/loss": 1.0, "train/mutual_information": step / 10}))
        store.write(history(step, {"eval/pc_success": 50.0}))
    store.close()
    return tmp_path / "outputs"


def history(step: int, logged: dict[str, float]) -> Record:
    record = Record()
    for key, value in {**logged, "_step": step}.items():
        record.history.item.add(nested_key=[key], value_json=json.dumps(value))
    return record


def test_steps_are_counted_because_the_log_rounds_them(log: Path) -> None:
    values = {"action_loss": [0.279, 0.2], "perplexity": [8.7, 9.5]}
    assert read_log(log) == Run("lisa", [500, 1000], values, SETTINGS)


def test_wandb_offline_files(wandb_folder: Path) -> None:
    run = read(wandb_folder)
    assert run.steps == [5, 10]
    assert run.values == {"mutual_information": [0.5, 1.0]}
    assert run.settings == {"policy": "lisa", "K": "50", "H": "5", "seed": "3"}


def test_a_wandb_file_that_breaks_off_gives_what_there_is(wandb_folder: Path, tmp_path: Path) -> None:
    whole = next(wandb_folder.rglob("run-*.wandb")).read_bytes()
    shares = []
    for share in (0.3, 0.9, 1.0):
        path = tmp_path / f"run-{share}.wandb"
        path.write_bytes(whole[: int(share * len(whole))])
        try:
            shares.append(len(read_wandb(path).steps))
        except UserError:
            shares.append(0)
    assert shares == sorted(shares)
    assert shares[-1] == 2


def test_runs_are_called_by_what_differs(log: Path, wandb_folder: Path) -> None:
    assert labels([read(log), read(wandb_folder)]) == ["K 20, H 10", "K 50, H 5"]
    assert labels([read(log)]) == ["lisa"]
    assert labels([read(log), read(log)._replace(name="again")]) == ["lisa", "again"]


def test_figure_and_table(log: Path, wandb_folder: Path, tmp_path: Path) -> None:
    assert main([str(log), str(wandb_folder), "--output-dir", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "training_curves.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "out" / "training_curves.pdf").is_file()
    table = pd.read_csv(tmp_path / "out" / "training_curves.csv")
    assert list(table.columns) == ["run", "step", "curve", "value"]
    assert len(table) == 4 + 2
    assert table.iloc[-1].tolist() == ["K 50, H 5", 10, "mutual_information", 1.0]


def test_chosen_curves(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(log), "--curves", "perplexity", "--output-dir", str(tmp_path)]) == 0
    assert set(pd.read_csv(tmp_path / "training_curves.csv")["curve"]) == {"perplexity"}
    assert main([str(log), "--curves", "codes_used", "--output-dir", str(tmp_path / "new")]) == 1
    assert "nothing of codes_used was logged" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("name", "text"), [("notes.txt", ""), ("notes.txt", "nothing of the kind\n")])
def test_other_files_are_refused(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(UserError, match=r"notes\.txt: no lines of lerobot-train's log"):
        read(path)


def test_files_that_are_not_of_wandb_are_refused(tmp_path: Path) -> None:
    (tmp_path / "run-a.wandb").write_text("nothing of the kind, but longer than a header")
    with pytest.raises(UserError, match=r"run-a\.wandb: not a wandb file"):
        read(tmp_path)
    (tmp_path / "run-b.wandb").write_text("")
    with pytest.raises(UserError, match=r"2 wandb files .* name one of them"):
        read(tmp_path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"absent\.log: No such file"):
        read(tmp_path / "absent.log")
    with pytest.raises(UserError, match=r"absent\.wandb: not a wandb file"):
        read(tmp_path / "absent.wandb")


def test_the_log_of_a_resumed_run_alone_is_refused(log: Path) -> None:
    log.write_text(LOG.replace("step:500 smpl", "step:8K smpl"))
    with pytest.raises(UserError, match=r"starts at step 8K, so it is of a resumed run"):
        read(log)
