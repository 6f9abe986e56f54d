"""A skill predictor that sees the instruction and one observation, the chunk's first, instead of the trajectory."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.language import mean_token
from lerobot_lisa.networks.packing import Packing


class OneObservation(nn.Module):
    """In the place of `SkillPredictor`: an ablation of the paper (appendix), whose network is an MLP.

    It remembers nothing and does not know when it is asked.

    Args:
        network: Of the mean of the instruction's tokens and the observation, side by side, (N, D + S).
        stride: It is shown steps 0, stride, 2 * stride, ... and looks at those at which it is asked.
    """

    reach = 0
    """How many steps before a question can matter to it."""

    def __init__(self, network: nn.Module, stride: int = 1) -> None:
        super().__init__()
        self.network, self.stride = network, stride

    def forward(self, language: Tensor, language_valid: Tensor, seen: Tensor, packing: Packing, horizon: int) -> Tensor:
        """Embeddings (C, ...), one for each chunk of each episode; arguments as in `SkillPredictor.forward`."""
        said = mean_token(language, language_valid)
        asked = (packing.steps % horizon == 0).nonzero()[:, 0]
        return self.network(torch.cat([said[packing.sequence[asked]], seen[asked]], dim=-1))

    def begin(self, language: Tensor, language_valid: Tensor) -> Tensor:
        """Start a rollout: remember what the instruction is as one vector, (B, D)."""
        return mean_token(language, language_valid)

    def ask(self, memory: Tensor, seen: Tensor, when: Sequence[int]) -> Tensor:
        """Embeddings (B, ...) for the newest of the observations (B, n, S)."""
        return self.network(torch.cat([memory, seen[:, -1]], dim=-1))
