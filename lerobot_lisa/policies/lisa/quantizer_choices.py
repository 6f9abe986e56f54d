"""What `--policy.quantizer` can be: how many codes each has, and how it is built."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import TYPE_CHECKING, NamedTuple

from lerobot_lisa.networks.codebooks import Codebook, CodebookSettings, ResidualCodebook
from lerobot_lisa.networks.quantizers import Continuous, FiniteScalars, Quantizer

if TYPE_CHECKING:
    from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


class QuantizerChoice(NamedTuple):
    """A quantiser as the configuration sees it.

    Attributes:
        make: Builds it, for embeddings of a width.
        sizes: How many codes each of its parts has; empty if skills are continuous.
    """

    make: Callable[[LisaConfig, int], Quantizer]
    sizes: Callable[[LisaConfig], list[int]]


def codebook_sizes(config: LisaConfig) -> list[int]:
    """Of "vq" and "residual_vq", part by part."""
    return [config.codebook_size] * config.n_code_parts + [config.own_codebook_size] * config.n_own_parts


def n_codes(config: LisaConfig) -> int:
    """K, the number of skill codes, all parts taken together; 0 if skills are continuous."""
    sizes = QUANTIZERS[config.quantizer].sizes(config)
    return prod(sizes) if sizes else 0


def _settings(config: LisaConfig) -> CodebookSettings:
    return CodebookSettings(
        config.codebook_decay,
        config.commitment_weight,
        config.dead_code_threshold,
        _code_width(config),
        config.quantizer_warmup_steps,
    )


def _code_width(config: LisaConfig) -> int | None:
    """Codes that are copied from the instruction stay among words."""
    return None if config.copy_words else config.code_width


QUANTIZERS = {
    "vq": QuantizerChoice(
        lambda config, width: Codebook(width, codebook_sizes(config), _settings(config)), codebook_sizes
    ),
    "residual_vq": QuantizerChoice(
        lambda config, width: ResidualCodebook(width, codebook_sizes(config), _settings(config)), codebook_sizes
    ),
    "fsq": QuantizerChoice(
        lambda config, width: FiniteScalars(width, config.fsq_levels), lambda config: config.fsq_levels
    ),
    "continuous": QuantizerChoice(lambda config, width: Continuous(width, _code_width(config)), lambda config: []),
}
