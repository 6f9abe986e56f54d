"""Small networks and random episodes for them."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead, CategoricalHead
from lerobot_lisa.networks.babyai_rnn import BabyAIRNN
from lerobot_lisa.networks.codebooks import Codebook, CodebookSettings
from lerobot_lisa.networks.copying import OwnNumbers, PhraseCopier
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.film import FilmGridEncoder
from lerobot_lisa.networks.lang_bc import LangBC
from lerobot_lisa.networks.lang_dt import LangDT
from lerobot_lisa.networks.language import LanguageEncoder, WordEncoder
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.observations import AskingSpec, ObservationEncoder, ObservationSpec
from lerobot_lisa.networks.one_observation import OneObservation
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.parts import PartAttention
from lerobot_lisa.networks.quantizers import Quantizer
from lerobot_lisa.networks.real_actions import MeanHead
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.symbols import SymbolNames
from lerobot_lisa.networks.termination import Termination
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer

WIDTH, HEADS, CODES, WORDS, CLASSES = 16, 2, 5, 12, 4
NAMES = [[3], [4], [5], [6, 7], [8]]  # token ids: four kinds of thing, the last but one of two words, and a color
THINGS = SymbolNames(((-1, -1, 0, 1, 2, 3), (4,)))  # symbols 2 to 5 of a cell's first channel are things
SPECS = {"grid": ObservationSpec("symbols", (6,), 8, THINGS), "state": ObservationSpec("state", (3,))}


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


def lisa(
    horizon: int = 3,
    window: int = 100,
    categorical: bool = True,
    layers: int = 1,
    shared: bool = False,
    asking: bool = True,
    copying: bool = True,
    quantizer: Quantizer | None = None,
    own: int = 0,
    stride: int = 1,
    mlp: bool = False,
    every: int | None = None,
) -> Lisa:
    """LISA without dropout, in evaluation mode, with a codebook that has seen data."""
    torch.manual_seed(1)
    transformer = CausalTransformer(WIDTH, layers, HEADS, 0.0, window=window)
    predictor = SkillPredictor(TimestepEmbedding(window, WIDTH), transformer, WIDTH, stride)
    parts = len(quantizer.sizes) if isinstance(quantizer, Codebook) else 1
    source = PhraseCopier(WIDTH, WIDTH, parts - own, own, 4) if copying else OwnNumbers(WIDTH, parts)
    network = Lisa(
        language=LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH, NAMES),
        observations=observations(asking),
        predictor=OneObservation(nn.Linear(2 * WIDTH, WIDTH), stride) if mlp else predictor,
        source=source,
        quantizer=quantizer or codebook(code_width=None if copying else 4),
        skill_embedding=nn.Linear(WIDTH, WIDTH),
        action_predictor=_policy(
            categorical, TimestepEmbedding(horizon, WIDTH), CausalTransformer(WIDTH, layers, HEADS, 0.0)
        ),
        termination=Termination(horizon, every, steps=3, weight=1),
        predictor_observations=None if shared else observations(asking),
        asks_words=attention() if asking else None,
        asks_skill=attention() if asking else None,
    )
    warm_up = batch([4 * horizon + 1] * 8, categorical, seed=99)
    run(network, warm_up)
    return network.eval()


def lang_dt(
    window: int = 100, categorical: bool = True, layers: int = 2, waste: float = 0.15, asking: bool = True
) -> LangDT:
    """Lang-DT without dropout, in evaluation mode; `window` counts steps."""
    torch.manual_seed(1)
    transformer = CausalTransformer(WIDTH, layers, HEADS, 0.0, window=2 * window)
    policy = _policy(categorical, TimestepEmbedding(window, WIDTH), transformer)
    language = LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH, NAMES)
    return LangDT(language, observations(asking), policy, waste, attention() if asking else None).eval()


def babyai_rnn(categorical: bool = True, memory: int = 12) -> BabyAIRNN:
    """BabyAI's network in evaluation mode, whose norms have seen data; a grid of 3 x 1 cells."""
    torch.manual_seed(1)
    network = BabyAIRNN(
        language=LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH, NAMES),
        grid_key="grid",
        grid=FilmGridEncoder((3, 1, 2), 8, WIDTH),
        others=ObservationEncoder({"state": SPECS["state"]}, WIDTH),
        width=WIDTH,
        memory=memory,
        dropout=0.0,
        head=_last_head(categorical),
    )
    run(network, batch([13] * 8, categorical, seed=99))
    return network.eval()


def lang_bc(categorical: bool = True) -> LangBC:
    """Language-conditioned behaviour cloning in evaluation mode."""
    torch.manual_seed(1)
    language = LanguageEncoder(WordEncoder(WORDS, WIDTH), WIDTH, NAMES)
    return LangBC(language, observations(asking=False), WIDTH, 0.0, _last_head(categorical)).eval()


def observations(asking: bool = True) -> ObservationEncoder:
    """Of a grid of three cells with two symbols each, and a state."""
    return ObservationEncoder(SPECS, WIDTH, asking=AskingSpec(WIDTH, WIDTH // 2) if asking else None)


def attention() -> PartAttention:
    """Whose questions have left their starting point: at first they are the words as they are."""
    asks = PartAttention(WIDTH, WIDTH, WIDTH // 2, WIDTH, WIDTH)
    for layer in (asks.question, asks.nothing):
        nn.init.normal_(layer.weight, std=0.1)
        nn.init.normal_(layer.bias, std=0.1)
    return asks


def codebook(
    size: int = CODES,
    width: int = WIDTH,
    decay: float = 0.99,
    dead_code_threshold: float = 1.0,
    code_width: int | None = 4,
    parts: int = 1,
    warmup_steps: int = 0,
) -> Codebook:
    """A small codebook."""
    settings = CodebookSettings(decay, 0.25, dead_code_threshold, code_width, warmup_steps)
    return Codebook(width, [size] * parts, settings)


def run(network: EpisodeNetwork, what: Batch) -> tuple[Tensor, Tensor | None]:
    """Predictions for every frame, and codes for every chunk where the network has them."""
    out = network(what.tokens, what.valid, what.observations, what.actions, what.packing)
    return (out[0], out[1].codes) if isinstance(network, Lisa) else (out, None)


def _policy(categorical: bool, timesteps: TimestepEmbedding, transformer: CausalTransformer) -> ActionPredictor:
    return ActionPredictor(timesteps, transformer, _head(categorical))


def _head(categorical: bool) -> ActionHead:
    if categorical:
        return CategoricalHead(WIDTH, CLASSES)
    return MeanHead(WIDTH, torch.ones(2), torch.tensor([[-1.0] * 2, [1.0] * 2]))


def _last_head(categorical: bool) -> ActionHead:
    """Without vectors of actions, which a policy that looks at none does not need."""
    head = _head(categorical)
    del head.embedding
    return head
