"""`select_action` late in a long episode, against predicting from the whole history at every step."""

import argparse
from typing import Any

import torch
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor

from benchmarks.measuring import contest, measure, middle
from benchmarks.policies import NAMES, Training
from benchmarks.table import Row, ratio_row
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.policies.base_modeling import EpisodePolicy

LATE, LATER, STEPS, ENVIRONMENTS = 500, 1000, 20, 50


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(kind, options) for kind in NAMES]


def _row(kind: str, options: argparse.Namespace) -> Row:
    training = Training(kind, options)
    policy: EpisodePolicy = training.policy
    batch = training.batch(ENVIRONMENTS)
    policy.forward(batch)  # k-means places the codes
    rollout = Rollout(policy, batch)
    rollout.advance(LATE - 1)
    torch.testing.assert_close(rollout.remembering(), rollout.recomputed(), atol=1e-5, rtol=1e-5)
    result = contest(lambda: rollout.advance(STEPS), lambda: _once(rollout), options.repeats, warm_up=False)
    rollout.advance(LATER - rollout.steps)
    later = [measure(lambda: rollout.advance(STEPS)) for _ in range(options.repeats)]
    return ratio_row(
        f"`select_action` at step {LATE}, {NAMES[kind]}, {ENVIRONMENTS} environments",
        "predicting from the whole history",
        20,
        result,
        "steps",
        **{f"time at step {LATER} / at step {LATE}": middle(later).cpu / middle(result.ours).cpu},
    )


def _once(rollout: "Rollout") -> int:
    rollout.recomputed()
    return 1


class Rollout:
    """Episodes side by side in which a policy acts on random grids, and all that it has seen and done.

    Args:
        policy: Knows where its codes are.
        batch: From its preprocessor; its instructions are followed.
    """

    def __init__(self, policy: EpisodePolicy, batch: dict[str, Any]) -> None:
        self.policy = policy.eval()
        self.words = {key: batch[key] for key in (OBS_LANGUAGE_TOKENS, OBS_LANGUAGE_ATTENTION_MASK)}
        self.seen: list[dict[str, Tensor]] = []
        self.done: list[Tensor] = []
        self._random = torch.Generator().manual_seed(0)
        environments = len(batch[OBS_LANGUAGE_TOKENS])
        features = policy.config.input_features.items()
        self._shapes = {key: (environments, *feature.shape) for key, feature in features}
        policy.reset()

    @property
    def steps(self) -> int:
        """How many have been taken."""
        return len(self.done)

    def _look(self) -> dict[str, Tensor]:
        seen = {key: torch.randint(0, 4, shape, generator=self._random) for key, shape in self._shapes.items()}
        self.seen.append({key: value.to(torch.uint8) for key, value in seen.items()})
        return {**self.seen[-1], **self.words}

    def advance(self, count: int) -> int:
        """Take some steps."""
        for _ in range(count):
            self.done.append(self.policy.select_action(self._look()))
        return count

    def remembering(self) -> Tensor:
        """Take a step; returns what its actions are drawn from."""
        outputs = self.policy.action_outputs(self._look())
        self.done.append(self.policy._history.actions)
        return outputs

    @torch.no_grad()
    def recomputed(self) -> Tensor:
        """The same for the newest step, by the forward pass of training over everything seen and done."""
        environments = len(self.done[0])
        columns = {key: torch.stack([seen[key] for seen in self.seen], 1).flatten(0, 1) for key in self.seen[0]}
        actions = torch.stack(self.done, 1).flatten(0, 1)
        packing = Packing(torch.full((environments,), self.steps))
        tokens, valid = self.words.values()
        outputs, _, _ = self.policy.predict(tokens, valid.bool(), columns, actions, packing)
        return outputs.unflatten(0, (environments, -1))[:, -1]
