"""Records an evaluation batch by batch; an interrupted one goes on where it was."""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import draccus
from filelock import FileLock, Timeout
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from tqdm import tqdm

from lerobot_lisa.analysis.files import aside
from lerobot_lisa.analysis.recording import traces
from lerobot_lisa.analysis.recording.environment import Batch, Watcher
from lerobot_lisa.analysis.recording.evaluation import Evaluation, EvaluationConfig, code_labels, load, run_batch
from lerobot_lisa.analysis.recording.traces import EPISODES, EPISODES_FILE, STEPS, STEPS_FILE, Trace
from lerobot_lisa.checkpoints.identity import identify
from lerobot_lisa.errors import UserError

NOTE, _LOCK, _PARTS = "evaluation.json", "lock", "parts"
_SCHEMAS = {EPISODES_FILE: EPISODES, STEPS_FILE: STEPS}


def record(
    config: EvaluationConfig,
    folder: Path,
    watchers: Sequence[Watcher] = (),
    evaluation: Evaluation | None = None,
    **more: Any,
) -> Trace:
    """Evaluate and record, or read what an equal evaluation has recorded before.

    Every batch of episodes is written when it ends, so that a later call with the same origin goes on after it. It
    gives the same trace as a call that was never interrupted, and the same successes as `lerobot-eval`.

    Args:
        config: What to evaluate.
        folder: For the trace.
        watchers: Told about every step, but not about those of batches that were recorded before.
        evaluation: What `load` returned; None: load it if there is something to do.
        more: What else tells this evaluation from others, JSON values, such as a fixed skill code.

    Raises:
        UserError: The folder belongs to another evaluation or is in use, or the evaluation cannot work.
    """
    origin = describe(config, **more)
    _check(folder, _text(origin))
    if evaluation is None and not (folder / STEPS_FILE).is_file():
        evaluation = load(config)  # before the folder is claimed: a mistake leaves nothing in it
    with _claimed(folder, _text(origin)):
        if not (folder / STEPS_FILE).is_file():
            _record_batches(config, folder, watchers, evaluation or load(config), origin)
        return traces.read(folder)


def describe(config: EvaluationConfig, **more: Any) -> dict[str, Any]:
    """How an evaluation comes about, JSON values: the same origin gives the same trace."""
    from importlib.metadata import version

    assert config.policy is not None  # refused by EvaluationConfig
    return {
        "policy_path": config.checkpoint,
        "checkpoint": identify(config.policy)._asdict(),
        "policy": draccus.encode(config.policy, PreTrainedConfig),
        "env": draccus.encode(config.env, EnvConfig),
        "n_episodes": config.n_episodes,
        "batch_size": config.batch_size,
        "seed": config.seed,
        "versions": {name: version(name) for name in ("lerobot", "lerobot_policy_lisa", "torch")},
        **more,
    }


def _record_batches(
    config: EvaluationConfig, folder: Path, watchers: Sequence[Watcher], evaluation: Evaluation, origin: dict[str, Any]
) -> None:
    parts = folder / _PARTS
    parts.mkdir(exist_ok=True)
    batches = _batches(config, evaluation)
    codes = code_labels(evaluation.policy)
    # Numbered: a task group may be called anything, "../../escape" included.
    files = {name: [parts / f"{number:06d}.{name}" for number in range(len(batches))] for name in _SCHEMAS}
    for number, batch in enumerate(tqdm(batches, desc="evaluating", unit="batch", disable=None)):
        if files[STEPS_FILE][number].is_file():
            continue
        steps, episodes = run_batch(config, evaluation, batch, number, watchers)
        traces.write(episodes, files[EPISODES_FILE][number], origin)
        traces.write(steps, files[STEPS_FILE][number], origin)  # last: it says that the batch is done
        if batch.first + config.batch_size >= config.n_episodes:
            evaluation.envs[batch.group][batch.task_id].close()
    for name, schema in _SCHEMAS.items():  # the steps come last: they say that the evaluation is done
        tables = [traces.read_table(part, schema)[0] for part in files[name]]
        traces.write(traces.concatenate(tables, schema), folder / name, {**origin, "codes": codes})
    shutil.rmtree(parts)


def _batches(config: EvaluationConfig, evaluation: Evaluation) -> list[Batch]:
    """All batches, in the order in which `lerobot-eval` runs them."""
    tasks = [(group, task_id) for group, envs in evaluation.envs.items() for task_id in envs]
    return [Batch(*task, first) for task in tasks for first in range(0, config.n_episodes, config.batch_size)]


def _text(origin: Mapping[str, Any]) -> str:
    return json.dumps(origin, indent=2, sort_keys=True) + "\n"


def _check(folder: Path, origin: str) -> None:
    """Refuse a folder that belongs to something else."""
    note = folder / NOTE
    if folder.exists() and not note.is_file() and any(path.name != _LOCK for path in folder.iterdir()):
        raise UserError(f"{folder} is in the way and was not made by this program: choose another --output_dir")
    if note.is_file() and note.read_text(encoding="utf-8") != origin:
        differing = _differences(json.loads(note.read_text(encoding="utf-8")), json.loads(origin))
        raise UserError(f"{folder} holds another evaluation ({differing}): choose another --output_dir")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a folder for one process at a time.

    Raises:
        UserError: Another one is at work there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / _LOCK, timeout=0):
            yield
    except Timeout:
        raise UserError(f"{folder}: another process is recording there; wait or choose another --output_dir") from None


@contextmanager
def _claimed(folder: Path, origin: str) -> Iterator[None]:
    """Keep a folder for one evaluation, and for one process at a time."""
    with locked(folder):
        _check(folder, origin)
        with aside(folder / NOTE) as partial:
            partial.write_text(origin, encoding="utf-8")
        try:
            yield
        except UserError:
            _leave(folder)
            raise


def _leave(folder: Path) -> None:
    """Keep no claim to a folder in which nothing has been recorded: the mistake may be mended by another option."""
    if not any(path.is_file() and path.name not in (NOTE, _LOCK) for path in folder.rglob("*")):
        shutil.rmtree(folder / _PARTS, ignore_errors=True)
        (folder / NOTE).unlink()


def _differences(before: Any, now: Any, name: str = "") -> str:
    """What differs between two JSON values, by name; of long values only the name."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)]
        return ", ".join(_differences(before.get(key), now.get(key), f"{name}.{key}".lstrip(".")) for key in keys)
    shown = f"{before!r}, now {now!r}"
    return f"{name} was {shown}" if len(shown) < 200 else f"{name} differs"
