"""How much faster the bulk writer and the demonstration bot are than LeRobot's writer and minigrid's bot.

    python benchmarks/dataset_writing.py [--level GoToSeq] [--episodes 20] [--repeats 3] [--json]

Both sides do the same work, on the same episodes, alternately and in the same process; a line is the median ratio.
"""

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("HF_HUB_OFFLINE", "1")

from lerobot.datasets.lerobot_dataset import LeRobotDataset
from minigrid.utils.baby_ai_bot import BabyAIBot

from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import Demonstration
from dataset_converters.babyai.schema import FEATURES, FPS, babyai_layout, to_episodes
from dataset_converters.writer import write_dataset
from lerobot_lisa.envs.babyai.levels import make_level

FIRST_SEED = 1_000_000


def write_with_lerobot(demos: list[Demonstration], root: Path) -> None:
    dataset = LeRobotDataset.create("me/benchmark", fps=FPS, features=FEATURES, root=root, use_videos=False)
    for demo in demos:
        for grid, direction, action in zip(demo.grid, demo.direction, demo.action, strict=True):
            observed = {"observation.grid": grid, "observation.direction": direction.reshape(1)}
            dataset.add_frame({**observed, "action": action.reshape(1), "task": demo.instruction})
        dataset.save_episode()
    dataset.finalize()


def write_in_bulk(demos: list[Demonstration], root: Path) -> None:
    write_dataset(root, babyai_layout("me/benchmark"), to_episodes((demo, None) for demo in demos))


def demonstrate_with_minigrid(name: str, episodes: int) -> None:
    """minigrid's bot in minigrid's own environment, without our faster view."""
    import contextlib

    import gymnasium as gym

    level = gym.make(f"BabyAI-{name}-v0").unwrapped
    for seed in range(FIRST_SEED, FIRST_SEED + episodes):
        with contextlib.redirect_stdout(None):  # its reset prints every rejected world
            level.reset(seed=seed)
        bot, over = BabyAIBot(level), False
        while not over:
            _, _, terminated, truncated, _ = level.step(bot.replan())
            over = terminated or truncated


def demonstrate_fast(name: str, episodes: int) -> list[Demonstration]:
    level = make_level(name)
    tried = (demonstrate(level, name, seed) for seed in range(FIRST_SEED, FIRST_SEED + episodes))
    return [demo for demo in tried if demo is not None]


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """(CPU seconds, wall seconds) that `work` takes."""
    cpu, wall = time.process_time(), time.perf_counter()
    work()
    return time.process_time() - cpu, time.perf_counter() - wall


def compare(slow: Callable[[], object], fast: Callable[[], object], amount: int, repeats: int) -> dict[str, float]:
    """Median rates (amount per CPU second) and ratios over alternating runs."""
    pairs = [(seconds(slow), seconds(fast)) for _ in range(repeats)]
    return {
        "reference_per_cpu_second": statistics.median(amount / slow_cpu for (slow_cpu, _), _ in pairs),
        "ours_per_cpu_second": statistics.median(amount / fast_cpu for _, (fast_cpu, _) in pairs),
        "cpu_ratio": statistics.median(slow_cpu / fast_cpu for (slow_cpu, _), (fast_cpu, _) in pairs),
        "wall_ratio": statistics.median(slow_wall / fast_wall for (_, slow_wall), (_, fast_wall) in pairs),
    }


def run(level: str, episodes: int, repeats: int) -> dict[str, dict[str, float]]:
    demos = demonstrate_fast(level, episodes)
    frames = sum(len(demo.action) for demo in demos)
    with tempfile.TemporaryDirectory() as folder:
        roots = (Path(folder) / str(i) for i in range(2 * repeats + 2))
        write_in_bulk(demos, next(roots))  # the first write of a process imports and compiles
        write_with_lerobot(demos[:1], next(roots))
        writing = compare(
            lambda: write_with_lerobot(demos, next(roots)), lambda: write_in_bulk(demos, next(roots)), frames, repeats
        )
    bot = compare(
        lambda: demonstrate_with_minigrid(level, episodes), lambda: demonstrate_fast(level, episodes), episodes, repeats
    )
    return {f"writing {level}, frames": writing, f"demonstrating {level}, episodes": bot}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--level", default="GoToSeq")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    options = parser.parse_args()
    results = run(options.level, options.episodes, options.repeats)
    if options.json:
        print(json.dumps(results, indent=2))
        return
    for what, numbers in results.items():
        print(
            f"{what}: {numbers['ours_per_cpu_second']:,.0f} per CPU second, "
            f"{numbers['cpu_ratio']:.1f} x the reference's {numbers['reference_per_cpu_second']:,.1f} "
            f"({numbers['wall_ratio']:.1f} x by wall clock)"
        )


if __name__ == "__main__":
    main()
