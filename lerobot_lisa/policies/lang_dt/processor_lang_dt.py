"""LangDT's pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig


def make_lang_dt_pre_post_processors(config: LangDTConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
