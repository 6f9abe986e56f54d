"""Both policies' pipelines, with a step that turns instructions into token ids and carries its whole tokenizer."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import torch
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import (
    NormalizerProcessorStep,
    ObservationProcessorStep,
    PolicyAction,
    PolicyProcessorPipeline,
    ProcessorStepRegistry,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)
from lerobot.utils.constants import (
    OBS_LANGUAGE_ATTENTION_MASK,
    OBS_LANGUAGE_TOKENS,
    POLICY_PREPROCESSOR_DEFAULT_NAME,
)
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.episode_settings import WORDS

Stats = dict[str, dict[str, Any]]
Pipelines = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]
PADDING, UNKNOWN = "[PAD]", "[UNK]"
LONGEST = 512  # tokens; what BERT-like encoders can take
REMEMBERED = 200_000  # instructions whose token ids are kept


def make_pipelines(config: EpisodePolicyConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Rename, batch, tokenise the instruction, move to the device, normalise; and back for actions."""
    if config.action_classes is not None:  # else nobody has looked at the dataset yet
        config.fill_in()
    steps = make_default_policy_processor_steps(config, dataset_stats)
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            InstructionStep(make_tokenizer(config)),
            steps.to_device,
            steps.normalize,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )


def make_tokenizer(config: EpisodePolicyConfig) -> Tokenizer:
    """The built-in encoder's or a pretrained one's."""
    words = config.language_encoder == WORDS
    return word_tokenizer(config.vocabulary) if words else pretrained_tokenizer(config.language_encoder)


def make_normalizer(config: EpisodePolicyConfig, dataset_stats: Stats | None) -> NormalizerProcessorStep:
    """The pipelines' own step, for whole episodes, which do not come through them (see `EpisodePolicy`)."""
    return make_default_policy_processor_steps(config, dataset_stats).normalize


def saved_step[Step](config: EpisodePolicyConfig, kind: type[Step]) -> Step:
    """A step of the preprocessor that is kept with the policy's checkpoint; LeRobot has just loaded it, or will."""
    name = f"{POLICY_PREPROCESSOR_DEFAULT_NAME}.json"
    saved = PolicyProcessorPipeline.from_pretrained(
        str(config.pretrained_path), config_filename=name, revision=config.pretrained_revision
    )
    return next(step for step in saved.steps if isinstance(step, kind))


def build_vocabulary(instructions: Iterable[str], limit: int = 10_000) -> list[str]:
    """Words of a set of instructions, the most frequent `limit` of them, in alphabetical order."""
    counts = Counter(word for text in instructions for word in split_words(text))
    return sorted(word for word, _ in counts.most_common(limit))


def split_words(text: str) -> list[str]:
    """Split as `word_tokenizer` does: Python's `lower` and `\\w` differ from its in several scripts."""
    lower = normalizers.Lowercase().normalize_str(text)
    return [word for word, _ in pre_tokenizers.Whitespace().pre_tokenize_str(lower)]


def word_tokenizer(vocabulary: list[str]) -> Tokenizer:
    """One token per word or run of punctuation, lower case; id 0 is padding, id 1 an unknown word."""
    ids = {word: index for index, word in enumerate([PADDING, UNKNOWN, *vocabulary])}
    tokenizer = Tokenizer(models.WordLevel(ids, unk_token=UNKNOWN))
    tokenizer.normalizer = normalizers.Lowercase()
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    return tokenizer


def plain_ids(tokenizer: Tokenizer, text: str) -> list[int]:
    """Token ids of a name or phrase, without what an encoder wants around a sentence."""
    ids: list[int] = tokenizer.encode(text, add_special_tokens=False).ids
    return ids


def pretrained_tokenizer(name: str) -> Tokenizer:
    """The tokenizer of a Hugging Face encoder, by id or local path.

    Raises:
        UserError: It cannot be found, has no fast version, or knows no word.
    """
    from transformers import AutoTokenizer  # slow to import, and word-level policies do without

    try:
        loaded = AutoTokenizer.from_pretrained(name, trust_remote_code=False)
    except (OSError, ValueError) as error:
        raise UserError(missing_language_encoder(name)) from error
    if not loaded.is_fast:
        raise UserError(
            f"language encoder {name} has no fast tokenizer: choose one that has, or --policy.language_encoder=words"
        )
    if len(loaded) <= len(loaded.all_special_tokens):  # transformers makes an empty one up rather than fail
        raise UserError(
            f"language encoder {name} knows no word: its folder needs the tokenizer's files, such as tokenizer.json"
        )
    tokenizer: Tokenizer = loaded.backend_tokenizer
    tokenizer.no_padding()
    tokenizer.enable_truncation(min(LONGEST, loaded.model_max_length))
    return tokenizer


def missing_language_encoder(name: str) -> str:
    """What to do when a language encoder is not there."""
    return (
        f"language encoder {name!r} is neither a folder nor to be had from the Hub (offline?): pass a local path, "
        "or --policy.language_encoder=words for the built-in one that needs no download"
    )


def _as_real(observation: dict[str, Any]) -> dict[str, Any]:
    """Integers as real numbers, but no pictures: LeRobot would scale them by statistics that it cuts to integers."""
    return {
        key: value.float() if isinstance(value, Tensor) and not value.is_floating_point() and value.ndim < 4 else value
        for key, value in observation.items()
    }


@ProcessorStepRegistry.register("lisa_instructions")
@dataclass
class InstructionStep(ObservationProcessorStep):
    """Adds `observation.language.tokens` (B, M) and their mask (B, M) for the task strings of a batch.

    Each distinct instruction is tokenised once: doing it for every frame costs 16 ms per batch of 128. The tokenizer is
    saved with the pipeline's state; LeRobot's own step saves only a name, which breaks in another place.
    """

    tokenizer: Tokenizer | None = None
    _ids: dict[str, list[int]] = field(default_factory=dict, init=False, repr=False)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Tokenise the task strings of the transition this observation belongs to."""
        tokens, valid = self.tokenise(self._instructions())
        return {**_as_real(observation), OBS_LANGUAGE_TOKENS: tokens, OBS_LANGUAGE_ATTENTION_MASK: valid}

    def _instructions(self) -> list[str]:
        task = (self.transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
        if task is None:
            raise UserError("no instruction: put the task string into the batch under the key `task`")
        instructions = [task] if isinstance(task, str) else list(task)
        for text in instructions:
            if not isinstance(text, str):
                raise UserError(f"an instruction is a string, but `task` holds {text!r:.60}")
        return instructions

    def tokenise(self, instructions: list[str]) -> tuple[Tensor, Tensor]:
        """Token ids (B, M) of B instructions, zeros at the end, and which of them are real (B, M)."""
        if not instructions:
            raise UserError("no instruction: `task` is empty")
        ids = [self._look_up(text) for text in instructions]
        longest = max(len(row) for row in ids)
        tokens = torch.tensor([row + [0] * (longest - len(row)) for row in ids])
        lengths = torch.tensor([len(row) for row in ids])
        return tokens, torch.arange(longest) < lengths[:, None]

    def _look_up(self, instruction: str) -> list[int]:
        if instruction not in self._ids:
            if self.tokenizer is None:
                raise RuntimeError("the instruction step has no tokenizer: load its state first")
            if len(self._ids) >= REMEMBERED:
                self._ids.clear()
            # An empty instruction still is one token, so that attention has something to look at.
            self._ids[instruction] = self.tokenizer.encode(instruction).ids[:LONGEST] or [1]
        return self._ids[instruction]

    def get_config(self) -> dict[str, Any]:
        """Nothing: all there is lies in the state."""
        return {}

    def state_dict(self) -> dict[str, Tensor]:
        """The tokenizer as the bytes of its JSON, the one kind of thing LeRobot stores for a step."""
        if self.tokenizer is None:
            return {}
        return {"tokenizer": torch.frombuffer(bytearray(self.tokenizer.to_str().encode()), dtype=torch.uint8)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the tokenizer."""
        self.tokenizer = Tokenizer.from_str(bytes(state["tokenizer"].cpu().numpy()).decode())
        self._ids.clear()

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Announce the two tensors."""
        language = PolicyFeature(type=FeatureType.LANGUAGE, shape=(LONGEST,))
        features[PipelineFeatureType.OBSERVATION] |= {
            OBS_LANGUAGE_TOKENS: language,
            OBS_LANGUAGE_ATTENTION_MASK: language,
        }
        return features
