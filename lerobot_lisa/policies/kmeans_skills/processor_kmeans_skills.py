"""KMeansSkills' pipelines under the name LeRobot looks for."""

from lerobot_lisa.policies.base_processor import Pipelines, Stats, make_pipelines
from lerobot_lisa.policies.kmeans_skills.configuration_kmeans_skills import KMeansSkillsConfig


def make_kmeans_skills_pre_post_processors(config: KMeansSkillsConfig, dataset_stats: Stats | None = None) -> Pipelines:
    """Pipelines of a new policy; a loaded one brings its own."""
    return make_pipelines(config, dataset_stats)
