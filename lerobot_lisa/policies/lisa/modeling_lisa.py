"""The LISA policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.lisa`."""

from typing import Any

from torch import Tensor, nn

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.codebook import (
    Codebook,
    ContinuousSkills,
    Quantized,
    Skills,
    codes_used,
    mutual_information,
    perplexity,
)
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.skill_plan import SkillPlan, read_plan
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer
from lerobot_lisa.policies.base_modeling import EpisodePolicy, Metrics
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.parts import (
    make_action_head,
    make_language_encoder,
    make_observation_encoder,
    parameter_group,
)


class LisaPolicy(EpisodePolicy):
    """LISA: learns skill codes from language and acts with them (Garg et al., NeurIPS 2022)."""

    config_class = LisaConfig
    name = "lisa"
    config: LisaConfig
    network: Lisa

    def __init__(self, config: LisaConfig, *arguments: Any, **named: Any) -> None:
        """Build the policy, ready to follow the configured plan; see `EpisodePolicy`."""
        super().__init__(config, *arguments, **named)
        self.follow(config.skill_plan)

    def make_network(self, action_bounds: Tensor) -> Lisa:
        """Skill predictor, codebook and policy of the configured sizes."""
        config = self.config
        return Lisa(
            language=make_language_encoder(config),
            observations=make_observation_encoder(config),
            predictor=make_skill_predictor(config),
            codebook=make_bottleneck(config),
            skill_embedding=nn.Linear(config.dim_model, config.dim_model),
            policy=make_action_predictor(config, action_bounds),
            horizon=config.horizon,
            predictor_observations=None if config.shared_observation_encoder else make_observation_encoder(config),
        )

    def get_optim_params(self) -> list[dict[str, Any]]:
        """One group per learning rate of the paper: policy, skill predictor with codebook, language encoder."""
        network, config = self.network, self.config
        policy = [network.observations, network.skill_embedding, network.policy]
        predictor = [network.predictor, network.codebook, network.language.output]
        if network.predictor_observations:
            predictor.append(network.predictor_observations)
        return [
            parameter_group("policy", policy, config.optimizer_lr),
            parameter_group("skill_predictor", predictor, config.optimizer_lr_skill_predictor),
            parameter_group("language_encoder", [network.language.encoder], config.language_rate),
        ]

    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions, commitment loss and what the codebook does."""
        outputs, skills = self.network(tokens, tokens_valid, frames, actions, packing)
        return outputs, skills.commitment, _describe(skills, self.config.codebook_size)

    def follow(self, plan: str | None) -> None:
        """Steer rollouts from the next one on: LeRobot's own evaluation then runs the plan, in every environment.

        Args:
            plan: Such as "14" or "14*20,2*20", see `SkillPlan`; None: the skill predictor chooses.

        Raises:
            UserError: It is no plan, or there is no such code.
        """
        if plan is not None and self.config.continuous_skills:
            raise UserError(f"skill plan {plan!r}: this policy's skills are continuous, so there is no code to follow")
        self._plan = SkillPlan() if plan is None else read_plan(plan, self.config.codebook_size)
        self.config.skill_plan = plan

    def _begin(self, tokens: Tensor, valid: Tensor) -> None:
        super()._begin(tokens, valid)
        self._history.plan = self._plan

    @property
    def skill_codes(self) -> Tensor | None:
        """Skill codes (B,) that the current rollout follows; None before its first step and for continuous skills."""
        return None if self._history is None else self._history.codes

    @property
    def predicted_codes(self) -> Tensor | None:
        """Skill codes (B,) that the skill predictor chose when a code was last due, followed or not."""
        return None if self._history is None else self._history.predicted


def _describe(skills: Quantized, size: int) -> Metrics:
    """What the codebook does, for the training log."""
    if skills.codes is None or skills.distances is None:
        return {}
    return {
        "commitment_loss": skills.commitment,
        "perplexity": perplexity(skills.codes, size),
        "codes_used": codes_used(skills.codes, size),
        "mutual_information": mutual_information(skills.distances),
    }


def make_bottleneck(config: LisaConfig) -> Skills:
    """The codebook, or nothing but a narrow passage."""
    if config.continuous_skills:
        return ContinuousSkills(config.dim_model, config.code_width)
    return Codebook(
        config.dim_model,
        config.codebook_size,
        config.code_width,
        config.codebook_decay,
        config.commitment_weight,
        config.dead_code_threshold,
    )


def make_skill_predictor(config: LisaConfig) -> SkillPredictor:
    """f: looks back over as many steps as the longest training episode has."""
    steps = config.max_timesteps or 1
    return SkillPredictor(
        TimestepEmbedding(steps, config.dim_model),
        CausalTransformer(config.dim_model, config.n_predictor_layers, config.n_heads, config.dropout, window=steps),
        config.dim_model,
    )


def make_action_predictor(config: LisaConfig, action_bounds: Tensor) -> ActionPredictor:
    """pi: sees one chunk, and knows where in the chunk it is but not where in the episode."""
    return ActionPredictor(
        TimestepEmbedding(config.horizon, config.dim_model),
        CausalTransformer(config.dim_model, config.n_policy_layers, config.n_heads, config.dropout),
        make_action_head(config, action_bounds),
    )
