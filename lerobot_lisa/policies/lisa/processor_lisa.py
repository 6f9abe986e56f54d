"""Lisa's pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


def make_lisa_pre_post_processors(config: LisaConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
