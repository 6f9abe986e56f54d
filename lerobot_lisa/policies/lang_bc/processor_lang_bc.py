"""LangBC's pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines
from lerobot_lisa.policies.lang_bc.configuration_lang_bc import LangBCConfig


def make_lang_bc_pre_post_processors(config: LangBCConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
