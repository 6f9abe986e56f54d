"""What LeRobot's commands make of their options and of a recipe."""

from functools import cache
from pathlib import Path

import draccus
from lerobot.configs.train import TrainPipelineConfig

import lerobot_lisa  # noqa: F401  registers policies and environments


def read_training(recipe: str | Path, *options: str) -> TrainPipelineConfig:
    """What `lerobot-train --config_path=RECIPE` reads."""
    with draccus.config_type("yaml"):
        return _parser().parse_args([f"--config_path={recipe}", *options])


@cache  # LeRobot makes one for each command, which takes half a second: it looks for descriptions in all source files
def _parser() -> draccus.argparsing.ArgumentParser:
    return draccus.argparsing.ArgumentParser(TrainPipelineConfig)
