"""A row's training as LeRobot reads it: a recipe file, and the options in which the row differs from it.

LeRobot cannot put configurations together itself. draccus knows `!include`, but `lerobot-train` first reads the file as
plain YAML, to look for `policy.path`, and stops there. What it does know is options on top of `--config_path`, so rows
are those: nothing but LeRobot is needed to run the command that a row shows.
"""

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

from lerobot_lisa.errors import UserError

WITHOUT_EFFECT = ("output_dir", "log_freq", "save_freq", "eval", "env", "wandb", "job_name", "num_workers")
"""What changes nothing about a policy that is evaluated afterwards."""


def read_recipe(path: Path) -> dict[str, Any]:
    """A recipe's settings.

    Raises:
        UserError: It cannot be read.
    """
    try:
        recipe = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise UserError(f"{path}: {' '.join(str(error).split())}") from error
    if not isinstance(recipe, dict) or "steps" not in recipe:
        raise UserError(f"{path}: no recipe that `lerobot-train --config_path` reads: `steps` is missing")
    return recipe


def with_options(recipe: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that a recipe and options with dots make together."""
    whole = deepcopy(dict(recipe))
    for option, value in options.items():
        *groups, name = option.split(".")
        place = whole
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = value
    return whole


def what_decides(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Of a training's settings those that its outcome depends on; the dataset is told of elsewhere."""
    kept = {key: value for key, value in settings.items() if key not in WITHOUT_EFFECT}
    kept["dataset"] = {key: value for key, value in kept.get("dataset", {}).items() if key not in ("root", "repo_id")}
    return kept


def in_use(settings: Mapping[str, Any], group: str = "") -> frozenset[str]:
    """Names of the settings that are neither off nor 0 nor empty, with dots: "policy.termination_stride"."""
    names = {f"{group}{name}" for name, value in settings.items() if value}
    groups = [in_use(value, f"{group}{name}.") for name, value in settings.items() if isinstance(value, Mapping)]
    return frozenset(names.union(*groups))


def as_words(options: Mapping[str, Any]) -> list[str]:
    """Options as words of a command line."""
    return [f"--{name}={_as_word(value)}" for name, value in options.items()]


def _as_word(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "null" if value is None else str(value)
