"""The benchmark table: what is printed, kept and compared, and that alternatives of the bot are what they claim."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.bot import equal, equal_episodes, minigrids_demonstration, minigrids_level
from benchmarks.measuring import Contest, Seconds
from benchmarks.table import Aim, Row, as_markdown, comparison, details, load, ratio_row, save
from dataset_converters.babyai.demonstration import Demonstration
from lerobot_lisa.errors import UserError

FAST = Contest([Seconds(0.5, 1), Seconds(1, 2), Seconds(2, 4)], [Seconds(2, 3), Seconds(5, 6), Seconds(6, 12)])


def test_a_ratio_is_the_median_of_the_repeats_ratios() -> None:
    row = ratio_row("reading", "slow reading", 5, FAST, "frames", size=7)

    assert (row.cpu, row.wall) == (4, 3)
    assert (row.ours, row.theirs) == ("1 frames/CPU-s", "0.2 frames/CPU-s")
    assert as_markdown([row]).splitlines()[2] == (
        "| reading | slow reading | >= 5 x | 4 x (missed) | 3 x | 1 frames/CPU-s | 0.2 frames/CPU-s |"
    )
    assert details([row]) == "reading: repeats 3, size 7"


def test_two_runs_are_compared(tmp_path: Path) -> None:
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    save([Row("a", "b", Aim("at most", 3, "%"), 2.0, 2.5), Row("gone", "b", Aim("at least", 1), 1, 1)], old)
    save([Row("a", "b", Aim("at most", 3, "%"), 1.0, 1.5), Row("more", "b", Aim("at least", 1), 1, 1)], new)

    assert [row.what for row in load(new)] == ["a", "more"]
    assert comparison(load(new), [old]).splitlines()[2:] == ["| a | 2 | 1 | -50 % |", "| more | - | 1 | new |"]
    assert json.loads(new.read_text())["commit"]
    for content in ("[]", "{}", "no JSON"):
        old.write_text(content)
        with pytest.raises(UserError, match=r"old.json is not a file that --json has written"):
            load(old)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["sleeping"], 2, "no part is called sleeping"),
        (["write", "--root", "nowhere"], 1, "error: --root nowhere: no dataset"),
        (["--rows", "nowhere.json"], 1, "error: nowhere.json is not a file"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        sys.exit(main(arguments))

    assert end.value.code == code
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_demonstrations_are_compared_with_minigrids_own() -> None:
    assert equal_episodes("GoToLocal", 3) == 3
    demo = minigrids_demonstration(minigrids_level("GoToLocal"), "GoToLocal", 1_000_000)
    assert demo is not None
    other = Demonstration(demo.instruction, demo.grid, demo.direction, np.roll(demo.action, 1), demo.level, demo.seed)
    assert equal(demo, demo)
    assert not equal(demo, other)
    assert not equal(demo, None)
    assert equal(None, None)
