"""Tables with LISA beside Lang-DT, what was measured before, and figures: all from files."""

import json
from pathlib import Path
from typing import Any

import pytest

from lerobot_lisa.reproduce import figures
from lerobot_lisa.reproduce.before import read_before
from lerobot_lisa.reproduce.by_part import by_part
from lerobot_lisa.reproduce.results import render, render_page
from lerobot_lisa.reproduce.rows import read_rows
from lerobot_lisa.reproduce.side_by_side import side_by_side
from lerobot_lisa.reproduce.unseen_words import unseen_words

ROWS = read_rows()


def run(row: str, policy: str, successes: int, seed: int = 0, **more: Any) -> dict[str, Any]:
    """What is published of a run of 100 episodes."""
    rates = {"success": {"successes": successes, "episodes": 100}, **more.pop("rates", {})}
    made = {"commit": "abc1234", "env": {"type": "lorel", "max_episode_steps": None}, "seed": seed}
    return {"row": ROWS[row].title, "policy": policy, "rates": rates, **made, "file": f"x/{policy}{seed}.json", **more}


def line(table: str, title: str) -> list[str]:
    (found,) = (line for line in table.splitlines() if line.startswith(f"| {title} |"))
    return [cell.strip() for cell in found.strip("|").split("|")]


def test_policies_of_a_row_stand_side_by_side() -> None:
    heard = {"heard": {"points": 41.25}}
    runs = [run("table1.lorel_states", "lisa", count, seed, rates=heard) for seed, count in enumerate((60, 70))]
    runs += [run("table1.lorel_states", "lang_dt", 50), run("table1.lorel_states", "lang_bc", 10)]
    assert line(side_by_side(runs, [ROWS["table1.lorel_states"]]), "LOReL states, seen") == [
        "LOReL states, seen", "**65.0 %** (58.2 to 71.3)", "50.0 % (40.4 to 59.6)", "Lang-BC: 10.0 % (5.5 to 17.4)",
        "41.2, 41.2 / - / -", "2 x 100 / 1 x 100 / 1 x 100", "66.7 ± 5.2 / 33.3 ± 5.6 / 6 ± 1.2 %", "21.3 %",
        "[abc1234](results/x/lisa0.json), [abc1234](results/x/lisa1.json); [abc1234](results/x/lang_dt0.json); "
        "[abc1234](results/x/lang_bc0.json)",
    ]  # fmt: skip


def test_what_is_not_run_says_so_beside_other_papers() -> None:
    table = side_by_side([], [ROWS["table1.lorel_images"]])
    assert line(table, "LOReL images, seen")[1:4] == ["not run", "not run", "LOReL planner: not run"]
    peer = "LOReL images, seen: SkillDiffuser (arXiv:2312.11598), from their paper"
    assert line(table, peer)[6] == "43.65 ± 4.7 %"


def test_what_was_measured_before_is_counted_from_its_file_and_dated(tmp_path: Path) -> None:
    counts = {"lisa_a": {"t/0": [3, 50], "t/1": [5, 50]}, "lisa_b": {"t/0": [12, 50], "t/1": [20, 50]}}
    (tmp_path / "counts.json").write_text(json.dumps(counts))
    named = {"row": "LOReL states, seen", "when": "version 0, 2020-02-02", "like": "table1.lorel_states"}
    by_hand = [{"success": {"successes": 77, "episodes": 200}, "heard": {"points": 27.0}}]
    groups = [
        {**named, "counts": "counts.json", "told": "page.md", "runs": {"lisa": ["lisa_a", "lisa_b"]}},
        {**named, "when": "by hand", "told": "page.md", "commit": "abc1234", "runs": {"lang_dt": by_hand}},
    ]
    (tmp_path / "results" / "before").mkdir(parents=True)
    (tmp_path / "results" / "before" / "lorel.json").write_text(json.dumps(groups))

    table = side_by_side([], [ROWS["table1.lorel_states"]], read_before("lorel", tmp_path / "results"))

    assert line(table, "LOReL states, seen: version 0, 2020-02-02") == [
        "LOReL states, seen: version 0, 2020-02-02", "**20.0 %** (15.0 to 26.1)", "not run", "", "", "2 x 100",
        "66.7 ± 5.2 / 33.3 ± 5.6 %", "21.3 %", "[counts](counts.json)",
    ]  # fmt: skip
    assert line(table, "LOReL states, seen: by hand")[2:5] == ["**38.5 %** (32.0 to 45.4)", "", "27.0"]
    assert line(table, "LOReL states, seen: by hand")[-1] == "[abc1234](page.md)"
    assert read_before("babyai", tmp_path / "results") == []


def curve(row: str, successes: list[int]) -> list[dict[str, Any]]:
    last = {"depends": {"of": {"config": {"steps": 2000}}}}
    steps = ["@500", "@1000", ""][-len(successes) :]
    return [run(row, f"lisa{at}", count, **last) for at, count in zip(steps, successes, strict=True)]


def test_figures_are_drawn_of_what_there_is() -> None:
    rows = [*ROWS.values()]
    assert figures.beside_paper([], rows) is None
    assert figures.beside_paper([run("ours.lorel_states_rephrasals", "lisa", 50)], rows) is None  # not the paper's
    assert figures.learning_curves(curve("transfer.gotoseq_scratch", [50]), rows) is None  # one point is no curve

    drawn = figures.beside_paper(
        [run("table1.lorel_states", "lisa", 60), run("table1.gotoseq_1k", "lang_dt", 70)], rows
    )
    assert drawn is not None
    (axes,) = drawn.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["GoToSeq 1k, Lang-DT", "LOReL states, seen, LISA"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([70, 49.3, 60, 66.7])

    runs = curve("transfer.gotoseq_scratch", [20, 40, 60]) + curve("transfer.bosslevel_frozen", [10, 30, 50])
    drawn = figures.learning_curves(runs, rows)
    assert drawn is not None
    assert [axes.get_title() for axes in drawn.axes] == ["BossLevel", "GoToSeq"]
    (drawn_curve,) = drawn.axes[1].lines
    assert (list(drawn_curve.get_xdata()), list(drawn_curve.get_ydata())) == ([500, 1000, 2000], [20, 40, 60])


def test_information_is_drawn_by_what_was_varied() -> None:
    rows = [*ROWS.values()]
    assert figures.information([run("ablations.horizon_5", "lisa", 50)], rows) is None  # nothing was kept
    names = ("horizon_50", "horizon_5", "skills_20", "papers_form")
    drawn = figures.information([run(f"ablations.{name}", "lisa", 50, information=[[1, 0.5]]) for name in names], rows)
    assert drawn is not None
    told = {axes.get_title(): [line.get_label() for line in axes.lines] for axes in drawn.axes}
    assert told == {"BossLevel, horizon": ["5", "50"], "BossLevel, number of skills": ["20"]}


def test_unseen_instructions_of_all_and_by_form() -> None:
    rate = {"unseen": {"successes": 4154, "episodes": 10000}}
    forms = {
        form: {"unseen": {"percent": 50.0, "episodes": 3274}}
        for form in ("one after another", "single action", "two in any order")
    }
    table = unseen_words([run("table3.gotoseq_10k", "dataset", 0, rates=rate, parts=forms)], ROWS.values())
    assert line(table, "GoToSeq 10k")[1:4] == ["41.5 % (40.6 to 42.5)", "63.8 %", "50.0 % of 3,274"]
    assert line(table, "BossLevel 100k")[1] == "not run"
    titles = [row.split(" | ")[0].removeprefix("| ") for row in table.splitlines()[2:]]
    levels, sizes = ("GoToSeq", "SynthSeq", "BossLevel"), ("1k", "10k", "100k")
    assert titles == [f"{level} {size}" for level in levels for size in sizes]


def test_parts_of_an_evaluation_stand_beside_the_papers() -> None:
    parts = {"close drawer": {"success": {"successes": 45, "episodes": 50}}}
    table = by_part([run("appendix.lorel_tasks", "lisa", 60, parts=parts)], [ROWS["appendix.lorel_tasks"]])
    head, _, first, second, *_ = table.splitlines()
    assert head == "| LOReL images, by instruction | LISA | Lang-DT | LISA, the paper | Lang-DT, the paper |"
    assert first == "| close drawer | 90.0 % (78.6 to 95.7) | not run | 100 % | 10 % |"
    assert second == "| open drawer | not run | not run | 20 % | 60 % |"
    by_wording = by_part([], [ROWS["appendix.lorel_rephrasals"], ROWS["table1.gotoseq_1k"]])
    assert by_wording.splitlines()[0].endswith("| SkillDiffuser (arXiv:2312.11598) |")
    assert "\n\n" not in by_wording  # a row without parts has no table


def test_the_page_shows_figures_that_can_be_drawn(tmp_path: Path) -> None:
    (tmp_path / "docs" / "results" / "babyai").mkdir(parents=True)
    page = tmp_path / "docs" / "results.md"
    page.write_text(
        "<!-- figure: paper -->\n<!-- end of figure -->\n<!-- figure: transfer -->\n<!-- end of figure -->\n"
    )
    (tmp_path / "docs/results/babyai/one.json").write_text(json.dumps(run("table1.gotoseq_1k", "lisa", 60)))

    render_page(tmp_path)

    shown, nothing = page.read_text().split("<!-- end of figure -->\n")[:2]
    assert shown.endswith("](figures/results/paper.png)\n")
    assert nothing.endswith("Nothing to draw yet.\n")
    assert [path.name for path in (tmp_path / "docs/figures/results").iterdir()] == ["paper.png"]
    assert render(page.read_text(), tmp_path / "docs" / "results") == page.read_text()
