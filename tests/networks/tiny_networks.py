"""Small networks and random episodes for them."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead, CategoricalHead
from lerobot_lisa.networks.codebook import Codebook
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.lang_dt import LangDT
from lerobot_lisa.networks.language import LanguageEncoder, WordEncoder
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.observations import ObservationEncoder, ObservationSpec
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.real_actions import MeanHead
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer

WIDTH, HEADS, CODES, WORDS, CLASSES = 16, 2, 5, 12, 4
SPECS = {"grid": ObservationSpec("symbols", (6,), 8), "state": ObservationSpec("state", (3,))}


@dataclass
class Batch:
    """Arguments of a network's forward pass."""

    tokens: Tensor
    valid: Tensor
    observations: dict[str, Tensor]
    actions: Tensor
    packing: Packing

    def part(self, episode: int) -> "Batch":
        """One episode, with its instruction's padding cut off."""
        rows = self.packing.rows(torch.tensor([episode]))
        words = int(self.valid[episode].sum())
        return Batch(
            self.tokens[episode : episode + 1, :words],
            self.valid[episode : episode + 1, :words],
            {key: value[rows] for key, value in self.observations.items()},
            self.actions[rows],
            Packing(self.packing.lengths[episode : episode + 1]),
        )


def batch(lengths: list[int], categorical: bool = True, seed: int = 0) -> Batch:
    """Random episodes with instructions of 1 to 6 words."""
    random = torch.Generator().manual_seed(seed)
    frames, episodes = sum(lengths), len(lengths)
    words = torch.randint(1, 7, (episodes,), generator=random)
    valid = torch.arange(int(words.max())) < words[:, None]
    grid = torch.randint(0, 8, (frames, 6), generator=random, dtype=torch.uint8)
    actions = torch.randint(0, CLASSES, (frames, 1), generator=random)
    return Batch(
        torch.randint(1, WORDS, valid.shape, generator=random) * valid,
        valid,
        {"grid": grid, "state": torch.randn(frames, 3, generator=random)},
        actions if categorical else torch.randn(frames, 2, generator=random),
        Packing(torch.tensor(lengths)),
    )


def lisa(horizon: int = 3, window: int = 100, categorical: bool = True, layers: int = 1, shared: bool = False) -> Lisa:
    """LISA without dropout, in evaluation mode, with a codebook that has seen data."""
    torch.manual_seed(1)
    transformer = CausalTransformer(WIDTH, layers, HEADS, 0.0, window=window)
    predictor = SkillPredictor(TimestepEmbedding(window, WIDTH), transformer, WIDTH)
    network = Lisa(
        LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH),
        ObservationEncoder(SPECS, WIDTH),
        predictor,
        codebook(),
        nn.Linear(WIDTH, WIDTH),
        _policy(categorical, TimestepEmbedding(horizon, WIDTH), CausalTransformer(WIDTH, layers, HEADS, 0.0)),
        horizon,
        None if shared else ObservationEncoder(SPECS, WIDTH),
    )
    warm_up = batch([4 * horizon + 1] * 8, categorical, seed=99)
    run(network, warm_up)
    return network.eval()


def lang_dt(window: int = 100, categorical: bool = True, layers: int = 2, waste: float = 0.15) -> LangDT:
    """Lang-DT without dropout, in evaluation mode; `window` counts steps."""
    torch.manual_seed(1)
    transformer = CausalTransformer(WIDTH, layers, HEADS, 0.0, window=2 * window)
    policy = _policy(categorical, TimestepEmbedding(window, WIDTH), transformer)
    language = LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH)
    return LangDT(language, ObservationEncoder(SPECS, WIDTH), policy, waste).eval()


def codebook(size: int = CODES, width: int = WIDTH, decay: float = 0.99, dead_code_threshold: float = 1.0) -> Codebook:
    """A codebook of 4 numbers per code."""
    return Codebook(
        width=width,
        size=size,
        code_width=4,
        decay=decay,
        commitment_weight=0.25,
        dead_code_threshold=dead_code_threshold,
    )


def run(network: EpisodeNetwork, what: Batch) -> tuple[Tensor, Tensor | None]:
    """Predictions for every frame, and codes for every chunk where the network has them."""
    out = network(what.tokens, what.valid, what.observations, what.actions, what.packing)
    return (out[0], out[1].codes) if isinstance(network, Lisa) else (out, None)


def _policy(categorical: bool, timesteps: TimestepEmbedding, transformer: CausalTransformer) -> ActionPredictor:
    head: ActionHead = (
        CategoricalHead(WIDTH, CLASSES)
        if categorical
        else MeanHead(WIDTH, torch.ones(2), torch.tensor([[-1.0] * 2, [1.0] * 2]))
    )
    return ActionPredictor(timesteps, transformer, head)
