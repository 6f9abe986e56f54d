"""The Lang-BC policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.lang_bc`."""

from torch import Tensor

from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.lang_bc import LangBC
from lerobot_lisa.policies.baseline_modeling import BaselinePolicy
from lerobot_lisa.policies.lang_bc.configuration_lang_bc import LangBCConfig
from lerobot_lisa.policies.parts import make_language_encoder, make_last_head, make_observation_encoder


class LangBCPolicy(BaselinePolicy):
    """LOReL's language-conditioned behaviour cloning: acts on the instruction and what is seen now."""

    config_class = LangBCConfig
    name = "lang_bc"
    config: LangBCConfig
    network: LangBC

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> LangBC:
        """An MLP over sentence and observation."""
        config, language = self.config, make_language_encoder(self.config)
        return LangBC(
            language=language,
            observations=make_observation_encoder(config, language, backbone),
            width=config.dim_model,
            dropout=config.dropout,
            head=make_last_head(config, action_bounds),
        )
