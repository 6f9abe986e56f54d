"""A training step whose transformer blocks went through `torch.compile`, against the step as it is."""

import argparse
from copy import deepcopy

from benchmarks.measuring import contest
from benchmarks.policies import NAMES, Training, step
from benchmarks.table import Row, ratio_row
from lerobot_lisa.networks.transformer import Block


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(kind, options) for kind in NAMES]


def _row(kind: str, options: argparse.Namespace) -> Row:
    training = Training(kind, options)
    batch = training.batch()
    plain = training.policy
    plain.forward(batch)  # k-means places the codes
    compiled = deepcopy(plain)
    for block in [module for module in compiled.modules() if isinstance(module, Block)]:
        block.compile(dynamic=True)  # every batch has episodes of other lengths
    sides = []
    for policy in (compiled, plain):
        training.policy = policy
        sides.append((policy, training.optimizer(), list(policy.parameters())))
    ours, theirs = (
        lambda side=side: step(side[2], side[1], side[0].forward(batch)[0])  # type: ignore[misc]
        for side in sides
    )
    result = contest(ours, theirs, options.repeats)  # whose warm-up compiles
    return ratio_row(f"training step, {NAMES[kind]}, blocks compiled", "not compiled, as it is", 1, result, "steps")
