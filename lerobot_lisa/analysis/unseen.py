"""How many of an environment's instructions a dataset does not hold (paper, table 3).

lisa-unseen --dataset.root=data/bosslevel_1k --level=BossLevel --n=10000
lisa-unseen --dataset.root=data/lorel_states --suite=rephrasals
"""

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from dataset_converters.seeds import FIRST_TRAINING_SEED
from lerobot_lisa.analysis.commands import check_number, run_command
from lerobot_lisa.analysis.files import write_json
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.analysis.training_data import DatasetOptions
from lerobot_lisa.code_version import made
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.errors import UserError

PAPER = {
    "GoToSeq": {1_000: 76.0, 10_000: 63.8, 100_000: 48.0},
    "SynthSeq": {1_000: 76.3, 10_000: 66.0, 100_000: 50.7},
    "BossLevel": {1_000: 77.3, 10_000: 66.9, 100_000: 51.3},
}
"""Unseen instructions in percent by level and number of demonstrations (paper, table 3)."""

_Labelled = Iterable[tuple[str, str]]  # instructions with their kinds


@dataclass
class UnseenConfig:
    """Whose instructions to look for in which dataset."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    """The demonstrations."""

    level: str | None = None
    """BabyAI level whose missions are drawn, such as BossLevel."""

    suite: str | None = None
    """LOReL suite whose instructions are looked up, all of them."""

    n: int = 10_000
    """Missions drawn."""

    json: Path | None = None
    """File for the shares as JSON, too."""

    seed: int = 1000
    """Of the first mission; the others count up. Demonstrations are made with seeds above those allowed here."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if self.dataset.root is None:
            raise UserError("--dataset.root is missing: name the folder of a LeRobotDataset")
        if (self.level is None) == (self.suite is None):
            raise UserError("give either --level, of BabyAI, or --suite, of LOReL")
        if self.suite is not None and self.suite not in SUITES:
            raise UserError(f"--suite={self.suite}: choose from {', '.join(SUITES)}")
        check_number("n", self.n, 1, FIRST_TRAINING_SEED)
        check_number("seed", self.seed, 0, FIRST_TRAINING_SEED - self.n)


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
    for kind, listed in _by_kind(labelled, seen).items():
        share = success_rate(listed) if drawn else f"{sum(listed)} of {len(listed)}".rjust(9)
        yield f"{share}  unseen, of {kind}"


def _by_kind(labelled: _Labelled, seen: frozenset[str]) -> dict[str, list[bool]]:
    """Which instructions are unseen: all of them, then those of each kind."""
    by_kind: dict[str, list[bool]] = {}
    for instruction, kind in labelled:
        by_kind.setdefault(kind, []).append(instruction not in seen)
    everything = [unseen for listed in by_kind.values() for unseen in listed]
    return {"all": everything, **dict(sorted(by_kind.items()))}


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run, interrupted="interrupted")


def run(config: UnseenConfig) -> None:
    """Draw, compare and print.

    Raises:
        UserError: The dataset or the level cannot be used.
    """
    root = Path(str(config.dataset.root))
    seen, episodes = read_instructions(root)
    if config.suite:
        about = f"suite {config.suite}:"
        labelled: _Labelled = [(task.instruction, task.kind) for task in SUITES[config.suite]]
    else:
        about = f"{config.n:,} fresh {config.level} missions, of seeds {config.seed} to {config.seed + config.n - 1}:"
        labelled = list(draw_missions(str(config.level), config.n, config.seed))
    lines = list(report(labelled, seen, drawn=not config.suite))
    print(f"{root}: {episodes:,} demonstrations with {len(seen):,} distinct instructions", about, *lines, sep="\n")
    if config.json:
        rates = {kind: {"unseen": asdict(success_rate(listed))} for kind, listed in _by_kind(labelled, seen).items()}
        rates["overall"] = rates.pop("all")
        write_json({"rates": rates, "made": made()}, config.json, indent=2)
    if published := PAPER.get(str(config.level), {}).get(episodes):
        print(f"The paper has {published} % with as many demonstrations.")


if __name__ == "__main__":
    sys.exit(main())
