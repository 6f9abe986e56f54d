"""Settings of the LOReL-Planner policy."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.baseline_configuration import BaselineConfig


@PreTrainedConfig.register_subclass("lorel_planner")
@dataclass
class LorelPlannerConfig(BaselineConfig):
    """LOReL (Nair et al., CoRL 2021, arXiv:2109.01115) on states: what it imagines is judged, and the best is done.

    The numbers of the search are ours (docs/baselines.md says what they gain and cost). Of images it would need a model
    that predicts them.

    Attributes:
        dropout: In model and judge.
        plan_steps: How far it looks ahead, at every step; an episode of LOReL's tabletop has 20.
        plan_samples: Plans that each round of the search draws.
        plan_elites: The best of them, around which the next round draws.
        plan_rounds: Of the search.
    """

    dropout: float = 0.0
    plan_steps: int = 20
    plan_samples: int = 100
    plan_elites: int = 10
    plan_rounds: int = 2

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        **BaselineConfig.BOUNDS,
        "plan_steps": (1, 1000),
        "plan_samples": (1, 10_000),
        "plan_elites": (1, 10_000),
        "plan_rounds": (1, 1000),
    }

    def __post_init__(self) -> None:
        """Refuse more elites than plans."""
        super().__post_init__()
        if self.plan_elites > self.plan_samples:
            raise UserError(
                f"--policy.plan_elites={self.plan_elites} are the best of --policy.plan_samples={self.plan_samples}: "
                "choose fewer"
            )

    def validate_features(self) -> None:
        """Refuse what no plan can be made with.

        Raises:
            UserError: As every policy does, or an observation is no state, or actions are categories.
        """
        super().validate_features()
        if self.action_classes:
            raise UserError(f"{self.type} plans real-valued actions: choose --policy.type=babyai_rnn for categories")

    def _check_observation(self, key: str, feature: PolicyFeature) -> None:
        super()._check_observation(key, feature)
        if feature.type is not FeatureType.STATE:
            raise UserError(
                f"{self.type} imagines states, and has no model of `{key}`: leave it out of --policy.input_features, "
                "or choose --policy.type=lang_bc"
            )
