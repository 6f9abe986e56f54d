"""The BabyAI-RNN policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.babyai_rnn`."""

from math import prod

from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.babyai_rnn import BabyAIRNN
from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.film import FilmGridEncoder
from lerobot_lisa.policies.babyai_rnn.configuration_babyai_rnn import BabyAIRNNConfig
from lerobot_lisa.policies.baseline_modeling import BaselinePolicy
from lerobot_lisa.policies.episode_settings import SYMBOLS
from lerobot_lisa.policies.parts import (
    make_language_encoder,
    make_last_head,
    make_observation_encoder,
    named_symbols,
)


class BabyAIRNNPolicy(BaselinePolicy):
    """BabyAI's own baseline: a grid seen in the light of the instruction (FiLM), and an LSTM over the episode."""

    config_class = BabyAIRNNConfig
    name = "babyai_rnn"
    config: BabyAIRNNConfig
    network: BabyAIRNN

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> BabyAIRNN:
        """Of the configured widths."""
        config, (key, shape) = self.config, find_grid(self.config)
        language = make_language_encoder(config)
        lonely = len(config.input_features) == 1
        return BabyAIRNN(
            language=language,
            grid_key=key,
            grid=FilmGridEncoder(shape, SYMBOLS, config.dim_model),
            others=None if lonely else make_observation_encoder(config, language, backbone, [key]),
            width=config.dim_model,
            memory=config.memory_width,
            dropout=config.dropout,
            head=make_last_head(config, action_bounds),
        )


def find_grid(config: BabyAIRNNConfig) -> tuple[str, tuple[int, int, int]]:
    """The first feature that is a grid of symbols, and its shape, channels last.

    Raises:
        UserError: There is none.
    """
    for key, symbols in named_symbols(config).items():
        shape = tuple(symbols["shape"]) if symbols else ()
        if len(shape) == 3 and prod(shape) == prod(config.input_features[key].shape):
            return key, shape
    raise UserError(
        f"babyai_rnn sees a grid of symbols whose `info` names its shape, but the policy gets "
        f"{', '.join(config.input_features)}: choose --policy.type=lang_bc or lang_dt for what is no grid"
    )
