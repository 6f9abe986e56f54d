"""LISA: skill predictor, codebook and policy, end to end over whole episodes and step by step in rollouts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.codebook import Quantized, Skills
from lerobot_lisa.networks.episode_network import EpisodeNetwork, History
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.skill_plan import SkillPlan
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.transformer import Memory


@dataclass(kw_only=True)
class LisaHistory(History):
    """LISA's rollout so far.

    Attributes:
        predictor: What the skill predictor remembers: the instruction and the observations up to the last question.
        unseen: Observations since the last question, which the skill predictor has not been shown yet.
        policy: What the policy remembers of the current chunk.
        codes: (B,) skill codes of the current chunk; None if skills are continuous.
        predicted: (B,) what the skill predictor chose for it; something else than `codes` where a plan overrides it.
        plan: Whose codes are followed; set before the first step.
    """

    predictor: Memory
    unseen: list[Mapping[str, Tensor]] = field(default_factory=list)
    policy: Memory | None = None
    codes: Tensor | None = None
    predicted: Tensor | None = None
    plan: SkillPlan = field(default_factory=SkillPlan)


class Lisa(EpisodeNetwork):
    """Language and observations choose a skill code every H steps; code and chunk choose the actions.

    Args:
        language: Instructions to tokens.
        observations: What the policy sees with.
        predictor: f, chooses embeddings.
        codebook: Turns embeddings into skill codes, or lets continuous ones through.
        skill_embedding: Skill codes to tokens of the policy.
        policy: pi, chooses actions.
        horizon: H.
        predictor_observations: What the skill predictor sees with; None: `observations`, looking once for both.
    """

    def __init__(
        self,
        language: LanguageEncoder,
        observations: ObservationEncoder,
        predictor: SkillPredictor,
        codebook: Skills,
        skill_embedding: nn.Linear,
        policy: ActionPredictor,
        horizon: int,
        predictor_observations: ObservationEncoder | None = None,
    ) -> None:
        super().__init__()
        self.language, self.observations, self.predictor, self.codebook = language, observations, predictor, codebook
        self.skill_embedding, self.policy, self.horizon = skill_embedding, policy, horizon
        self.predictor_observations = predictor_observations

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> tuple[Tensor, Quantized]:
        """Predict every action of B whole episodes.

        Args:
            tokens: Instruction tokens (B, M).
            tokens_valid: (B, M), False for padding, which is at the end.
            observations: Features of all N frames, each (N, *shape).
            actions: (N, A).
            packing: Where each episode lies in the N frames.

        Returns:
            Predictions for all N frames, and the skill codes of all chunks, in order.
        """
        language, seen = self.language(tokens, tokens_valid), self.observations(observations)
        predictor_seen = self.predictor_observations(observations) if self.predictor_observations else seen
        skills = self.codebook(self.predictor(language, tokens_valid, predictor_seen, packing, self.horizon))
        prefix = self.skill_embedding(skills.embeddings)[:, None]
        return self.policy(prefix, None, seen, actions, packing.split(self.horizon)), skills

    @property
    def head(self) -> ActionHead:
        """The policy's."""
        return self.policy.head

    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> LisaHistory:
        """Start a rollout: show the skill predictor the instructions."""
        return LisaHistory(predictor=self.predictor.begin(self.language(tokens, tokens_valid), tokens_valid))

    def act(self, history: LisaHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step; a skill code is chosen at steps 0, H, 2H, ... of each phase of the plan."""
        history.unseen.append(observations)
        code, step_in_phase = history.plan.at(history.step)
        step_in_chunk = step_in_phase % self.horizon
        if step_in_chunk == 0:
            self._choose_skill(history, code)
        if history.policy is None:
            raise RuntimeError("a rollout starts at step 0")
        previous = history.actions if step_in_chunk else None
        history.step += 1
        return self.policy.step(history.policy, step_in_chunk, self.observations(observations), previous)

    def _choose_skill(self, history: LisaHistory, planned: int | None) -> None:
        """Ask the skill predictor, whose memory and answer are wanted even where the plan has a code of its own."""
        count = len(history.unseen)
        recent = {key: torch.cat([frame[key] for frame in history.unseen]) for key in history.unseen[0]}
        seen = (self.predictor_observations or self.observations)(recent).unflatten(0, (count, -1)).transpose(0, 1)
        skills = self.codebook(self.predictor.ask(history.predictor, seen, history.step + 1 - count))
        history.unseen.clear()
        history.codes = history.predicted = skills.codes
        embeddings = skills.embeddings
        if planned is not None:
            history.codes = torch.full(skills.embeddings.shape[:1], planned, device=skills.embeddings.device)
            embeddings = self.codebook.embed(history.codes)
        history.policy = self.policy.begin(self.skill_embedding(embeddings)[:, None])
