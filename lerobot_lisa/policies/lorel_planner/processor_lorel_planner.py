"""LorelPlanner's pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines
from lerobot_lisa.policies.lorel_planner.configuration_lorel_planner import LorelPlannerConfig


def make_lorel_planner_pre_post_processors(config: LorelPlannerConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
