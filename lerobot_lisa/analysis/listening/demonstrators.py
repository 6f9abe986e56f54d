"""How many steps a world's demonstrator needs in the episodes of an evaluation, noted beside its trace."""

import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from lerobot.envs.configs import EnvConfig
from tqdm import tqdm

from lerobot_lisa.analysis.files import write_json
from lerobot_lisa.analysis.recording.traces import KEY

_FILE = "demonstrator.json"


def demonstrator_steps(env: EnvConfig, episodes: pd.DataFrame, folder: Path) -> pd.Series | None:
    """Steps of the demonstrator from the same seeds.

    Args:
        env: The environment.
        episodes: Columns of `traces.EPISODES`.
        folder: What is known is read from there, and what was found out is noted, also after an interruption.

    Returns:
        Steps by `traces.KEY`, nan where the demonstrator fails; None: this world has no demonstrator.
    """
    if env.type not in _DEMONSTRATORS:
        return None
    return _DEMONSTRATORS[env.type](env, episodes, folder).astype(float)


def _babyais_bot(env: Any, episodes: pd.DataFrame, folder: Path) -> pd.Series:
    from lerobot_lisa.analysis.listening import babyai

    levels = env.levels
    wanted = [(levels[row.task_id], int(row.seed)) for row in episodes.itertuples()]
    known = _Notes(folder / _FILE, {"minigrid": version("minigrid")})
    steps = known.look_up(wanted, babyai.demonstrator_steps)
    return pd.Series(steps, pd.MultiIndex.from_frame(episodes[KEY]), dtype=float)


def _metaworlds_experts(env: EnvConfig, episodes: pd.DataFrame, folder: Path) -> pd.Series:
    from lerobot_lisa.analysis.listening.metaworld import demonstrator_steps
    from lerobot_lisa.envs.metaworld_states.tasks import tasks_of

    wanted = [(tasks_of(row.group)[row.task_id], int(row.seed)) for row in episodes.itertuples()]
    known = _Notes(folder / _FILE, {name: version(name) for name in ("metaworld", "mujoco")})
    steps = known.look_up(wanted, demonstrator_steps)
    return pd.Series(steps, pd.MultiIndex.from_frame(episodes[KEY]), dtype=float)


_DEMONSTRATORS: dict[str, Callable[[EnvConfig, pd.DataFrame, Path], pd.Series]] = {
    "babyai": _babyais_bot,
    "metaworld": _metaworlds_experts,
    "metaworld_states": _metaworlds_experts,
}


class _Notes:
    """A file of numbers by name and seed, of one version of a world."""

    def __init__(self, path: Path, versions: dict[str, str]) -> None:
        self._path, self._versions = path, versions
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        self._steps: dict[str, dict[str, int | None]] = content["steps"] if content.get("of") == versions else {}

    def look_up(self, wanted: list[tuple[str, int]], find: Callable[[str, int], int | None]) -> list[float]:
        """What `find` says of each, asking it only for what is not noted yet."""
        missing = [(name, seed) for name, seed in wanted if str(seed) not in self._steps.get(name, {})]
        try:
            for name, seed in tqdm(missing, desc="asking the demonstrator", unit="episode", disable=None):
                self._steps.setdefault(name, {})[str(seed)] = find(name, seed)
        finally:
            if missing:
                write_json({"of": self._versions, "steps": self._steps}, self._path)
        found = (self._steps[name][str(seed)] for name, seed in wanted)
        return [np.nan if steps is None else float(steps) for steps in found]
