"""A training step on whole episodes against a plain padded implementation of the paper."""

import argparse
from typing import Any

import torch
from lerobot.utils.constants import ACTION, OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS

from benchmarks.measuring import contest
from benchmarks.padded import PaddedBatch, PaddedLangDT, PaddedLisa, pad
from benchmarks.policies import AS_IN_THE_PAPER, NAMES, Training, step
from benchmarks.table import Row, ratio_row
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.policies.base_modeling import EpisodePolicy


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(kind, options) for kind in NAMES]


def _row(kind: str, options: argparse.Namespace) -> Row:
    training = Training(kind, options, **AS_IN_THE_PAPER)
    policy, batch = training.policy, training.batch()
    optimizer, parameters = training.optimizer(), list(policy.parameters())
    policy.forward(batch)  # k-means places the codes
    plain = padded_copy(policy).train()
    plain_parameters = list(plain.parameters())
    plain_optimizer = torch.optim.Adam(plain_parameters, lr=1e-4)
    ready = padded_batch(policy, batch)
    lengths = training.lengths(batch)
    result = contest(
        lambda: step(parameters, optimizer, policy.forward(batch)[0]),
        lambda: step(plain_parameters, plain_optimizer, plain(ready)),
        options.repeats,
    )
    return ratio_row(
        f"training step, {NAMES[kind]}, {len(lengths)} whole episodes",
        "the paper's networks on padded episodes",
        4,
        result,
        "steps",
        frames=int(lengths.sum()),
        padding=1 - int(lengths.sum()) / (len(lengths) * int(lengths.max())),
    )


def padded_copy(policy: EpisodePolicy) -> PaddedLisa | PaddedLangDT:
    """The plain implementation with the policy's weights."""
    network: Any = policy.network
    return PaddedLisa(network) if isinstance(network, Lisa) else PaddedLangDT(network)


def padded_batch(policy: EpisodePolicy, batch: dict[str, Any]) -> PaddedBatch:
    """What `policy.forward` trains on for this batch, padded."""
    frames, packing = policy.gather(batch)
    actions = frames.pop(ACTION)
    words, valid = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK].bool()
    return pad(words, valid, frames, actions, packing)
