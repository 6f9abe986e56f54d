"""BabyAIRNN's pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.babyai_rnn.configuration_babyai_rnn import BabyAIRNNConfig
from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines


def make_babyai_rnn_pre_post_processors(config: BabyAIRNNConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
