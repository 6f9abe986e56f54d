"""The tables of docs/results.md, made from committed JSON files: one for each training run and evaluation.

python -m benchmarks.results add outputs/heard/lisa_0/heard.json --row="GoToLocal 1k" --seed=0 --commit=150f7f8
python -m benchmarks.results render

`add` keeps of what `lisa-diagnose heard` wrote the numbers and how they came about, without this machine's paths.
`render` writes the tables anew; a test sees to it that they are what the files say.
"""

import argparse
import json
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from lerobot_lisa.errors import UserError, exit_code

FOLDER, PAGE = Path("docs/results"), Path("docs/results.md")
POLICIES = {"lisa": "LISA", "lang_dt": "Lang-DT"}
PAPER = {
    ("GoToSeq 1k", "lisa"): 59.4, ("GoToSeq 1k", "lang_dt"): 49.3,
    ("SynthSeq 1k", "lisa"): 46.3, ("SynthSeq 1k", "lang_dt"): 42.3,
    ("BossLevel 1k", "lisa"): 49.1, ("BossLevel 1k", "lang_dt"): 44.5,
}  # fmt: skip
"""Success in percent of the paper's table 1, at BabyAI's own step limit."""
_BLOCK = re.compile(r"(<!-- runs: (?P<world>\w+) -->\n).*?(<!-- end of runs -->)", re.DOTALL)

Run = dict[str, Any]


def add(path: Path, row: str, seed: int, commit: str, note: str) -> Path:
    """Keep a run.

    Raises:
        UserError: The file is not what `lisa-diagnose heard` writes.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        origin = told["evaluation"]
        run = {
            "row": row,
            "policy": origin["policy"]["type"],
            "seed": seed,
            "commit": commit,
            "note": note,
            "env": {name: origin["env"].get(name) for name in ("type", "task", "max_episode_steps")},
            "episodes": origin["n_episodes"],
            "evaluation_seed": origin["seed"],
            "batch_size": origin["batch_size"],
            "weights": origin["checkpoint"]["sha256"],
            "versions": origin["versions"],
            "told": told["told"],
            "rates": told["rates"]["overall"],
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not a heard.json of `lisa-diagnose heard` ({error!r:.80})") from error
    limit = run["env"]["max_episode_steps"]
    name = f"{row} {run['policy']} seed{seed} {'own_limit' if limit is None else f'limit{limit}'}"
    target = FOLDER / run["env"]["type"] / f"{re.sub(r'[^a-z0-9_]+', '_', name.lower())}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
    return target


def render(page: str) -> str:
    """The page with its tables made anew."""
    return _BLOCK.sub(lambda found: f"{found[1]}{table(_runs(found['world']))}\n{found[3]}", page)


def _runs(world: str) -> list[Run]:
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted((FOLDER / world).glob("*.json"))]


def table(runs: Iterable[Run]) -> str:
    """One line for each row, step limit and policy, seeds pooled or side by side."""
    groups: dict[tuple[str, int, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run["row"], run["env"]["max_episode_steps"] or 0, run["policy"]), []).append(run)
    head = "| row | steps at most | policy | success | heard, points | SPL | within 2 x | seeds x n | paper |"
    lines = [head, "|---|---|---|---|---|---|---|---|---|"]
    lines += [_line(*key, group) for key, group in sorted(groups.items(), key=lambda item: _order(*item[0]))]
    return "\n".join(lines)


def _order(row: str, limit: int, policy: str) -> tuple[Any, ...]:
    levels = ["GoToLocal", "GoToSeq", "SynthSeq", "BossLevel"]
    level, size = row.split(" ", 1)
    return levels.index(level) if level in levels else len(levels), len(size), row, limit, policy != "lisa"


def _line(row: str, limit: int, policy: str, runs: Sequence[Run]) -> str:
    rates = [run["rates"] for run in runs]
    successes, episodes = (sum(rate["success"][name] for rate in rates) for name in ("successes", "episodes"))
    interval = binomtest(successes, episodes).proportion_ci(method="wilson")
    success = f"**{100 * successes / episodes:.1f} %** ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
    heard = ", ".join(f"{r['points']:.1f}" for r in (rate["heard"] for rate in rates) if r)
    spl = ", ".join(f"{r['value']:.2f}" for r in (rate["spl"] for rate in rates) if r)
    within = ", ".join(f"{rate['budgets']['2']['success']['percent']:.1f} %" for rate in rates if rate["budgets"])
    paper = f"{PAPER[row, policy]} %" if (row, policy) in PAPER and not limit else ""
    seeds = f"{len(runs)} x {rates[0]['success']['episodes']}"
    cells = (row, limit or "BabyAI's own", POLICIES[policy], success, heard, spl, within, seeds, paper)
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    adding = commands.add_parser("add", help="keep a run")
    adding.add_argument("file", type=Path, help="heard.json of `lisa-diagnose heard`")
    adding.add_argument("--row", required=True, help='level and demonstrations, such as "GoToSeq 1k"')
    adding.add_argument("--seed", type=int, required=True, help="of the training")
    adding.add_argument("--commit", required=True, help="that trained")
    adding.add_argument("--note", default="", help="what else a reader should know")
    commands.add_parser("render", help="write the tables anew")
    options = parser.parse_args(arguments)
    if options.command == "add":
        return exit_code(lambda: print(add(options.file, options.row, options.seed, options.commit, options.note)))
    return exit_code(lambda: PAGE.write_text(render(PAGE.read_text(encoding="utf-8")), encoding="utf-8"))


if __name__ == "__main__":
    sys.exit(main())
