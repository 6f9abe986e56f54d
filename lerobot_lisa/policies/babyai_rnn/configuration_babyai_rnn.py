"""Settings of the BabyAI-RNN policy."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs import PreTrainedConfig

from lerobot_lisa.policies.baseline_configuration import BaselineConfig


@PreTrainedConfig.register_subclass("babyai_rnn")
@dataclass
class BabyAIRNNConfig(BaselineConfig):
    """BabyAI's baseline (Chevalier-Boisvert et al., ICLR 2019, arXiv:1810.08272), as of BabyAI 1.1 (arXiv:2007.12770).

    The LISA paper's "original" on BabyAI. `dim_model` is the width of cells, maps and sentences.

    Attributes:
        dropout: Before the last layer; BabyAI has none.
        memory_width: Numbers that the LSTM remembers; 128 is BabyAI's small model, 2,048 its large one.
    """

    dropout: float = 0.0
    memory_width: int = 128

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        **BaselineConfig.BOUNDS,
        "memory_width": (1, 8192),
    }

    def _count_parameters(self) -> int:
        convolutions = 6 * 9 * self.dim_model**2
        return super()._count_parameters() + convolutions + 4 * self.memory_width * (self.memory_width + self.dim_model)
