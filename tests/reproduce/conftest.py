"""Steps and rows that are small."""

from collections.abc import Callable
from pathlib import Path

import pytest

from lerobot_lisa.reproduce.plan import Settings
from lerobot_lisa.reproduce.rows import read_rows
from lerobot_lisa.reproduce.steps import Step

TINY = """# A whole row in a minute.
like: ours.gotolocal_1k
title: GoToLocal tiny
data: {episodes: 12}
options:
  all: {batch_size: 4, steps: 300, save_freq: 100, policy.dim_model: 16, policy.n_heads: 2}
  lisa: {policy.quantizer_warmup_steps: 1, policy.codebook_size: 3}
evaluate: {n_episodes: 4, batch_size: 4}
seeds: [0]
paper: {lisa: [50, 1.5]}
"""


@pytest.fixture
def own_rows(tmp_path: Path) -> Path:
    """A folder with the row tiny.gotolocal."""
    folder = tmp_path / "rows"
    (folder / "tiny").mkdir(parents=True)
    (folder / "tiny" / "gotolocal.yaml").write_text(TINY)
    return folder


@pytest.fixture
def settings(tmp_path: Path, own_rows: Path) -> Settings:
    """With the row tiny.gotolocal, everything in a folder of its own."""
    return Settings(read_rows(own_rows), tmp_path / "out", "cpu")


@pytest.fixture
def writes(tmp_path: Path) -> Callable[..., Step]:
    """Makes a step that appends a letter to its result, after some code."""

    def step(name: str, code: str = "", after: tuple[Step, ...] = (), **depends: object) -> Step:
        program = f"import sys, time, pathlib; {code or 'pass'}; open(sys.argv[1], 'a').write('x')"
        command = ("python", "-c", program, "{folder}/result")
        return Step("write", name, tmp_path / "steps", {"name": name, **depends}, command, "result", after)

    return step
