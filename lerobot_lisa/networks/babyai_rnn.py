"""BabyAI's own network: a grid that is seen in the light of the instruction, and a memory over the episode."""

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence, pad_packed_sequence

from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.film import FilmGridEncoder
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.sentence_network import SentenceHistory, SentenceNetwork


@dataclass(kw_only=True)
class BabyAIRNNHistory(SentenceHistory):
    """The rollout so far.

    Attributes:
        memory: State of the LSTM, two of (1, B, memory); None before the first step.
    """

    memory: tuple[Tensor, Tensor] | None = None


class BabyAIRNN(SentenceNetwork):
    """Chevalier-Boisvert et al., ICLR 2019 (arXiv:1810.08272), with the eyes of BabyAI 1.1 (arXiv:2007.12770).

    Args:
        language: Instructions to tokens, whose mean modulates what is seen.
        grid_key: The feature that is the grid.
        grid: Sees it.
        others: Sees the other features, such as the heading; None: there are none.
        width: D.
        memory: Numbers that the LSTM remembers.
        dropout: Before the head.
        head: Of `width`.
    """

    history = BabyAIRNNHistory

    def __init__(
        self,
        language: LanguageEncoder,
        grid_key: str,
        grid: FilmGridEncoder,
        others: ObservationEncoder | None,
        width: int,
        memory: int,
        dropout: float,
        head: ActionHead,
    ) -> None:
        super().__init__()
        self.language, self.grid_key, self.grid, self.others = language, grid_key, grid, others
        self.memory = nn.LSTM(width, memory, batch_first=True)
        self.policy = nn.Sequential(nn.Linear(memory, width), nn.Tanh(), nn.Dropout(dropout), head)

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> Tensor:
        """Predict every action of B whole episodes; arguments as in `Lisa.forward`. Actions are not looked at."""
        sentences = self.language(tokens, tokens_valid).sentence()
        seen = packing.pad(self._look(observations, sentences[packing.sequence]))
        episodes = pack_padded_sequence(seen, packing.lengths, batch_first=True, enforce_sorted=False)
        remembered, _ = pad_packed_sequence(self.memory(episodes)[0], batch_first=True)
        return self.policy(packing.unpad(remembered))

    def act(self, history: BabyAIRNNHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step."""
        history.step += 1
        seen = self._look(observations, history.sentences)
        remembered, history.memory = self.memory(seen[:, None], history.memory)
        return self.policy(remembered[:, 0])

    def _look(self, observations: Mapping[str, Tensor], sentences: Tensor) -> Tensor:
        """N frames, a sentence (N, D) for each, to (N, D)."""
        seen = self.grid(observations[self.grid_key], sentences)
        if self.others is None:
            return seen
        return seen + self.others(observations, sentences[:0]).summary  # nothing is asked, so no names are needed
