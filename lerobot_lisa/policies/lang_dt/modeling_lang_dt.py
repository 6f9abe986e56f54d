"""The Lang-DT policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.lang_dt`."""

from typing import Any

from torch import Tensor

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.lang_dt import LangDT
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer
from lerobot_lisa.policies.base_modeling import EpisodePolicy, Metrics
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.parts import (
    make_action_head,
    make_language_encoder,
    make_observation_encoder,
    make_part_attention,
    parameter_group,
)


class LangDTPolicy(EpisodePolicy):
    """Lang-DT: a Decision Transformer over the instruction and the whole episode so far (the paper's baseline)."""

    config_class = LangDTConfig
    name = "lang_dt"
    config: LangDTConfig
    network: LangDT

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> LangDT:
        """One causal transformer that looks back as far as configured, or over the longest training episode."""
        config, steps = self.config, self.config.max_timesteps or 1
        window = 2 * (config.lookback_steps or steps)  # two tokens a step: observation and action
        policy = ActionPredictor(
            TimestepEmbedding(steps, config.dim_model),
            CausalTransformer(config.dim_model, config.n_layers, config.n_heads, config.dropout, window=window),
            make_action_head(config, action_bounds),
        )
        language = make_language_encoder(config)
        observations = make_observation_encoder(config, language, backbone)
        asks_words = make_part_attention(config, language, language.encoder.width)
        return LangDT(language, observations, policy, config.padding_waste, asks_words)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """One group per learning rate of the paper: policy and language encoder."""
        network = self.network
        policy = [network.observations, network.action_predictor, network.language.output, network.asks_words]
        return [
            parameter_group("policy", policy, self.config.policy_rate),
            parameter_group("language_encoder", [network.language.encoder], self.config.language_rate),
        ]

    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions; no other loss, nothing else to log."""
        outputs = self.network(tokens, tokens_valid, frames, actions, packing)
        return outputs, outputs.new_zeros(()), {}
