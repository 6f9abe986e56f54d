"""Traces of any size for reports, and a real browser that looks at them."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from lerobot_lisa.analysis.recording.traces import Trace

FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--hide-scrollbars",
]  # fmt: skip
MEASURE = """<script>
const outside = performance.getEntriesByType("resource").filter(entry => !entry.name.startsWith("data:"));
document.title = JSON.stringify({
  images: [...document.images].map(image => image.complete && image.naturalWidth > 0),
  outside: outside.map(entry => entry.name),
  wide: document.documentElement.scrollWidth - window.innerWidth,
  paper: getComputedStyle(document.body).backgroundColor,
});
</script>"""


USED = 10
"""Codes that occur in a trace, the others are dead: a hundred skills in full take a minute to draw."""


def synthetic(codes: int, words: int, episodes: int = 60, steps: int = 12, horizon: int = 2, seed: int = 0) -> Trace:
    """Random episodes whose instructions have five of some words, and whose codes go by their first."""
    rng = np.random.default_rng(seed)
    vocabulary = [f"word{number}" for number in range(words)]
    told = [" ".join(rng.choice(vocabulary, 5)) for _ in range(episodes)]
    return trace_of(told, [int(instruction.split()[0][4:]) for instruction in told], codes, steps, horizon, rng)


def trace_of(
    told: list[str], firsts: list[int], codes: int, steps: int, horizon: int, rng: np.random.Generator
) -> Trace:
    """Random episodes with given instructions and first codes."""
    rows = []
    for episode, (instruction, first) in enumerate(zip(told, firsts, strict=True)):
        for step in range(steps):
            code = (first + step // horizon) % USED * codes // USED
            action = [float(rng.integers(7))]
            rows.append(("babyai", 0, episode, 1000 + episode, step, instruction, code, action, False))
    names = ["group", "task_id", "episode", "seed", "step", "instruction", "code", "action", "success"]
    frame = pd.DataFrame(rows, columns=names)
    starts = frame[frame["step"] == 0].drop(columns=["step", "code", "action"]).reset_index(drop=True)
    ends = starts.assign(steps=steps, success=rng.random(len(told)) < 0.6)
    return Trace(frame, ends, origin(codes, horizon))


def origin(codes: int, horizon: int) -> dict[str, Any]:
    """What `record` would have noted."""
    policy = {"type": "lisa", "codebook_size": codes, "horizon": horizon, "action_classes": 7, "action_temperature": 1}
    return {
        "policy_path": "outputs/pretrained_model", "checkpoint": {"revision": None, "sha256": "0"}, "policy": policy,
        "env": {"type": "babyai", "task": "GoToSeq"}, "n_episodes": 60, "batch_size": 50, "seed": 1000,
        "versions": {"lerobot": "0.6.1"},
    }  # fmt: skip


def browser() -> str:
    """Path of a Chromium; skips the test where there is none."""
    found = next(
        (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
    )
    if not found:
        pytest.skip("no Chromium on PATH to look at the page (Debian: apt install chromium)")
    return found


def measure(page: Path, profile: Path, *flags: str, width: int = 1280) -> dict[str, Any]:
    """What a browser makes of a page: whether images show, what it fetched, how far it is too wide, its background."""
    copy = page.with_name("measured.html")
    copy.write_text(page.read_text(encoding="utf-8").replace("</body>", MEASURE + "</body>"), encoding="utf-8")
    command = [browser(), *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},900", *flags, "--dump-dom"]
    done = subprocess.run([*command, copy.as_uri()], capture_output=True, text=True, timeout=60, check=True)
    found = re.search(r"<title>(.*?)</title>", done.stdout)
    assert found, done.stderr
    return json.loads(found[1])
