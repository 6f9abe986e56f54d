"""Settings of the LISA policy."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


@PreTrainedConfig.register_subclass("lisa")
@dataclass
class LisaConfig(EpisodePolicyConfig):
    """LISA (Garg et al., NeurIPS 2022): language to discrete skill codes to actions. Defaults: the paper's, appendix D.

    Attributes:
        n_predictor_layers: Transformer blocks of the skill predictor f.
        n_policy_layers: Transformer blocks of the policy pi.
        horizon: H, steps that one skill code lasts.
        shared_observation_encoder: Skill predictor and policy see with the same encoder, at half the cost. The paper
            does not say; with an encoder each, LISA has more parameters than Lang-DT.
        codebook_size: K, number of skill codes.
        code_width: Numbers per code.
        continuous_skills: Skills are any `code_width` numbers instead of one of K codes: an ablation of the paper
            (appendix, "Continuous skill codes"). There is then nothing to read or to steer, and settings of the
            codebook mean nothing.
        codebook_decay: Of the moving averages that are the codes.
        commitment_weight: lambda, weight of the commitment loss.
        dead_code_threshold: A code that stands for fewer embeddings of a batch than this, in the moving average, is put
            onto a random embedding; 0 never does. The paper does not mention it; without it codes die.
        skill_plan: Skill codes to follow in rollouts in place of the skill predictor's, such as "14" for the whole
            episode or "14*20,2*20" (see `networks.skill_plan`); None: none. The loss takes no notice of it.
        optimizer_lr_skill_predictor: Rate of the skill predictor and of the codebook's projections.
    """

    n_predictor_layers: int = 1
    n_policy_layers: int = 1
    horizon: int = 10
    shared_observation_encoder: bool = False
    codebook_size: int = 20
    code_width: int = 16
    continuous_skills: bool = False
    codebook_decay: float = 0.99
    commitment_weight: float = 0.25
    dead_code_threshold: float = 1.0

    skill_plan: str | None = None

    optimizer_lr_skill_predictor: float = 1e-5

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded."""
        super().__post_init__()
        for name in ("n_predictor_layers", "n_policy_layers", "horizon", "codebook_size", "code_width"):
            if getattr(self, name) < 1:
                raise UserError(f"--policy.{name}={getattr(self, name)} must be at least 1")
        if not 0 <= self.codebook_decay < 1:
            raise UserError(
                f"--policy.codebook_decay={self.codebook_decay} must be at least 0 and below 1, such as 0.99"
            )
