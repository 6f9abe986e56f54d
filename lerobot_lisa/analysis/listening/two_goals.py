"""Worlds that hold two goals at once: the policy is told one of them, and both are watched."""

from pathlib import Path

import pandas as pd

from lerobot_lisa.analysis.files import aside
from lerobot_lisa.analysis.recording.environment import Moment
from lerobot_lisa.analysis.recording.traces import KEY

GOALS = ("original", "other")
_FILE = "goals.parquet"


class GoalWatcher:
    """Watches a recording of worlds with two goals and keeps, beside the trace, which ones each episode has reached."""

    def __init__(self, folder: Path) -> None:
        """Go on with what is in the trace's folder."""
        self._path = folder / _FILE
        self._live: list[int] = []
        self._rows = pd.read_parquet(self._path) if self._path.is_file() else pd.DataFrame()

    @property
    def reached(self) -> pd.DataFrame:
        """Columns `GOALS`, whether each was reached; a row for each episode, by `traces.KEY`."""
        return self._rows.drop_duplicates(KEY, keep="last").set_index(KEY)

    def before_step(self, moment: Moment) -> None:
        """Note which environments count: LeRobot fills up its last batch."""
        if moment.step == 0:
            self._live = moment.live

    def after_rollout(self, moment: Moment) -> None:
        """Ask the worlds, and write."""
        group, task_id, first = moment.batch
        goals = pd.DataFrame(list(moment.env.call("reached")), columns=list(GOALS)).iloc[self._live]
        rows = goals.assign(group=group, task_id=task_id, episode=[first + index for index in self._live])
        self._rows = pd.concat([self._rows, rows], ignore_index=True)
        with aside(self._path) as partial:
            self._rows.to_parquet(partial)
