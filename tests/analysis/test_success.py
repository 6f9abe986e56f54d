"""Success rates: known intervals, pooling, random actions by world, the command line, clear refusals."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_lisa.analysis.success.__main__ import main, read_episodes, summarise
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.envs.lorel.random_floor import random_floor
from lerobot_lisa.envs.lorel.suites import find_task
from lerobot_lisa.errors import UserError


def write(path: Path, **tasks: list) -> Path:
    """An eval_info.json whose tasks are named like `babyai_0`."""
    names = [name.rsplit("_", 1) for name in tasks]
    per_task = [
        {"task_group": group, "task_id": int(task), "metrics": {"successes": listed, "video_paths": []}}
        for (group, task), listed in zip(names, tasks.values(), strict=True)
    ]
    path.write_text(json.dumps({"per_task": per_task, "overall": {"pc_success": 0.0}}))
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    """The command in this process."""
    monkeypatch.setattr("sys.argv", ["success", *map(str, arguments)])
    return main()


def episodes(**tasks: list) -> pd.DataFrame:
    """Episodes of tasks that are named like `babyai_0`."""
    rows = [(*name.rsplit("_", 1), success) for name, listed in tasks.items() for success in listed]
    frame = pd.DataFrame(rows, columns=["group", "task_id", "success"])
    return frame.astype({"task_id": int})


def floors(world: str | None, **tasks: list) -> dict[str, float]:
    """What random actions achieve, where it is known."""
    table = summarise(episodes(**tasks), world).set_index("part")["random_actions"]
    return table.dropna().to_dict()


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    [(81, 263, 25.53, 36.62), (15, 148, 6.24, 16.05), (0, 20, 0.0, 16.11), (1, 29, 0.61, 17.18)],
)
def test_published_wilson_intervals(successes: int, episodes: int, low: float, high: float) -> None:
    rate = success_rate([True] * successes + [False] * (episodes - successes))
    assert (rate.successes, rate.episodes) == (successes, episodes)
    assert (rate.low, rate.high) == pytest.approx((low, high), abs=0.006)


@given(st.lists(st.booleans(), min_size=1, max_size=300))
def test_interval_holds_the_rate(outcomes: list[bool]) -> None:
    rate = success_rate(outcomes)
    assert 0 <= rate.low <= rate.percent + 1e-9
    assert rate.percent - 1e-9 <= rate.high <= 100


def test_tasks_groups_and_overall(tmp_path: Path) -> None:
    path = write(tmp_path / "a.json", babyai_0=[True, False], babyai_1=[True, True], other_0=[False])
    table = summarise(read_episodes(path), "babyai")
    assert [(row.part, (row.successes, row.episodes)) for row in table.itertuples()] == [
        ("babyai/0", (1, 2)), ("babyai/1", (2, 2)), ("other/0", (0, 1)), ("babyai", (3, 4)), ("other", (0, 1)),
        ("overall", (3, 5)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not JSON"),
        ("[]", "no successes per task"),
        ('{"per_task": [{"task_group": "a", "task_id": 0, "metrics": {}}]}', "no successes per task"),
        ('{"per_task": [{"task_group": "a", "task_id": 0, "metrics": {"successes": ["x"]}}]}', "no successes per task"),
        ('{"per_task": [{"task_group": "a", "task_id": 0, "metrics": {"successes": []}}]}', "without any episode"),
        ('{"per_task": []}', "without any episode"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "notes.json"
    path.write_text(text)
    with pytest.raises(UserError, match=rf"notes\.json: .*{said}"):
        read_episodes(path)


def test_seeds_are_pooled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    files = [write(tmp_path / f"{seed}.json", babyai_0=[True] * seed + [False] * 2) for seed in (1, 2)]
    files.append(write(tmp_path / "3.json", babyai_1=[False, True], babyai_0=[True]))

    assert run(monkeypatch, *files, f"--json={tmp_path / 'new' / 'rates.json'}") == 0

    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == f"1/3 33.3 % (95 % interval 6.1 to 79.2 %) {files[0]}"
    assert [line.split()[-1] for line in lines[3:]] == ["babyai/0", "babyai/1", "babyai", "overall"]
    assert lines[-1].startswith("5/10 50.0 %")
    rates = json.loads((tmp_path / "new" / "rates.json").read_text())["rates"]
    assert {name: (rate["successes"], rate["episodes"]) for name, rate in rates.items()} == {
        "babyai/0": (4, 8), "babyai/1": (1, 2), "babyai": (5, 10), "overall": (5, 10),
    }  # fmt: skip


def test_lorels_numbers_stand_beside_random_actions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    half = [True, False]
    path = write(tmp_path / "a.json", seen_0=half, seen_1=half, rephrasals_human_8=half, rephrasals_unseen_verb_0=half)
    assert run(monkeypatch, path, "--env.type=lorel", f"--json={tmp_path / 'rates.json'}") == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    closing, opening = random_floor(find_task("close drawer")), random_floor(find_task("open drawer"))
    assert lines[0].endswith(f"random actions {closing:.1f} % seen/0: close drawer")
    assert lines[2].endswith(f"random actions {closing:.1f} % rephrasals_human/8: shut the cupboard")
    assert lines[4].endswith(f"random actions {(closing + opening) / 2:.1f} % seen")
    assert lines[7].endswith(f"random actions {closing:.1f} % rephrasals")
    assert lines[8].endswith(f"random actions {(3 * closing + opening) / 4:.1f} % overall")
    rates = json.loads((tmp_path / "rates.json").read_text())["rates"]
    assert (rates["seen/1"]["instruction"], rates["seen/1"]["random_actions"]) == (
        "open drawer",
        pytest.approx(opening),
    )


def test_the_floor_counts_tasks_as_often_as_they_were_run() -> None:
    closing, opening = random_floor(find_task("close drawer")), random_floor(find_task("open drawer"))
    found = floors("lorel", seen_0=[True] * 3, seen_1=[False])
    assert found["overall"] == found["seen"] == pytest.approx((3 * closing + opening) / 4)
    free = floors("lorel", close_drawer_free_arm_0=[True])["overall"]
    assert free == pytest.approx(random_floor(find_task("close drawer"), "free"))
    assert free != pytest.approx(closing)
    assert floors("lorel", seen_0=[True], babyai_0=[True]).keys() == {"seen/0", "seen"}
    assert floors("lorel", seen_99=[True]) == {}


@pytest.mark.parametrize("world", [None, "babyai", "no_such_world"])
def test_a_group_of_the_same_name_in_another_world_gets_nothing_of_lorels(world: str | None) -> None:
    table = summarise(episodes(seen_0=[True], rephrasals_human_0=[False]), world)
    assert table["random_actions"].isna().all()
    assert set(table["instruction"]) == {""}
    assert list(table["part"]) == ["seen/0", "rephrasals_human/0", "seen", "rephrasals_human", "overall"]
    assert np.isfinite(table["percent"]).all()


def test_what_is_wrong_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path / "absent.json") == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'absent.json'}: No such file or directory\n"
    assert run(monkeypatch) == 1
    assert capsys.readouterr().err.startswith("error: name one or several eval_info.json")
