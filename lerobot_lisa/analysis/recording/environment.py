"""Notes every step of environments while somebody else, LeRobot's evaluation, runs a policy in them."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import blake2b
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_lisa.analysis.recording.traces import STEPS

TASK_NAMES = ("task_description", "task")
"""What LeRobot asks environments for, in this order, to tell policies their instruction."""


class Batch(NamedTuple):
    """Which episodes a rollout runs side by side.

    Attributes:
        group: Task group.
        task_id: Task in its group.
        first: Number of the first environment's episode; the others count up.
    """

    group: str
    task_id: int
    first: int

    @property
    def folder(self) -> str:
        """A name for the task's files, whatever its group is called, "../../escape" included."""
        plain = re.sub(r"[^\w.-]", "_", self.group).lstrip(".")[:80]
        told_apart = "" if plain == self.group else "_" + blake2b(self.group.encode(), digest_size=4).hexdigest()
        return f"{plain}{told_apart}_{self.task_id}"


class Looks(NamedTuple):
    """Where a policy looked before its latest actions.

    Attributes:
        attention: (B, places) for each observation feature.
        questions: (B,) how many questions were asked; each has an attention of 1, for places or for nothing.
    """

    attention: Mapping[str, NDArray[np.float32]]
    questions: NDArray[np.int64]


class Insight(NamedTuple):
    """Where to ask what goes on in a policy.

    Attributes:
        codes: Returns the skill codes that the latest actions followed, a tensor (B,), or None.
        labels: What the K codes are called.
        looks: Returns where it looked before the latest actions, or None.
    """

    codes: Callable[[], Any]
    labels: Sequence[str]
    looks: Callable[[], Looks | None] = lambda: None


class Moment(NamedTuple):
    """The state of a rollout between two steps.

    Attributes:
        env: The vectorised environment; show its worlds with `render(env, index)`.
        batch: What is being run.
        step: Steps done.
        live: Environments whose episode goes on and counts.
        codes: Skill code (B,) that the next step follows; None for a policy without, and when all is over.
        instructions: What the policy was told in each environment.
        labels: What the K codes are called.
        observation: What the next step is chosen on, as the environment shows it.
        looks: Where the policy looked in it; None when all is over, or if it asks nothing.
    """

    env: Any
    batch: Batch
    step: int
    live: list[int]
    codes: NDArray[np.int64] | None
    instructions: list[str]
    labels: Sequence[str] = ()
    observation: Any = None
    looks: Looks | None = None


class Watcher(Protocol):
    """Somebody who also wants to see the steps, such as a collector of frames."""

    def before_step(self, moment: Moment) -> None:
        """Look at an environment just before it acts."""

    def after_rollout(self, moment: Moment) -> None:
        """Look at an environment when all its episodes have ended."""


class _Row(NamedTuple):
    environment: int
    values: tuple[Any, ...]


class RecordingEnv:
    """A vectorised environment that keeps a trace of the current rollout; otherwise it is the one it wraps.

    It takes the place of LeRobot's `VectorEnv`s and of its lazily built ones alike, in one process or several. Steps
    after an episode's end, when LeRobot waits for slower environments of the batch, are left out.
    """

    def __init__(
        self, env: Any, insight: Insight, batch: Batch, episodes: int, watchers: Sequence[Watcher] = ()
    ) -> None:
        """Wrap an environment.

        Args:
            env: What LeRobot would evaluate in.
            insight: Where to ask what goes on in the policy.
            batch: Which episodes it will run.
            episodes: How many environments count, the first ones: LeRobot fills up its last batch.
            watchers: Told about every step.
        """
        self._env, self._insight, self._watchers = env, insight, tuple(watchers)
        self._batch, self._episodes = batch, episodes
        self._rows: list[_Row] = []
        self._seeds: list[int | None] = []
        self._instructions = [""] * env.num_envs
        self._observation: Any = None
        self._live = np.zeros(env.num_envs, bool)
        self._step = 0

    def __getattr__(self, name: str) -> Any:
        """Everything else is the wrapped environment's."""
        return getattr(self._env, name)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start a rollout, and a new trace."""
        self._observation, info = self._env.reset(seed=seed, options=options)
        self._seeds = list(seed) if isinstance(seed, (list, tuple, range)) else [seed] * self._env.num_envs
        self._rows, self._step = [], 0
        self._live = np.arange(self._env.num_envs) < self._episodes
        return self._observation, info

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """Ask every environment; the instructions that LeRobot asks for before each step are noted."""
        answers = self._env.call(name, *args, **kwargs)
        if name in TASK_NAMES:
            self._instructions = [str(answer) for answer in answers]
        return answers

    def step(self, actions: NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Act once, noting what LeRobot knew and did."""
        live, codes = np.flatnonzero(self._live).tolist(), self._current_codes()
        if self._watchers:
            moment = self._moment(live, codes)._replace(observation=self._observation, looks=self._insight.looks())
            for watcher in self._watchers:
                watcher.before_step(moment)
        known = [(hash_observation(self._observation, i), np.array(actions[i], np.float32).ravel()) for i in live]
        result = self._env.step(actions)
        self._observation, _, terminated, truncated, info = result
        successes = step_successes(info, self._env.num_envs)
        for i, (observation, action) in zip(live, known, strict=True):
            code = None if codes is None else int(codes[i])
            values = (self._seeds[i], self._step, self._instructions[i], code, observation, action, bool(successes[i]))
            self._rows.append(_Row(i, values))
        self._live &= ~(np.asarray(terminated, bool) | np.asarray(truncated, bool))
        self._step += 1
        return result

    def end_rollout(self) -> None:
        """Tell the watchers that all episodes have ended."""
        for watcher in self._watchers:
            watcher.after_rollout(self._moment([], None))

    def trace(self) -> pa.Table:
        """The rollout since the last reset, columns of `STEPS`, episode after episode."""
        group, task_id, first = self._batch
        rows = sorted(self._rows, key=lambda row: row.environment)  # stable: steps stay in order
        listed = [(group, task_id, first + row.environment, *row.values) for row in rows]
        columns = list(zip(*listed, strict=True)) or [()] * len(STEPS)
        return pa.table([pa.array(column, kind) for column, kind in zip(columns, STEPS.types, strict=True)], STEPS)

    def _moment(self, live: list[int], codes: NDArray[np.int64] | None) -> Moment:
        return Moment(self._env, self._batch, self._step, live, codes, self._instructions, self._insight.labels)

    def _current_codes(self) -> NDArray[np.int64] | None:
        codes = self._insight.codes()
        return None if codes is None else np.asarray(codes.cpu())


def hash_observation(observation: Any, index: int) -> int:
    """64 bits that tell observations apart: of one environment's part of a batch, arrays or nested dicts of them."""
    digest = blake2b(digest_size=8)
    for name, array in _leaves(observation):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array[index]).tobytes())
    return int.from_bytes(digest.digest(), "little")


def _leaves(observation: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(observation, Mapping):
        for key in sorted(observation):
            yield from _leaves(observation[key], f"{name}/{key}")
    else:
        yield name, observation


def step_successes(info: Mapping[str, Any], environments: int) -> NDArray[np.bool_]:
    """Success (B,) in a vectorised environment's info, where LeRobot looks for it."""
    final = info.get("final_info")
    found = (final if isinstance(final, Mapping) else info).get("is_success", False)
    return np.broadcast_to(np.asarray(found, bool), (environments,))


def render(env: Any, index: int) -> NDArray[np.uint8]:
    """Draw the world of one environment of a vectorised one, (height, width, 3)."""
    worlds = getattr(env, "envs", None)  # environments in processes can only be asked all at once
    return worlds[index].render() if worlds else env.call("render")[index]
