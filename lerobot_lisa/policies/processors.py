"""The pre- and postprocessor pipelines of both policies."""

from typing import Any

import torch
from lerobot.processor import (
    PolicyAction,
    PolicyProcessorPipeline,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)

from lerobot_lisa.policies.base_configuration import WORDS, EpisodePolicyConfig
from lerobot_lisa.policies.instructions import InstructionStep, pretrained_tokenizer, word_tokenizer

Stats = dict[str, dict[str, torch.Tensor]]
Pipelines = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]


def make_pipelines(config: EpisodePolicyConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Rename, batch, tokenise the instruction, move to the device, normalise; and back for actions."""
    steps = make_default_policy_processor_steps(config, dataset_stats)
    if config.language_encoder == WORDS:
        tokenizer = word_tokenizer(config.vocabulary)
    else:
        tokenizer = pretrained_tokenizer(config.language_encoder)
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            InstructionStep(tokenizer),
            steps.to_device,
            steps.normalize,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )
