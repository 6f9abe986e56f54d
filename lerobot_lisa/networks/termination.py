"""When skills are over: after a fixed number of steps, or as soon as the skill predictor would choose another one."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.quantizers import Quantized


class Lasting(NamedTuple):
    """Skills of whole episodes, and how long each lasts.

    Attributes:
        embeddings: (Q, parts, E), what is followed from each question to the skill predictor on.
        questions: (N,) which question's answer each frame follows.
        skills: How many of the Q questions belong to each of the C skills: those at which it began and went on.
        chunks: Where the steps of each skill lie among the N frames.
        loss: Scalar, what is charged for haste.
    """

    embeddings: Tensor
    questions: Tensor
    skills: Packing
    chunks: Packing
    loss: Tensor


class Termination(nn.Module):
    """Says when skills begin, in training and in rollouts.

    The skill predictor is asked every so many steps. While it says the same, the skill goes on; it is over when another
    code is said, and after `horizon` steps in any case. Asked only every `horizon` steps, it makes the paper's skills.

    Nothing is learned here: the codes are, and each answer learns from what is done until the next question, also those
    that let a skill go on. Without a charge the skill predictor would change its mind at every question, which costs
    nothing and tells the policy more, so codes that are changed more often than every `steps` steps are charged for.

    As long as there are no codes, skills last `horizon` steps; in training shorter ones are drawn, `steps` long on
    average, so that question and policy know all lengths when codes come.

    Args:
        horizon: H, steps that a skill lasts at most.
        every: Steps from one question to the next, of which H is a multiple; None: H.
        steps: How long skills should last on average, at least.
        weight: Of the charge: what it costs to change codes twice as often as every `steps` steps; nothing where skills
            last H steps anyway.
    """

    def __init__(self, horizon: int, every: int | None = None, steps: float = 1, weight: float = 0) -> None:
        super().__init__()
        self.horizon, self.every, self.steps, self.weight = horizon, every or horizon, steps, weight

    def forward(self, answers: Quantized, frames: Packing) -> Lasting:
        """Cut episodes into skills.

        Args:
            answers: To the Q questions, at steps 0, every, 2 * every, ... of each episode, in order.
            frames: Where the B episodes, which begin with a skill, lie in the N frames.
        """
        asked, parts = frames.count_chunks(self.every), frames.split(self.every)
        begins = self._begins(answers.codes, asked)
        number = begins.cumsum(0) - 1
        skills = Packing(number.bincount(), frames.device)
        chunks = Packing(torch.zeros_like(skills.lengths).index_add(0, number, parts.lengths), frames.device)
        embeddings = answers.embeddings
        if answers.codes is None:  # numbers that go on changing, of which the first are kept
            embeddings = embeddings[begins.nonzero()[:, 0].to(frames.device)][skills.sequence]
        return Lasting(embeddings, parts.sequence, skills, chunks, self._charge(answers, asked, frames.total))

    def over(self, since: Tensor, followed: Tensor | None, said: Tensor | None) -> Tensor:
        """Whether skills (B,) that began some steps ago are over at a question.

        Args:
            since: (B,) how many.
            followed: (B,) their codes; None: they have none.
            said: (B,) the codes that would be chosen now.
        """
        late = since >= self.horizon
        return late if followed is None or said is None else late | (followed != said)

    @torch.no_grad()
    def _begins(self, codes: Tensor | None, asked: Packing) -> Tensor:
        """Which questions begin a skill, (Q,), on the CPU."""
        if self.every == self.horizon:
            return torch.ones(asked.total, dtype=torch.bool)
        place = torch.arange(asked.total)
        begins = asked.steps_cpu == 0
        if codes is not None:
            begins = begins | (codes != codes.roll(1)).cpu()
        elif self.training:
            begins = begins | (torch.rand(asked.total) < self.every / self.steps)
        since = place - torch.where(begins, place, 0).cummax(0).values
        return since % (self.horizon // self.every) == 0

    def _charge(self, answers: Quantized, asked: Packing, frames: int) -> Tensor:
        """For codes that are changed too often.

        How often is counted, and the gradient is that of `_unrest`: straight through, it draws answers together that
        follow one another.
        """
        if answers.codes is None or self.every == self.horizon:  # then nothing is ended
            return answers.embeddings.new_zeros(())
        follows = asked.steps != 0
        changed = follows & (answers.codes != answers.codes.roll(1))
        unrest = _unrest(answers.embeddings, follows)
        count = changed.sum() + unrest - unrest.detach()
        return self.weight * F.relu(count * self.steps / frames - 1)


def _unrest(embeddings: Tensor, follows: Tensor) -> Tensor:
    """How far answers (Q, parts, E) are from those that they follow, as a share of how far any two are, in all.

    Each part counts against its own spread. Measured in absolute distances a part that no words hold apart would shrink
    to a point, where it says another code at every question.
    """
    steps = ((embeddings - embeddings.roll(1, 0)).square().sum(2) * follows[:, None]).sum(0)
    spread = 2 * (embeddings - embeddings.mean(0)).square().sum(2).mean(0)
    return (steps / spread.clamp(min=1e-12)).sum()
