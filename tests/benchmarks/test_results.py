"""docs/results.md says what the committed files of the runs say."""

import json
from pathlib import Path

import pytest

from benchmarks import results
from lerobot_lisa.reproduce.results import PAGE, render

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_the_files_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    page = PAGE.read_text()

    assert render(page) == page
    for world in ("babyai", "lorel", "metaworld", "ablations", "transfer"):
        assert f"<!-- runs: {world} -->\n| row |" in page


def rate(successes: int) -> dict:
    return {"successes": successes, "episodes": 10, "percent": 10.0 * successes, "low": 0, "high": 0}


def told(successes: int) -> dict:
    budget = {"success": rate(successes - 1), "told_otherwise": None, "heard": None}
    overall = {
        "success": rate(successes), "told_otherwise": rate(1), "heard": {"points": 70.0, "low": 1, "high": 2},
        "spl": {"value": 0.5, "low": 0.4, "high": 0.6}, "budgets": {"1": budget, "2": budget, "4": budget},
    }  # fmt: skip
    origin = {
        "policy": {"type": "lisa"}, "env": {"type": "babyai", "task": "GoToSeq", "max_episode_steps": None},
        "n_episodes": 10, "seed": 1000, "batch_size": 5, "checkpoint": {"sha256": "abc"}, "versions": {},
        "policy_path": "/home/somebody/run",
    }  # fmt: skip
    made = {"commit": "def5678", "command": "lisa-diagnose heard --policy.path=/home/somebody/run/x --seed=1000"}
    return {"told": "other", "rates": {"overall": overall}, "evaluation": origin, "made": made}


def test_runs_are_kept_pooled_and_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for seed, successes in enumerate((8, 9)):
        (tmp_path / "heard.json").write_text(json.dumps(told(successes)))
        assert results.main(["add", "heard.json", "--row=GoToSeq 1k", f"--seed={seed}", "--commit=abc1234"]) == 0
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text("before\n<!-- runs: babyai -->\nold\n<!-- end of runs -->\nafter\n")

    assert results.main(["render"]) == 0

    page = PAGE.read_text()
    line = "| GoToSeq 1k | BabyAI's own | LISA | **85.0 %** (64.0 to 94.8) | 70.0, 70.0 | 0.50, 0.50 | 70.0 %, 80.0 % |"
    files = [f"[abc1234](results/babyai/gotoseq_1k_lisa_seed{seed}_own_limit.json)" for seed in (0, 1)]
    assert f"{line} 2 x 10 | 59.4 ± 0.9 % | {', '.join(files)} |" in page
    assert "| GoToSeq 10k | BabyAI's own | LISA | not run |  |  |  |  | 65.4 ± 1.6 % |  |" in page
    assert page.startswith("before")
    assert page.endswith("after\n")
    kept = json.loads((results.FOLDER / "babyai" / "gotoseq_1k_lisa_seed0_own_limit.json").read_text())
    assert kept["commands"] == {"heard": "lisa-diagnose heard --policy.path=.../x --seed=1000"}
    assert kept["commits"] == {"train": "abc1234", "heard": "def5678"}
    assert "somebody" not in "".join(path.read_text() for path in results.FOLDER.rglob("*.json"))


def test_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.json").write_text("{}")

    assert results.main(["add", str(tmp_path / "x.json"), "--row=GoToSeq 1k", "--seed=0", "--commit=a"]) == 1
    assert "not a heard.json" in capsys.readouterr().err
