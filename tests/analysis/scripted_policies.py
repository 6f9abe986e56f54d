"""Policies whose listening is known, for LeRobot's own evaluation."""

from functools import cache
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from dataset_converters.babyai.bot import DemonstrationBot
from lerobot_lisa.analysis.listening.babyai import another_instruction
from lerobot_lisa.analysis.recording.evaluation import Evaluation, EvaluationConfig, load
from lerobot_lisa.envs.babyai.env import ACTIONS
from lerobot_lisa.envs.babyai.levels import make_level
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

_NOTHING_MORE = ACTIONS.index("done")


@cache
def obey(level_name: str, seed: int, instruction: str) -> list[int]:
    """What BabyAI's bot does in the world of a seed when told its own or its other instruction; nothing otherwise."""
    level, source = make_level(level_name), make_level(level_name)
    level.reset(seed=seed)
    if instruction != level.mission:
        other = another_instruction(level, source, seed)
        if other is None or other.surface(level) != instruction:
            return []
        level.instrs = other
        other.reset_verifier(level)
    bot, actions, ended = DemonstrationBot(level), [], False
    while not ended:
        actions.append(int(bot.replan(actions[-1] if actions else None)))
        _, _, terminated, truncated, _ = level.step(actions[-1])
        ended = terminated or truncated
    return actions


class Scripted(PreTrainedPolicy):
    """Acts by instruction, seed and step; what LeRobot's protocol needs, and `rollouts`, as our policies have it."""

    config_class = LisaConfig
    name = "scripted"

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config.policy)
        self.evaluation, self.rollouts, self._step = config, 0, 0
        self.told: list[list[str]] = []

    def reset(self) -> None:
        """A rollout begins; the number of those before is set from outside, as for our policies."""
        self._rollout, self._step = self.rollouts, 0
        self.rollouts += 1

    def select_action(self, batch: dict[str, Any], **_: Any) -> Tensor:
        """(B, 1)."""
        self.told.append(list(batch["task"]))
        per_task = -(-self.evaluation.n_episodes // self.evaluation.batch_size)
        first = self.evaluation.seed + self._rollout % per_task * self.evaluation.batch_size
        actions = [self.act(text, first + index) for index, text in enumerate(batch["task"])]
        self._step += 1
        return torch.tensor(actions, dtype=torch.float32)[:, None]

    def act(self, instruction: str, seed: int) -> float:
        """The action of one environment."""
        raise NotImplementedError

    def get_optim_params(self) -> dict[str, Any]:
        """Nothing to train."""
        return {}

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, None]:
        """Nothing to train."""
        raise NotImplementedError

    def predict_action_chunk(self, batch: dict[str, Any], **_: Any) -> Tensor:
        """Unused."""
        raise NotImplementedError


class Obedient(Scripted):
    """Does in BabyAI what it is told, as the bot does, and then nothing more."""

    def act(self, instruction: str, seed: int) -> float:
        actions = obey(self.evaluation.env.task, seed, instruction)
        return actions[self._step] if self._step < len(actions) else _NOTHING_MORE


class Deaf(Scripted):
    """Wanders about in BabyAI, whatever it is told."""

    def act(self, instruction: str, seed: int) -> float:
        return float(torch.randint(3, (), generator=torch.Generator().manual_seed(1000 * seed + self._step)))


class Still(Scripted):
    """Only ever says that it is done."""

    def act(self, instruction: str, seed: int) -> float:
        return _NOTHING_MORE


class Wordwise(Scripted):
    """Moves to the number that the instruction ends with."""

    def act(self, instruction: str, seed: int) -> float:
        return float(instruction.split()[-1]) if instruction[-1:].isdecimal() else 0.0


def loading(policy: type[Scripted], made: list[Scripted] | None = None) -> Any:
    """What takes the place of `evaluation.load`: its environments, and a scripted policy."""

    def load_scripted(config: EvaluationConfig) -> Evaluation:
        evaluation = load(config)
        scripted = policy(config).eval()
        if made is not None:
            made.append(scripted)
        unchanged = {"preprocessor": _same, "postprocessor": _same}
        return evaluation._replace(policy=scripted, pipelines={**evaluation.pipelines, **unchanged})

    return load_scripted


def _same(given: Any) -> Any:
    return given
