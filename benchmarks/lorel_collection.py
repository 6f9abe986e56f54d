"""How fast random play on the tabletop is collected, and how fast its states are rendered in each image quality.

    python benchmarks/lorel_collection.py [--episodes 2000] [--frames 100] [--json]

Collection is the whole of `python -m dataset_converters.lorel collect` with one worker: simulating, labelling, shards,
writing the dataset. CPU seconds of this process; the time for 50,000 episodes is extrapolated from them.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("HF_HUB_OFFLINE", "1")

from dataset_converters.lorel.collect import CollectSettings, collect
from dataset_converters.lorel.random_play import play
from lerobot_lisa.envs.gl import choose_gl
from lerobot_lisa.envs.lorel.camera import QUALITIES, Camera
from lerobot_lisa.envs.lorel.scene import engine
from lerobot_lisa.envs.lorel.simulator import LorelSimulator

FIRST_SEED = 1_000_000
PUBLISHED_EPISODES = 50_000  # of the original data set


def cpu_seconds(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def collection(episodes: int) -> dict[str, float]:
    """Rates of collecting states, after one episode to import and compile everything."""
    with tempfile.TemporaryDirectory() as folder:
        collect(CollectSettings(1, Path(folder) / "warm", "me/warm", keep_unlabelled=True))
        seconds = cpu_seconds(lambda: collect(CollectSettings(episodes, Path(folder) / "states", "me/states")))
    simulator = LorelSimulator()
    playing = cpu_seconds(lambda: [play(simulator, seed) for seed in range(FIRST_SEED, FIRST_SEED + episodes // 10)])
    return {
        "episodes": episodes,
        "episodes_per_cpu_second": episodes / seconds,
        "episodes_simulated_per_cpu_second": episodes // 10 / playing,
        "extrapolated_cpu_minutes_for_50000": seconds / episodes * PUBLISHED_EPISODES / 60,
    }


def rendering(quality: str, frames: int) -> dict[str, float]:
    """Rate of rendering states of random play, without opening the context."""
    simulator = LorelSimulator()
    states = [
        state for seed in range(FIRST_SEED, FIRST_SEED + frames // 20 + 1) for state in play(simulator, seed).state
    ]
    with Camera(quality) as camera:
        camera.frame(states[0])
        seconds = cpu_seconds(lambda: [camera.frame(state) for state in states[:frames]])
    return {
        "frames": frames,
        "frames_per_cpu_second": frames / seconds,
        "extrapolated_cpu_hours_for_50000": seconds / frames * PUBLISHED_EPISODES * 20 / 3600,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    options = parser.parse_args()
    results = {
        "engine": f"{engine()}, {choose_gl() or 'default OpenGL'}",
        "states": collection(max(options.episodes, 10)),
        "images": {quality: rendering(quality, options.frames) for quality in QUALITIES},
    }
    if options.json:
        print(json.dumps(results, indent=2))
        return
    states = results["states"]
    print(
        f"{results['engine']}\n"
        f"states: {states['episodes_per_cpu_second']:.0f} episodes per CPU second (simulating alone: "
        f"{states['episodes_simulated_per_cpu_second']:.0f}); {PUBLISHED_EPISODES:,} episodes would take "
        f"{states['extrapolated_cpu_minutes_for_50000']:.1f} CPU minutes (extrapolated from {options.episodes:,})"
    )
    for quality, numbers in results["images"].items():
        print(
            f"images, {quality}: {numbers['frames_per_cpu_second']:.1f} frames per CPU second; {PUBLISHED_EPISODES:,} "
            f"episodes would take {numbers['extrapolated_cpu_hours_for_50000']:.1f} CPU hours (extrapolated)"
        )


if __name__ == "__main__":
    main()
