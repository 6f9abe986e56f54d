"""What the original baselines share of LeRobot's protocol."""

from typing import Any

from torch import Tensor

from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.policies.base_modeling import EpisodePolicy, Metrics
from lerobot_lisa.policies.parts import parameter_group


class BaselinePolicy(EpisodePolicy):
    """Base of policies whose network predicts actions and nothing else."""

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Two groups: the language encoder, and everything else."""
        encoder = parameter_group("language_encoder", [self.network.language.encoder], self.config.language_rate)
        theirs = {id(parameter) for parameter in encoder["params"]}
        others = [parameter for parameter in self.network.parameters() if id(parameter) not in theirs]
        return [{"name": "policy", "params": others, "lr": self.config.policy_rate}, encoder]

    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions; no other loss, nothing else to log."""
        outputs = self.network(tokens, tokens_valid, frames, actions, packing)
        return outputs, outputs.new_zeros(()), {}
