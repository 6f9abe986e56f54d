"""How many of an environment's instructions a dataset does not hold (paper, table 3).

lisa-unseen --dataset.root=data/bosslevel_1k --level=BossLevel --n=10000
lisa-unseen --dataset.root=data/lorel_states --suite=rephrasals
"""

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from dataset_converters.seeds import FIRST_TRAINING_SEED
from lerobot_lisa.analysis.success import success_rate
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.errors import UserError, exit_code

PAPER = {
    "GoToSeq": {1_000: 76.0, 10_000: 63.8, 100_000: 48.0},
    "SynthSeq": {1_000: 76.3, 10_000: 66.0, 100_000: 50.7},
    "BossLevel": {1_000: 77.3, 10_000: 66.9, 100_000: 51.3},
}
"""Unseen instructions in percent by level and number of demonstrations (paper, table 3)."""

_Labelled = Iterable[tuple[str, str]]  # instructions with their kinds


def read_instructions(root: Path) -> tuple[frozenset[str], int]:
    """The instructions of a LeRobotDataset, and how many episodes it has.

    Raises:
        UserError: There is no dataset with instructions in the folder.
    """
    path = root / "meta" / "tasks.parquet"
    try:
        tasks = pq.read_table(path, columns=["task"])["task"].to_pylist()
        episodes = int(json.loads((root / "meta" / "info.json").read_text(encoding="utf-8"))["total_episodes"])
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise UserError(f"--dataset.root={root}: no LeRobotDataset there ({path} and info.json beside it)") from error
    return frozenset(tasks), episodes


def draw_missions(level: str, n: int, seed: int) -> Iterator[tuple[str, str]]:
    """Instructions of n new missions of a BabyAI level and their kinds, from resets with consecutive seeds.

    Raises:
        UserError: There is no such level, or minigrid is not installed.
    """
    try:
        from lerobot_lisa.envs.babyai.levels import make_level
    except ModuleNotFoundError as error:
        if error.name != "minigrid":
            raise
        raise UserError("BabyAI needs minigrid: pip install lerobot_policy_lisa[babyai]") from None
    world = make_level(level)
    for mission_seed in tqdm(range(seed, seed + n), desc=f"drawing {level}", unit="mission", disable=None):
        world.reset(seed=mission_seed)
        yield world.mission, kind_of_mission(world.mission)


def kind_of_mission(mission: str) -> str:
    """Which of BabyAI's connectives joins its actions: a sequence may hold "and", so that is looked for last."""
    if ", then " in mission or " after you " in mission:
        return "one after another"
    return "two in any order" if " and " in mission else "single action"


def report(labelled: _Labelled, seen: frozenset[str], drawn: bool) -> Iterator[str]:
    """A line with the share of unseen instructions over all, and one for each kind.

    Args:
        labelled: Instructions with their kinds.
        seen: Demonstrated instructions.
        drawn: Whether the instructions were drawn from more of them, so that their share has an interval.
    """
    by_kind: dict[str, list[bool]] = {}
    for instruction, kind in labelled:
        by_kind.setdefault(kind, []).append(instruction not in seen)
    everything = [unseen for listed in by_kind.values() for unseen in listed]
    for kind, listed in {"all": everything, **dict(sorted(by_kind.items()))}.items():
        share = success_rate(listed) if drawn else f"{sum(listed)} of {len(listed)}".rjust(9)
        yield f"{share}  unseen, of {kind}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    return exit_code(lambda: run(options.root, options.level, options.suite, options.n, options.seed))


def run(root: Path, level: str | None, suite: str | None, n: int, seed: int) -> None:
    """Draw, compare and print.

    Raises:
        UserError: The dataset or the level cannot be used, or training seeds would be drawn.
    """
    if n < 1 or seed < 0 or seed + n > FIRST_TRAINING_SEED:
        raise UserError(
            f"--n={n} --seed={seed}: at least one mission, of seeds from 0 to {FIRST_TRAINING_SEED - 1} "
            "(demonstrations are made with those above, so they are no fresh ones)"
        )
    seen, episodes = read_instructions(root)
    labelled = _suite(suite) if suite else draw_missions(str(level), n, seed)
    lines = list(report(labelled, seen, drawn=not suite))
    print(f"{root}: {episodes:,} demonstrations with {len(seen):,} distinct instructions")
    print(f"suite {suite}:" if suite else f"{n:,} fresh {level} missions, of seeds {seed} to {seed + n - 1}:")
    print(*lines, sep="\n")
    if level and (published := PAPER.get(level, {}).get(episodes)):
        print(f"The paper has {published} % with as many demonstrations.")


def _suite(name: str) -> _Labelled:
    return [(task.instruction, task.kind) for task in SUITES[name]]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset.root", dest="root", required=True, type=Path, help="folder of a LeRobotDataset")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--level", help="BabyAI level whose missions are drawn, such as BossLevel")
    source.add_argument(
        "--suite", choices=list(SUITES), help="LOReL suite whose instructions are looked up, all of them"
    )
    parser.add_argument("--n", type=int, default=10_000, help="missions drawn (default: 10000)")
    parser.add_argument("--seed", type=int, default=1000, help="of the first mission; others count up (default: 1000)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
