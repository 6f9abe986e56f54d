"""Settings of the LISA policy."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs import PreTrainedConfig

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

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        **EpisodePolicyConfig.BOUNDS,
        "n_predictor_layers": (1, 128),
        "n_policy_layers": (1, 128),
        "horizon": (1, 10**6),
        "codebook_size": (1, 10**6),
        "code_width": (1, 8192),
        "codebook_decay": (0, 0.999999),
        "commitment_weight": (0, 1e6),
        "dead_code_threshold": (0, 1e9),
        "optimizer_lr_skill_predictor": (0, 100),
    }

    def _count_parameters(self) -> int:
        codebook = 2 * self.code_width * (self.codebook_size + self.dim_model)
        return super()._count_parameters() + codebook + self.dim_model * self.horizon
