"""What docs/babyai_environment.md shows runs, and prints what its comments say."""

import contextlib
import io
import re
from pathlib import Path

from lerobot_lisa.envs.babyai.levels import LEVELS, level_names, make_level, max_steps_bound

PAGE = Path(__file__).parents[3] / "docs" / "babyai_environment.md"
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def printed(snippet: str) -> list[str]:
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(snippet, {})
    return output.getvalue().splitlines()


def test_first_snippet_prints_its_comments() -> None:
    assert printed(SNIPPETS[0]) == re.findall(r"print\(.*  # (.*)", SNIPPETS[0])


def test_list_of_names() -> None:
    assert printed(SNIPPETS[1]) == [" ".join(level_names())]


def test_measuring_snippet_runs() -> None:
    quick = re.sub(r"\b(200|3000|100)\)", "3)", SNIPPETS[2])
    assert len(printed(quick)) == 6


def test_table_of_levels() -> None:
    rows = re.findall(r"^\| (\w+) \| (\d) x (\d) \| (.*) \| [\d-]+ \| (\d+) \|$", PAGE.read_text(), re.MULTILINE)
    assert tuple(row[0] for row in rows) == LEVELS
    for name, columns, height, instruction, bound in rows:
        level = make_level(name)
        level.reset(seed=1000)
        assert (level.num_cols, level.num_rows) == (int(columns), int(height))
        assert (level.mission, max_steps_bound(level)) == (instruction, int(bound))
