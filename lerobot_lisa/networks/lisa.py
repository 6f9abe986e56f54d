"""LISA: skill predictor, quantiser and policy, end to end over whole episodes and step by step in rollouts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.copying import OwnNumbers, PhraseCopier
from lerobot_lisa.networks.episode_network import EpisodeNetwork, History
from lerobot_lisa.networks.excerpts import every
from lerobot_lisa.networks.language import Instruction, LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.one_observation import OneObservation
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.parts import PartAttention, Seen, answered, spread
from lerobot_lisa.networks.quantizers import Quantized, Quantizer
from lerobot_lisa.networks.skill_plan import SkillPlan
from lerobot_lisa.networks.skill_predictor import SkillPredictor
from lerobot_lisa.networks.termination import Lasting, Termination
from lerobot_lisa.networks.transformer import Memory


@dataclass(kw_only=True)
class LisaHistory(History):
    """LISA's rollout so far.

    Attributes:
        instruction: What was said.
        naming: The words of it that name things.
        names: (n, W) of all things, said or not.
        predictor: What the skill predictor remembers: the instruction and the observations up to the last question.
        unseen: Observations (B, D) that it looks at since the last question, which it has not been shown yet.
        unseen_steps: When they were made.
        policy: What the policy remembers of the current chunk.
        since: (B,) steps since each current chunk began.
        skill: (B, parts, E) of the current chunks.
        codes: (B,) skill codes of the current chunks; None if skills are continuous.
        predicted: (B,) what the skill predictor said when it was last asked; something else than `codes` where a plan
            overrides it.
        plan: Whose codes are followed; set before the first step.
    """

    instruction: Instruction
    naming: Instruction
    names: Tensor
    predictor: Any
    unseen: list[Tensor] = field(default_factory=list)
    unseen_steps: list[int] = field(default_factory=list)
    policy: Memory | None = None
    since: Tensor | None = None
    skill: Tensor | None = None
    codes: Tensor | None = None
    predicted: Tensor | None = None
    plan: SkillPlan = field(default_factory=SkillPlan)


class Lisa(EpisodeNetwork):
    """Language and observations choose a skill code, which lasts H steps; code and chunk choose the actions.

    Args:
        language: Instructions to tokens.
        observations: What the policy sees with.
        predictor: f, chooses embeddings.
        source: What of f's answers the quantiser gets.
        quantizer: Makes skill codes of it, or lets it through.
        skill_embedding: Parts of skill codes to tokens of pi.
        action_predictor: pi, chooses actions.
        termination: When skills are over, H steps after they began or before.
        predictor_observations: What f sees with; None: `observations`, looking once for both.
        asks_words: The instruction's tokens ask what f sees; None: they do not.
        asks_skill: The skill code asks what pi sees; None: it does not.
    """

    def __init__(
        self,
        language: LanguageEncoder,
        observations: ObservationEncoder,
        predictor: SkillPredictor | OneObservation,
        source: PhraseCopier | OwnNumbers,
        quantizer: Quantizer,
        skill_embedding: nn.Linear,
        action_predictor: ActionPredictor,
        termination: Termination,
        predictor_observations: ObservationEncoder | None = None,
        asks_words: PartAttention | None = None,
        asks_skill: PartAttention | None = None,
    ) -> None:
        super().__init__()
        self.language, self.observations, self.predictor_observations = language, observations, predictor_observations
        self.predictor, self.source, self.quantizer = predictor, source, quantizer
        self.skill_embedding, self.action_predictor, self.termination = skill_embedding, action_predictor, termination
        self.asks_words, self.asks_skill = asks_words, asks_skill

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> tuple[Tensor, Quantized, Lasting]:
        """Predict every action that is learned from of B whole episodes or excerpts.

        Args:
            tokens: Instruction tokens (B, M).
            tokens_valid: (B, M), False for padding, which is at the end.
            observations: Features of all N frames, each (N, *shape).
            actions: (N, A).
            packing: Where each episode, or excerpt that begins with a chunk, lies in the N frames.

        Returns:
            Predictions for all frames that are learned from, what the skill predictor said at every question, in order,
            and what skills that makes.
        """
        instruction = self.language(tokens, tokens_valid)
        look_rows, looks = every(packing, self.predictor.stride)
        seen, predictor_seen = self._look(observations, packing.learned_rows, look_rows)
        if packing.learned_rows is not None:
            actions = actions[packing.learned_rows]
        every_question = self.termination.every
        owners = packing.learned.count_chunks(every_question).sequence

        heard = self._ask_words(predictor_seen, instruction.naming(), looks.sequence)
        answers = self.predictor(instruction.tokens, tokens_valid, heard, looks, every_question)
        said = self.quantizer(self.source(answers, instruction.take(owners), self.quantizer.makes_codes))
        lasting = self.termination(said, packing.learned)

        prefix = self.skill_embedding(lasting.embeddings)
        wanted, _ = self._ask_skill(seen, lasting.embeddings, prefix, lasting.questions)
        prefix = lasting.skills.mean(prefix)  # of equal ones: so every answer that let a skill go on learns from it
        return self.action_predictor(prefix, None, wanted, actions, lasting.chunks), said, lasting

    @property
    def head(self) -> ActionHead:
        """The policy's."""
        return self.action_predictor.head

    @property
    def horizon(self) -> int:
        """H, steps that a skill lasts at most."""
        return self.termination.horizon

    @property
    def reach(self) -> int:
        """The skill predictor's; the policy does not look out of its chunk."""
        return self.predictor.reach

    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> LisaHistory:
        """Start a rollout: show the skill predictor the instructions."""
        instruction = self.language(tokens, tokens_valid)
        return LisaHistory(
            instruction=instruction,
            naming=instruction.naming(),
            names=self.language.names(),
            predictor=self.predictor.begin(instruction.tokens, tokens_valid),
        )

    def act(self, history: LisaHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step; a skill code is chosen at steps 0, H, 2H, ... of each phase of the plan, or before."""
        code, step_in_phase = history.plan.at(history.step)
        asked, step = step_in_phase % self.termination.every == 0, history.step
        seen = self.observations(observations, history.names)
        if asked or step % self.predictor.stride == 0:
            self._show_predictor(history, observations, seen)
        all_begin = asked and self._choose_skill(history, code, step_in_phase == 0)
        if history.policy is None or history.skill is None or history.since is None:
            raise RuntimeError("a rollout starts at step 0")
        previous, since = None if all_begin else history.actions, history.since
        history.step, history.since = step + 1, since + 1
        wanted, looks = self._ask_skill(seen, history.skill, self.skill_embedding(history.skill), None)
        history.looks = spread(seen.parts, looks, self.observations.all_places)
        history.questions = torch.full(wanted.shape[:1], history.skill.shape[1])
        return self.action_predictor.step(history.policy, step, wanted, previous, since)

    def _choose_skill(self, history: LisaHistory, planned: int | None, new_phase: bool) -> bool:
        """Ask the skill predictor, whose memory and answer are wanted even where the plan has a code of its own.

        Returns:
            Whether all environments begin a skill.
        """
        seen = torch.stack(history.unseen, dim=1)
        answers = self.predictor.ask(history.predictor, seen, history.unseen_steps)
        skills = self.quantizer(self.source(answers, history.instruction, self.quantizer.makes_codes))
        history.unseen.clear()
        history.unseen_steps.clear()
        history.predicted = codes = skills.codes
        embeddings = skills.embeddings
        if planned is not None:
            codes = torch.full(seen.shape[:1], planned, device=seen.device)
            embeddings = self.quantizer.embed(codes)
        return self._follow(history, embeddings, codes, new_phase)

    def _follow(self, history: LisaHistory, skill: Tensor, codes: Tensor | None, new_phase: bool) -> bool:
        """Begin chunks with these skills where those before them are over; returns whether all are."""
        policy, since, before = history.policy, history.since, history.skill
        if new_phase or policy is None or since is None or before is None:
            return self._begin_chunks(history, skill, codes)
        over = self.termination.over(since, history.codes, codes)
        if over.all():
            return self._begin_chunks(history, skill, codes)
        if over.any():
            history.skill, history.since = torch.where(over[:, None, None], skill, before), since.masked_fill(over, 0)
            if codes is not None and history.codes is not None:
                history.codes = torch.where(over, codes, history.codes)
            self.action_predictor.begin_anew(policy, self.skill_embedding(history.skill), over)
        return False

    def _begin_chunks(self, history: LisaHistory, skill: Tensor, codes: Tensor | None) -> bool:
        """In all environments, from nothing."""
        history.skill, history.codes = skill, codes
        history.since = torch.zeros(len(skill), dtype=torch.int64, device=skill.device)
        history.policy = self.action_predictor.begin(self.skill_embedding(skill))
        return True

    def _show_predictor(self, history: LisaHistory, observations: Mapping[str, Tensor], seen: Seen) -> None:
        """Keep this step's observation for the skill predictor; `seen` is what the policy sees of it."""
        if self.predictor_observations is not None:
            seen = self.predictor_observations(observations, history.names)
        history.unseen.append(self._ask_words(seen, history.naming, None))
        history.unseen_steps.append(history.step)

    def _look(
        self, observations: Mapping[str, Tensor], rows: Tensor | None, predictor_rows: Tensor | None
    ) -> tuple[Seen, Seen]:
        """What the policy sees of some of N frames, and what the skill predictor sees of some; None: of all."""
        names = self.language.names()
        if self.predictor_observations is None:
            seen = self.observations(observations, names)
            return seen.take(rows), seen.take(predictor_rows)
        return (
            self.observations(_take(observations, rows), names),
            self.predictor_observations(_take(observations, predictor_rows), names),
        )

    def _ask_words(self, seen: Seen, said: Instruction, rows: Tensor | None) -> Tensor:
        """What the skill predictor sees, (N, D), the words that name things having asked for them."""
        return answered(self.asks_words, seen, said.phrases, said.tokens, said.valid, rows)[0]

    def _ask_skill(
        self, seen: Seen, skill: Tensor, prefix: Tensor, rows: Tensor | None
    ) -> tuple[Tensor, Tensor | None]:
        """What the policy sees, (N, D), the skill's parts having asked for things, and their attention (N, Q, P)."""
        return answered(self.asks_skill, seen, skill, prefix, rows=rows)


def _take(observations: Mapping[str, Tensor], rows: Tensor | None) -> Mapping[str, Tensor]:
    return observations if rows is None else {key: value[rows] for key, value in observations.items()}
