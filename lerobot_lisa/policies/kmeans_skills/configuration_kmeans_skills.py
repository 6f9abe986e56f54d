"""Settings of the k-means-skills policy."""

from dataclasses import dataclass
from typing import Any, ClassVar

from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


@PreTrainedConfig.register_subclass("kmeans_skills")
@dataclass
class KMeansSkillsConfig(LisaConfig):
    """LISA's policy with codes that k-means makes of language and states, the LISA paper's own comparison.

    Of LISA's settings `codebook_size`, `horizon` and the policy's are used. Nothing makes up skills that could copy,
    ask or be learned: whatever is set in `FIXED` stays.
    """

    ask_observations: bool = False
    augment: bool = False
    copy_words: bool = False
    freeze_language_encoder: bool = True
    quantizer_warmup_steps: int = 0

    FIXED: ClassVar[dict[str, Any]] = {
        "ask_observations": False,
        "copy_words": False,
        "freeze_language_encoder": True,
        "skill_predictor": "transformer",
        "termination_stride": 0,
        "quantizer": "vq",
        "n_code_parts": 1,
        "n_own_parts": 0,
        "quantizer_warmup_steps": 0,
        "predictor_stride": 1,
        "shared_observation_encoder": False,
    }
    EXCERPT_STEPS: ClassVar[int] = 0
    LOOKBACK_STEPS: ClassVar[int] = 0

    def __post_init__(self) -> None:
        """Refuse what only learned skills can do."""
        for name, value in self.FIXED.items():
            if (given := getattr(self, name)) not in (None, value):
                raise UserError(
                    f"--policy.{name}={given!s:.60}: skills of {self.type} are not learned, leave it at {value}; "
                    "--policy.type=lisa has learned ones"
                )
        super().__post_init__()

    def _check_observation(self, key: str, feature: PolicyFeature) -> None:
        super()._check_observation(key, feature)
        if feature.type is FeatureType.VISUAL:
            raise UserError(
                f"{self.type} clusters states and symbols, pixels of `{key}` mean nothing to it: leave it out of "
                "--policy.input_features"
            )
