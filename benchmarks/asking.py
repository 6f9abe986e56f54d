"""A training step in which words and skill codes ask what is seen, against the step of the paper's networks."""

import argparse

from benchmarks.measuring import contest
from benchmarks.policies import AS_IN_THE_PAPER, NAMES, Training, step
from benchmarks.table import Row, ratio_row


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(kind, options) for kind in NAMES]


def _row(kind: str, options: argparse.Namespace) -> Row:
    sides = []
    for settings in ({}, AS_IN_THE_PAPER):
        training = Training(kind, options, **settings)
        batch = training.batch()
        training.policy.forward(batch)  # k-means places the codes
        sides.append((training.policy, training.optimizer(), list(training.policy.parameters()), batch))
    ours, theirs = (
        lambda side=side: step(side[2], side[1], side[0].forward(side[3])[0])  # type: ignore[misc]
        for side in sides
    )
    result = contest(ours, theirs, options.repeats)
    # At most 1.5 times the time: at least two thirds of the speed.
    return ratio_row(f"training step, {NAMES[kind]}, asking", "the paper's networks", 1 / 1.5, result, "steps")
