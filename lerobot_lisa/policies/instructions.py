"""The instructions of a batch: their tokens, what tells them apart, and a warning of what nobody has taught."""

import logging
from collections.abc import Mapping
from typing import Any

from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import InstructionStep, make_tokenizer, split_words
from lerobot_lisa.policies.episode_settings import WORDS

_WARNINGS = 1000  # who speaks freely to a robot is not to fill its memory


class InstructionReader:
    """Reads instructions for a policy.

    With the built-in language encoder it reads the texts itself where a batch brings them: a policy that has been
    fine-tuned knows more words than the tokenizer that LeRobot has kept from its first checkpoint.
    """

    def __init__(self, config: EpisodePolicyConfig) -> None:
        words = config.language_encoder == WORDS
        self._step = InstructionStep(make_tokenizer(config)) if words else None
        self._vocabulary = set(config.vocabulary)
        self._warned: set[str] = set()

    def read(self, batch: Mapping[str, Any]) -> tuple[Tensor, Tensor]:
        """Tokens (B, M) and which of them are real (B, M)."""
        tokens, valid = given_tokens(batch), batch[OBS_LANGUAGE_ATTENTION_MASK].bool()
        texts = batch.get("task")
        if self._step is not None and isinstance(texts, list) and len(texts) == len(tokens):
            tokens, valid = (part.to(tokens.device) for part in self._step.tokenise(texts))
        return tokens, valid

    def warn(self, batch: Mapping[str, Any]) -> None:
        """Say once of each instruction what of it the policy cannot know."""
        texts = batch.get("task")
        for text in dict.fromkeys([texts] if isinstance(texts, str) else texts or []):
            if text not in self._warned and len(self._warned) < _WARNINGS:
                self._warned.add(text)
                self._warn_of(text)

    def _warn_of(self, text: str) -> None:
        if not text.strip():
            logging.warning("the instruction is blank: say what is to be done, such as with --task")
        elif self._step is not None and (new := self._unknown(text)):
            logging.warning("instruction %.200r: no training instruction has %s", text, ", ".join(new)[:200])

    def _unknown(self, text: str) -> list[str]:
        return [word for word in dict.fromkeys(split_words(text)) if word not in self._vocabulary]


def given_tokens(batch: Mapping[str, Any]) -> Tensor:
    """Tokens (B, M) as the preprocessor has made them, a row for each instruction."""
    if OBS_LANGUAGE_TOKENS not in batch:
        raise UserError(f"the batch has no {OBS_LANGUAGE_TOKENS}: pass it through the policy's preprocessor")
    return batch[OBS_LANGUAGE_TOKENS]


def told_apart_by(batch: Mapping[str, Any]) -> list[Any]:
    """What tells B instructions from others: their texts, or their tokens where a batch does not bring the texts."""
    task = batch.get("task")
    return list(task) if task is not None and not isinstance(task, str) else [task, batch[OBS_LANGUAGE_TOKENS].tolist()]
