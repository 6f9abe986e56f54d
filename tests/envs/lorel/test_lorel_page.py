"""What docs/lorel_environment.md shows runs, and prints what its comments say."""

import contextlib
import io
import re
from pathlib import Path

import drawing

from lerobot_lisa.envs.lorel.suites import SUITES

PAGE = Path(__file__).parents[3] / "docs" / "lorel_environment.md"
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def printed(snippet: str) -> list[str]:
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(snippet, {})
    return output.getvalue().splitlines()


def test_first_snippet_prints_its_comments() -> None:
    assert printed(SNIPPETS[0]) == re.findall(r"print\(.*  # (.*)", SNIPPETS[0])


def test_measuring_snippet_runs() -> None:
    drawing.needs_gl()
    quick = re.sub(r"\b(50|1000|10)\)", "1)", SNIPPETS[2])
    assert len(printed(quick)) == 7


def test_snippet_about_the_faucet_prints_what_the_page_says() -> None:
    straight, detour, *_ = printed(SNIPPETS[1].replace("starts = 200", "starts = 5"))
    assert (straight, detour) == ("straight 0 of 5", "detour 5 of 5")


def test_table_of_compositions() -> None:
    for task in SUITES["compositions"]:
        assert f"| {task.instruction} | " in PAGE.read_text()
