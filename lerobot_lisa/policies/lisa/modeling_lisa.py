"""The LISA policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.lisa`."""

from typing import Any

from torch import Tensor, nn

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.code_statistics import codes_used, mutual_information, perplexity
from lerobot_lisa.networks.copying import OwnNumbers, PhraseCopier
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.mlp import hidden_layers
from lerobot_lisa.networks.one_observation import OneObservation
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.quantizers import Quantized
from lerobot_lisa.networks.skill_plan import read_plan
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.termination import Termination
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer
from lerobot_lisa.policies.base_modeling import EpisodePolicy, Metrics
from lerobot_lisa.policies.lisa.code_names import code_labels, find_code, split
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.lisa.quantizer_choices import QUANTIZERS
from lerobot_lisa.policies.parts import (
    make_action_head,
    make_language_encoder,
    make_observation_encoder,
    make_part_attention,
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

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> Lisa:
        """Skill predictor, codebook and policy of the configured sizes."""
        config = self.config
        language = make_language_encoder(config)
        source = make_source(config, language)
        shared = config.shared_observation_encoder
        quantizer = QUANTIZERS[config.quantizer].make(config, source.width)
        if config.freeze_codebook:
            quantizer.freeze()
        return Lisa(
            language=language,
            observations=make_observation_encoder(config, language, backbone),
            predictor=make_skill_predictor(config),
            source=source,
            quantizer=quantizer,
            skill_embedding=nn.Linear(source.width, config.dim_model),
            action_predictor=make_action_predictor(config, action_bounds),
            termination=make_termination(config),
            predictor_observations=None if shared else make_observation_encoder(config, language, backbone),
            asks_words=make_part_attention(config, language, language.encoder.width),
            asks_skill=make_part_attention(config, language, source.width),
        )

    def get_optim_params(self) -> list[dict[str, Any]]:
        """One group per learning rate of the paper: policy, skill predictor with codebook, language encoder."""
        network, config = self.network, self.config
        policy = [network.observations, network.asks_skill, network.skill_embedding, network.action_predictor]
        seeing = [network.predictor_observations, network.asks_words, network.language.output]
        predictor = [*seeing, network.predictor, network.source, network.quantizer]
        return [
            parameter_group("policy", policy, config.policy_rate),
            parameter_group("skill_predictor", predictor, config.skill_predictor_rate),
            parameter_group("language_encoder", [network.language.encoder], config.language_rate),
        ]

    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions, what skills cost, and what the codebook does; `UserError` if there are no codes to keep."""
        if self.config.freeze_codebook and not self.network.quantizer.initialised:
            raise UserError(
                "--policy.freeze_codebook=true keeps the codes that training starts from, but there are none yet: "
                "start from a checkpoint that has codes, with --policy.path"
            )
        outputs, skills, lasting = self.network(tokens, tokens_valid, frames, actions, packing)
        metrics = _describe(skills, self.n_codes)
        if self.config.termination_stride:
            metrics["skill_steps"] = lasting.chunks.lengths.float().mean().to(lasting.loss.device)
            metrics["termination_loss"] = lasting.loss
        return outputs, skills.commitment + lasting.loss, metrics

    def follow(self, plan: str | None) -> None:
        """Steer rollouts from the next one on: LeRobot's own evaluation then runs the plan, in every environment.

        Args:
            plan: Such as "14", "14*20,2*20" or "red ball*20", see `SkillPlan`; None: the skill predictor chooses.

        Raises:
            UserError: It is no plan, or there is no such code. Names are looked up when a rollout begins: a policy that
                is being loaded has no codes yet.
        """
        if plan is not None:
            read_plan(plan, self._check_code)
        self.config.skill_plan = plan

    def _begin(self, tokens: Tensor, valid: Tensor) -> None:
        super()._begin(tokens, valid)
        if self.config.skill_plan is not None:
            self._history.plan = read_plan(self.config.skill_plan, self.find_code)

    @property
    def n_codes(self) -> int:
        """K, the number of skill codes; 0 if skills are continuous, or codes have not been placed yet."""
        return self.network.quantizer.n_codes if self.network.quantizer.initialised else 0

    @property
    def code_labels(self) -> list[str] | None:
        """What skill codes are called: number and nearest words, such as "3 red ball"; None if they have no words."""
        if not (self.config.copy_words and self.n_codes and self.config.lexicon):
            return None
        return code_labels(self.network, self.config.lexicon)

    def find_code(self, text: str) -> int:
        """The skill code of a number, or the one that is nearest to a phrase ("red ball"), "/" between its parts.

        Raises:
            UserError: There is none.
        """
        self._check_code(text)
        if not self.n_codes:
            raise UserError(
                "this policy has no skill codes yet: its training ended before its codes were placed, see "
                f"--policy.quantizer_warmup_steps={self.config.quantizer_warmup_steps}"
            )
        return int(text) if text.isdecimal() else find_code(self.network, self.config.lexicon, text)

    def _check_code(self, text: str) -> int:
        """Refuse what can be no code; names are not looked up, since a policy that is being loaded has no codes yet."""
        known = self.config.n_codes
        if not known:
            raise UserError("this policy has no skill codes to follow: its skills are continuous")
        if text.isdecimal() and (len(text) > 9 or int(text) >= known):
            raise UserError(f"there is no skill code {text:.20}; this policy has codes 0 to {known - 1}")
        if not text.isdecimal():
            if not self.config.copy_words:
                raise UserError(f"skill codes of this policy have no names: give a number instead of {text!r:.60}")
            split(self.config.lexicon, text)
        return 0

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
    if skills.codes is None:
        return {}
    metrics = {
        "commitment_loss": skills.commitment,
        "perplexity": perplexity(skills.codes, size),
        "codes_used": codes_used(skills.codes, size),
    }
    return (
        metrics if skills.distances is None else {**metrics, "mutual_information": mutual_information(skills.distances)}
    )


def make_source(config: LisaConfig, language: LanguageEncoder) -> PhraseCopier | OwnNumbers:
    """What the quantiser gets: phrases, or the skill predictor's own numbers."""
    parts = 1 if config.quantizer == "residual_vq" else config.n_code_parts
    if config.copy_words:
        return PhraseCopier(config.dim_model, language.encoder.width, parts, config.n_own_parts, config.code_width)
    return OwnNumbers(config.dim_model, parts)


def make_skill_predictor(config: LisaConfig) -> SkillPredictor | OneObservation:
    """f: looks back as far as configured, or over as many steps as the longest training episode has; or not at all."""
    if config.skill_predictor == "mlp":
        layers = hidden_layers(2 * config.dim_model, config.dim_model, config.dropout)
        return OneObservation(layers.append(nn.Linear(config.dim_model, config.dim_model)), config.look_stride)
    steps = config.max_timesteps or 1
    window = config.lookback_steps or steps
    return SkillPredictor(
        TimestepEmbedding(steps, config.dim_model),
        CausalTransformer(config.dim_model, config.n_predictor_layers, config.n_heads, config.dropout, window=window),
        config.dim_model,
        config.look_stride,
    )


def make_termination(config: LisaConfig) -> Termination:
    """After `horizon` steps, or before."""
    return Termination(config.horizon, config.question_stride, config.skill_steps, config.termination_weight)


def make_action_predictor(config: LisaConfig, action_bounds: Tensor) -> ActionPredictor:
    """pi: sees one chunk, and knows where in the chunk it is but not where in the episode."""
    return ActionPredictor(
        TimestepEmbedding(config.horizon, config.dim_model),
        CausalTransformer(config.dim_model, config.n_policy_layers, config.n_heads, config.dropout),
        make_action_head(config, action_bounds),
    )
