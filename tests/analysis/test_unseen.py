"""Shares of instructions that were never demonstrated."""

import json
from pathlib import Path

import numpy as np
import pytest
import tiny_datasets

from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.analysis.unseen import draw_missions, kind_of_mission, main, read_instructions, report


def run_main(monkeypatch: pytest.MonkeyPatch, *options: str) -> int:
    """`lisa-unseen` in this process."""
    monkeypatch.setattr("sys.argv", ["lisa-unseen", *options])
    return main()


def dataset_of(root: Path, instructions: list[str]) -> Path:
    features = {"observation.state": tiny_datasets.STATE, "action": tiny_datasets.MOVE}
    frame = {key: np.zeros((1, *feature["shape"]), np.float32) for key, feature in features.items()}
    episodes = [Episode(instruction, frame) for instruction in instructions]
    write_dataset(root, DatasetLayout("local/tiny", 10, features), episodes)
    return root


def test_instructions_of_a_dataset(symbolic: Path) -> None:
    instructions, episodes = read_instructions(symbolic)

    assert instructions == set(tiny_datasets.INSTRUCTIONS)
    assert episodes == len(tiny_datasets.LENGTHS)


def test_missions_are_those_of_evaluation() -> None:
    """The same seeds give what `lerobot-eval` asks for."""
    from lerobot_lisa.envs.babyai.env import BabyAIEnv

    env = BabyAIEnv("GoToSeq")
    expected = [env.reset(seed=seed) and env.task_description for seed in range(1000, 1005)]

    assert [mission for mission, _ in draw_missions("GoToSeq", 5, 1000)] == expected


@pytest.mark.parametrize(
    ("mission", "kind"),
    [
        ("go to the red ball", "single action"),
        ("go to the red ball and pick up a key", "two in any order"),
        ("go to the red ball and go to a door, then pick up a key", "one after another"),
        ("go to the red ball after you pick up a key", "one after another"),
        ("put the hand next to a box", "single action"),
    ],
)
def test_kinds(mission: str, kind: str) -> None:
    assert kind_of_mission(mission) == kind


def test_report_counts_every_mission() -> None:
    labelled = [("a", "x"), ("a", "x"), ("b", "y"), ("c", "y")]

    lines = list(report(labelled, frozenset({"a"}), drawn=True))

    assert [line.split()[0] for line in lines] == ["2/4", "0/2", "2/2"]
    assert "15.0 to 85.0" in lines[0]  # Wilson's interval of 2 in 4, from a table
    assert "interval" not in "".join(report(labelled, frozenset(), drawn=False))


def test_command_of_a_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    known = [mission for mission, _ in draw_missions("GoToLocal", 4, 1000)]
    root = dataset_of(tmp_path / "data", known)

    options = [f"--dataset.root={root}", "--level=GoToLocal", "--n=4", f"--json={tmp_path / 'unseen.json'}"]
    assert run_main(monkeypatch, *options) == 0

    printed = capsys.readouterr().out
    assert "0/4" in printed
    assert "seeds 1000 to 1003" in printed
    written = json.loads((tmp_path / "unseen.json").read_text())
    unseen = written["rates"]["overall"]["unseen"]
    assert (unseen["successes"], unseen["episodes"]) == (0, 4)
    assert written["made"]["command"].startswith("lisa-unseen --dataset.root=")


def test_command_of_a_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = dataset_of(tmp_path / "data", ["close drawer", "open drawer", "shut drawer"])

    assert run_main(monkeypatch, f"--dataset.root={root}", "--suite=rephrasals") == 0

    printed = capsys.readouterr().out
    assert "4 of 6  unseen, of seen" in printed
    assert "5 of 6  unseen, of unseen verb" in printed
    assert "52 of 53  unseen, of human" in printed  # one person said "shut drawer", too


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dataset.root=nowhere", "--level=GoToLocal"], "--dataset.root=nowhere"),
        (["--dataset.root={data}", "--level=GoToLocl", "--n=3"], "did you mean GoToLocal"),
        (["--dataset.root={data}", "--level=GoToLocal", "--n=0"], "--n=0"),
        (["--dataset.root={data}", "--level=GoToLocal", "--seed=999999"], "--seed=999999"),
        (["--dataset.root={data}"], "give either --level, of BabyAI, or --suite, of LOReL"),
        (["--dataset.root={data}", "--suite=seen", "--level=GoToLocal"], "give either --level"),
        (["--dataset.root={data}", "--suite=sen"], "--suite=sen: choose from seen, rephrasals"),
        (["--level=GoToLocal"], "--dataset.root is missing"),
    ],
)
def test_mistakes_take_one_line(
    arguments: list[str],
    said: str,
    symbolic: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_main(monkeypatch, *(argument.format(data=symbolic) for argument in arguments)) == 1

    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed.startswith("error: ")
    assert said in printed
