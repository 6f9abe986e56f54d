"""A whole row on tiny data, every command real: interrupted, gone on with, listed, stale."""

import json
import signal
import time
from pathlib import Path

import programs
import pytest

from lerobot_lisa.reproduce.command import main


def start(own_rows: Path, root: Path, *options: str) -> programs.Program:
    where = [f"--own-rows={own_rows}", f"--root={root}", "--device=cpu"]
    return programs.start("lisa-reproduce", "tiny", *where, *options)


def wait_for(pattern: str, folder: Path, process: programs.Program) -> None:
    while process.poll() is None and not list(folder.glob(pattern)):
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.timeout(900)  # of its programs, the steps import PyTorch and LeRobot
def test_a_row_is_interrupted_and_gone_on_with(
    own_rows: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "out"
    first = start(own_rows, root, "--policies", "lisa")
    wait_for("train/*/run/checkpoints/last/pretrained_model/train_config.json", root, first)
    first.send_signal(signal.SIGINT)
    told, errors = first.communicate()
    assert (first.returncode, errors) == (130, "interrupted; run the same command again to go on\n")
    assert "3 of 3 steps are left: about" in told
    assert [path.parts[-3] for path in root.glob("*/*/step.json")] == ["data"]

    told, errors = start(own_rows, root, "--jobs=2").communicate()
    assert errors == ""
    assert "4 of 5 steps are left" in told
    assert "--resume=true" in told
    lines = told.splitlines()[-3:]
    assert [line.split()[:3] for line in lines] == [
        ["run", "success", "%"], ["tiny.gotolocal", "lisa", "0"], ["tiny.gotolocal", "lang_dt", "0"]
    ]  # fmt: skip
    assert "50 ± 1.5" in lines[1]

    kept = json.loads((root / "results" / "tiny.gotolocal" / "lisa_seed0.json").read_text())
    assert kept["rates"]["success"]["episodes"] == 4
    assert set(kept["rates"]) >= {"heard", "spl", "budgets"}
    assert kept["commands"]["train"].startswith("lerobot-train --config_path=configs/babyai/gotolocal_1k/lisa.yaml ")
    assert str(tmp_path) not in json.dumps(kept)

    listed = ["--list", "tiny", f"--own-rows={own_rows}", f"--root={root}", "--device=cpu"]
    assert main(listed) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 run"
    file = own_rows / "tiny" / "gotolocal.yaml"
    file.write_text(file.read_text().replace("steps: 300", "steps: 301"))
    assert main(listed) == 0
    told = capsys.readouterr().out
    assert "stale (config.steps 300 -> 301)" in told
    assert told.splitlines()[-1] == "2 stale"
