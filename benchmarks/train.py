"""`lerobot-train` against the same model fed one ready batch in a bare loop, and how long it waits for data."""

import argparse
import logging
import re
import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.scripts.lerobot_train import train

from benchmarks.measuring import Seconds, measure, middle
from benchmarks.policies import BATCH_SIZE, CONFIGS, NAMES, Training, step
from benchmarks.table import Aim, Row

WARM_UP = 3
LOG_LINE = re.compile(r"updt_s:([\d.]+) data_s:([\d.]+)")


def rows(options: argparse.Namespace) -> list[Row]:
    return [row for kind in NAMES for row in _rows(kind, options)]


def _rows(kind: str, options: argparse.Namespace) -> list[Row]:
    bare, frames = bare_steps(kind, options)
    steps, waiting = lerobot_steps(kind, options, 4 * options.repeats)
    limit, real = middle(bare), middle(steps)
    name = f"`lerobot-train` step, {NAMES[kind]}, batch {BATCH_SIZE}"
    details = {"steps": len(steps), "frames in the ready batch": frames}
    ratio = Row(
        name,
        "the same model in a bare loop, fed one ready batch (the limit)",
        Aim("at least", 0.9, "of the limit"),
        limit.cpu / real.cpu,
        limit.wall / real.wall,
        f"{real.cpu:.3g} CPU-s/step",
        f"{limit.cpu:.3g} CPU-s/step",
        details,
    )
    share = 100 * statistics.median(waiting)  # by the clock: the log has nothing else
    return [ratio, Row(f"{name}: waiting for data", "", Aim("at most", 3, "%"), share, share)]


def bare_steps(kind: str, options: argparse.Namespace) -> tuple[list[Seconds], int]:
    """Seconds of each training step on one batch, and its number of frames."""
    training = Training(kind, options)
    policy, batch = training.policy, training.batch()
    optimizer, parameters = training.optimizer(), list(policy.parameters())

    def one() -> None:
        step(parameters, optimizer, policy.forward(batch)[0])

    for _ in range(WARM_UP):
        one()
    return [measure(one) for _ in range(4 * options.repeats)], int(training.lengths(batch).sum())


def lerobot_steps(kind: str, options: argparse.Namespace, count: int) -> tuple[list[Seconds], list[float]]:
    """Seconds of each step of `lerobot-train`, and the share of each spent in the loader and the preprocessor."""
    clock = _Clock()
    with tempfile.TemporaryDirectory() as folder:
        config = TrainPipelineConfig(
            dataset=DatasetConfig(options.repo_id, root=str(options.root)),
            policy=CONFIGS[kind](language_encoder="words", device="cpu", push_to_hub=False),
            output_dir=Path(folder) / "run",
            batch_size=BATCH_SIZE,
            steps=WARM_UP + count,
            num_workers=0,
            log_freq=1,
            save_checkpoint=False,
            env_eval_freq=0,
            seed=0,
        )
        logger, factory = logging.getLogger(), logging.getLogRecordFactory()
        handlers, level = list(logger.handlers), logger.level
        logging.setLogRecordFactory(clock.note(factory))
        try:
            train(config)
        finally:
            logging.setLogRecordFactory(factory)
            logger.handlers[:] = handlers
            logger.setLevel(level)
    return clock.steps[-count:], clock.waiting[-count:]


class _Clock:
    """Reads the clocks whenever LeRobot logs a step; it clears all handlers, so that one of ours would not do."""

    def __init__(self) -> None:
        self.steps: list[Seconds] = []
        self.waiting: list[float] = []
        self._last = Seconds.now()

    def note(self, make: Callable[..., logging.LogRecord]) -> Callable[..., logging.LogRecord]:
        """A maker of log records that also looks at them."""

        def record(*arguments: Any, **keywords: Any) -> logging.LogRecord:
            made = make(*arguments, **keywords)
            found = LOG_LINE.search(made.getMessage())
            if found:
                now = Seconds.now()
                self.steps.append(now.since(self._last))
                update, data = float(found[1]), float(found[2])
                self.waiting.append(data / (update + data))
                self._last = now
            return made

        return record
