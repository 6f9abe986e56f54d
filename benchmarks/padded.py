"""The paper's networks written down plainly: the alternative that our training step is measured against.

Whole episodes are padded to the longest of their batch, every position goes through every layer, and the transformers
are PyTorch's own `nn.TransformerEncoder` with its default dropout, on attention weights too. What makes up the model
(encoders, codebook, heads, sizes, weights) is taken from one of our networks: without dropout the loss is the same.
"""

from copy import deepcopy
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.lang_dt import LangDT
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.transformer import CausalTransformer


class PaddedBatch(NamedTuple):
    """B whole episodes.

    Attributes:
        tokens: Instructions (B, M).
        tokens_valid: (B, M), False for padding.
        observations: Features, each (B, T, *shape).
        actions: (B, T, A).
        valid: (B, T), False for padding.
    """

    tokens: Tensor
    tokens_valid: Tensor
    observations: dict[str, Tensor]
    actions: Tensor
    valid: Tensor


def pad(
    tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
) -> PaddedBatch:
    """The batch that our networks get as episodes end to end, padded with zeros."""
    lengths = packing.lengths.tolist()

    def padded(rows: Tensor) -> Tensor:
        return nn.utils.rnn.pad_sequence(list(rows.split(lengths)), batch_first=True)

    valid = torch.arange(max(lengths)) < packing.lengths[:, None]
    return PaddedBatch(
        tokens, tokens_valid, {key: padded(rows) for key, rows in frames.items()}, padded(actions), valid
    )


class PaddedLisa(nn.Module):
    """LISA: skill predictor over the whole episode, codebook, action predictor over chunks of H steps."""

    def __init__(self, network: Lisa) -> None:
        super().__init__()
        predictor = network.predictor
        self.horizon = network.horizon
        self.language, self.skill_embedding = deepcopy(network.language), deepcopy(network.skill_embedding)
        self.observations = deepcopy(network.predictor_observations or network.observations)
        self.timesteps = deepcopy(predictor.timesteps)
        self.output, self.quantizer = deepcopy(predictor.output), deepcopy(network.quantizer.quantizers[0])
        self.predictor = _Transformer(predictor.transformer)
        self.action_predictor = _ActionPredictor(network.observations, network.action_predictor)

    def forward(self, batch: PaddedBatch) -> Tensor:
        """The training loss."""
        language = self.language(batch.tokens, batch.tokens_valid).tokens
        length = batch.valid.shape[1]
        frames = _per_step(self.observations, batch.observations) + self.timesteps(torch.arange(length))
        answers = self.predictor(
            torch.cat([language, frames], 1), torch.cat([batch.tokens_valid, batch.valid], 1), language.shape[1]
        )
        asked = slice(0, length, self.horizon)
        embeddings = self.output(answers[:, language.shape[1] :])[:, asked]
        real = batch.valid[:, asked]
        quantized, _, commitment = self.quantizer(embeddings[real][None])  # its own mask fails with a projection
        skills = embeddings.masked_scatter(real[..., None], quantized)
        prefix = self.skill_embedding(skills).flatten(0, 1)[:, None]  # one sequence for each chunk
        chunks = {key: self._chunks(value) for key, value in batch.observations.items()}
        actions, valid = self._chunks(batch.actions), self._chunks(batch.valid)
        losses = self.action_predictor(prefix, None, chunks, actions, valid).unflatten(0, (len(batch.valid), -1))
        return _mean(losses.flatten(1, 2)[:, :length], batch.valid) + commitment.sum()

    def _chunks(self, values: Tensor) -> Tensor:
        """(B, T, ...) -> (B * chunks, H, ...)."""
        missing = -values.shape[1] % self.horizon
        filled = torch.cat([values, values.new_zeros(len(values), missing, *values.shape[2:])], dim=1)
        return filled.unflatten(1, (-1, self.horizon)).flatten(0, 1)


class PaddedLangDT(nn.Module):
    """Lang-DT: one transformer over the instruction and the whole episode."""

    def __init__(self, network: LangDT) -> None:
        super().__init__()
        self.language = deepcopy(network.language)
        self.action_predictor = _ActionPredictor(network.observations, network.action_predictor)

    def forward(self, batch: PaddedBatch) -> Tensor:
        """The training loss."""
        language = self.language(batch.tokens, batch.tokens_valid).tokens
        losses = self.action_predictor(language, batch.tokens_valid, batch.observations, batch.actions, batch.valid)
        return _mean(losses, batch.valid)


class _ActionPredictor(nn.Module):
    """Losses of the actions in `[prefix ; o_0, a_0, o_1, a_1, ...]`."""

    def __init__(self, observations: ObservationEncoder, ours: ActionPredictor) -> None:
        super().__init__()
        self.observations, self.timesteps = deepcopy(observations), deepcopy(ours.timesteps)
        self.head, self.transformer = deepcopy(ours.head), _Transformer(ours.transformer)

    def forward(
        self,
        prefix: Tensor,
        prefix_valid: Tensor | None,
        observations: dict[str, Tensor],
        actions: Tensor,
        valid: Tensor,
    ) -> Tensor:
        """Losses (B, T); those of padding mean nothing."""
        length, words = valid.shape[1], prefix.shape[1]
        when = self.timesteps(torch.arange(length))
        seen = _per_step(self.observations, observations) + when
        done = self.head.embed(actions.flatten(0, 1)).unflatten(0, valid.shape) + when
        tokens = torch.cat([prefix, torch.stack([seen, done], dim=2).flatten(1, 2)], dim=1)
        known = torch.ones(len(prefix), words, dtype=torch.bool) if prefix_valid is None else prefix_valid
        answers = self.transformer(tokens, torch.cat([known, valid.repeat_interleave(2, 1)], 1), words)
        outputs = self.head(answers[:, words::2].flatten(0, 1))
        return self.head.loss(outputs, actions.flatten(0, 1)).unflatten(0, valid.shape)


class _Transformer(nn.Module):
    """PyTorch's transformer with the weights of ours."""

    def __init__(self, ours: CausalTransformer) -> None:
        super().__init__()
        width, heads, dropout = ours.input_norm.normalized_shape[0], ours.blocks[0].heads, ours.dropout.p
        layer = nn.TransformerEncoderLayer(
            width, heads, 4 * width, dropout, activation="gelu", batch_first=True, norm_first=True
        )
        self.layers = nn.TransformerEncoder(
            layer, len(ours.blocks), norm=deepcopy(ours.output_norm), enable_nested_tensor=False
        )
        self.input_norm, self.dropout = deepcopy(ours.input_norm), nn.Dropout(dropout)
        for theirs, block in zip(self.layers.layers, ours.blocks, strict=True):
            theirs.load_state_dict(
                {
                    "self_attn.in_proj_weight": torch.cat([block.query.weight, block.key_value.weight]),
                    "self_attn.in_proj_bias": torch.cat([block.query.bias, block.key_value.bias]),
                    **_renamed(block.output, "self_attn.out_proj"),
                    **_renamed(block.attention_norm, "norm1"),
                    **_renamed(block.mlp_norm, "norm2"),
                    **_renamed(block.mlp[0], "linear1"),
                    **_renamed(block.mlp[2], "linear2"),
                }
            )

    def forward(self, tokens: Tensor, valid: Tensor, words: int) -> Tensor:
        """Tokens (B, L, D) of which the first `words` are seen by all, the others by later ones."""
        length = tokens.shape[1]
        hidden = torch.ones(length, length, dtype=torch.bool).triu(1)
        hidden[:, :words] = False
        return self.layers(self.dropout(self.input_norm(tokens)), hidden, src_key_padding_mask=~valid)


def _renamed(module: nn.Module, name: str) -> dict[str, Tensor]:
    return {f"{name}.{key}": value for key, value in module.state_dict().items()}


def _per_step(encoder: nn.Module, observations: dict[str, Tensor]) -> Tensor:
    """Features (B, T, *shape) -> (B, T, D)."""
    shape = next(iter(observations.values())).shape[:2]
    flat = {key: value.flatten(0, 1) for key, value in observations.items()}
    return encoder(flat, torch.zeros(0)).summary.unflatten(0, shape)


def _mean(losses: Tensor, valid: Tensor) -> Tensor:
    """Mean over each episode, then over episodes."""
    return ((losses * valid).sum(1) / valid.sum(1)).mean()
