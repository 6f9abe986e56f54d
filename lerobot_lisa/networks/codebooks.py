"""Quantisers whose codes are learned: one codebook for each part of a skill, or one after another."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from vector_quantize_pytorch import ResidualVQ, VectorQuantize
from vector_quantize_pytorch.vector_quantize_pytorch import kmeans

from lerobot_lisa.networks.quantizers import Quantized, Quantizer

PLACED_ANEW = 50  # training steps between two looks whether k-means would place codes much better
MOST_DISTANCES = 4096  # codes; with more, distances to all of them are not worth their memory


@dataclass(frozen=True)
class CodebookSettings:
    """How codes are learned.

    Attributes:
        decay: Of the moving averages.
        commitment_weight: lambda.
        dead_code_threshold: A code that stands for fewer embeddings of a batch, in the moving average, is put onto a
            random one; 0 never revives a code.
        code_width: Numbers per code, after a projection and a layer norm; None: codes lie among the embeddings.
        warmup_steps: Training steps before codes are placed.
    """

    decay: float
    commitment_weight: float
    dead_code_threshold: float
    code_width: int | None = None
    warmup_steps: int = 0

    def of_the_library(self, width: int) -> dict[str, Any]:
        """What vector-quantize-pytorch calls this, for embeddings of a width."""
        return {
            "dim": width,
            "codebook_dim": self.code_width or width,
            "decay": self.decay,
            "commitment_weight": self.commitment_weight,
            "kmeans_init": True,
            "threshold_ema_dead_code": self.dead_code_threshold,
            "layernorm_after_project_in": self.code_width is not None,
            "rotation_trick": False,  # the paper's gradient is straight-through; this costs seven times as much
        }


class LearnedCodes(Quantizer):
    """What quantisers with codebooks share: when and how codes are placed.

    At first embeddings pass as they are. What to say has not been learned yet, so that they form no clusters; and it
    would never be learned if codes made all of them alike. Then codes are placed by k-means, from starting points that
    are far from one another (k-means++): codes drawn at random collapse to one within steps, and starting points drawn
    at random leave a third of well-separated clusters without a code of their own.

    Args:
        sizes: How many codes each part has.
        codebooks: VectorQuantize modules.
        warmup_steps: Training steps before codes are placed.
    """

    steps: Tensor

    def __init__(self, sizes: Sequence[int], codebooks: list[VectorQuantize], warmup_steps: int) -> None:
        super().__init__()
        self.sizes, self.warmup_steps = tuple(sizes), warmup_steps
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))
        for codebook in codebooks:
            codebook._codebook.sample_fn = far_samples

    def forward(self, embeddings: Tensor) -> Quantized:
        """Nearest codes of embeddings (N, parts, E)."""
        codes = self.makes_codes
        if self.training and not self.frozen:
            self.steps += 1
        return self.quantize(embeddings) if codes else Quantized(embeddings, None, embeddings.new_zeros(()), None)

    @property
    def makes_codes(self) -> bool:
        """From the first training step after the warm-up on."""
        return self.initialised or (self.training and int(self.steps) >= self.warmup_steps)

    @property
    @abstractmethod
    def initialised(self) -> bool:
        """Whether a training batch has placed the codes."""

    @abstractmethod
    def quantize(self, embeddings: Tensor) -> Quantized:
        """Nearest codes of embeddings (N, parts, E)."""


class Codebook(LearnedCodes):
    """A codebook for each part, learned as moving averages of the embeddings that its codes stand for.

    Paper, section 3.2: nearest code, exponential moving average (van den Oord et al., 2017), straight-through gradient.
    A code that stands for fewer than `dead_code_threshold` embeddings of a batch, in the moving average, is put onto a
    random one. Several parts make a product quantiser (Jegou et al., 2011).

    Args:
        width: E.
        sizes: How many codes each part has.
        settings: How codes are learned.
    """

    def __init__(self, width: int, sizes: Sequence[int], settings: CodebookSettings) -> None:
        quantizers = [VectorQuantize(codebook_size=size, **settings.of_the_library(width)) for size in sizes]
        super().__init__(sizes, quantizers, settings.warmup_steps)
        self.quantizers = nn.ModuleList(quantizers)

    def quantize(self, embeddings: Tensor) -> Quantized:
        """Nearest codes of embeddings (N, parts, E)."""
        if self.training and not self.frozen and self.initialised and int(self.steps) % PLACED_ANEW == 0:
            self._place_anew(embeddings.detach())
        distances = self._distances(embeddings) if self.initialised else None
        frozen = {"freeze_codebook": self.frozen}
        parts = [book(embeddings[None, :, part], **frozen) for part, book in enumerate(self._books)]
        quantized, codes, losses = (torch.stack(column, dim=-1) for column in zip(*parts, strict=True))
        return Quantized(
            quantized[0].transpose(1, 2),
            self.join(codes[0]),
            losses.sum(),
            _joint_distances(distances or self._distances(embeddings)),
        )

    @property
    def initialised(self) -> bool:
        """Whether a training batch has placed the codes."""
        return all(bool(book._codebook.initted) for book in self._books)

    @property
    def most_used(self) -> list[int]:
        """The code of each part that training used most, in the moving average."""
        return [int(book._codebook.cluster_size.argmax()) for book in self._books]

    @torch.no_grad()
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings of skill codes (N,)."""
        parts = zip(self._books, self.split(codes).unbind(1), strict=True)
        return torch.stack([book.get_output_from_indices(part) for book, part in parts], dim=1)

    @torch.no_grad()
    def _distances(self, embeddings: Tensor) -> list[Tensor]:
        """Squared distances (N, size) of each part."""
        projected = [book.project_in(embeddings[:, part]).float() for part, book in enumerate(self._books)]
        return [torch.cdist(x, book.codebook.float()).square() for x, book in zip(projected, self._books, strict=True)]

    @torch.no_grad()
    def _place_anew(self, embeddings: Tensor) -> None:
        """Where embeddings have come to form clusters that share codes, give them codes of their own."""
        if len(embeddings) < 3 * max(self.sizes):
            return
        for part, book in enumerate(self._books):
            samples, codes = book.project_in(embeddings[:, part]).float(), book._codebook
            centers, counts = kmeans(
                samples[None], book.codebook_size, 10, sample_fn=far_samples, all_reduce_fn=codes.kmeans_all_reduce_fn
            )
            lost = torch.stack([_distortion(samples, at) for at in (codes.embed[0], centers[0], samples.mean(0)[None])])
            codes.kmeans_all_reduce_fn(lost)
            now, then, without_codes = lost.tolist()
            if now > 0.01 * without_codes and then < 0.5 * now:
                codes.embed.copy_(centers)
                codes.embed_avg.copy_(centers * counts[..., None])
                codes.cluster_size.copy_(counts)

    @property
    def _books(self) -> list[Any]:
        """The same modules, of the library's type."""
        return list(self.quantizers)


class ResidualCodebook(LearnedCodes):
    """Codebooks one after another, each for what those before it left over (SoundStream, arXiv:2107.03312)."""

    def __init__(self, width: int, sizes: Sequence[int], settings: CodebookSettings) -> None:
        quantizer = ResidualVQ(
            num_quantizers=len(sizes),
            codebook_size=tuple(sizes),
            quantize_dropout=False,
            **settings.of_the_library(width),
        )
        super().__init__(sizes, list(quantizer.layers), settings.warmup_steps)
        self.quantizer = quantizer

    def quantize(self, embeddings: Tensor) -> Quantized:
        """Codes of embeddings (N, 1, E)."""
        quantized, indices, losses = self.quantizer(embeddings[:, 0][None], freeze_codebook=self.frozen)
        codes = self.join(indices[0])
        return Quantized(quantized[0][:, None], codes, losses.sum(), self._distances(embeddings[:, 0]))

    @property
    def initialised(self) -> bool:
        """Whether a training batch has placed the codes."""
        return all(bool(layer._codebook.initted) for layer in self.quantizer.layers)

    @torch.no_grad()
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings of skill codes (N,)."""
        return self.quantizer.get_output_from_indices(self.split(codes)[None])[0][:, None]

    @torch.no_grad()
    def _distances(self, embeddings: Tensor) -> Tensor | None:
        if self.n_codes > MOST_DISTANCES:
            return None
        everything = self.embed(torch.arange(self.n_codes, device=embeddings.device))[:, 0]
        return torch.cdist(embeddings.float(), everything.float()).square()


def _joint_distances(parts: list[Tensor]) -> Tensor | None:
    """Squared distances (N, K) to all skill codes: those of their parts, added."""
    joint = parts[0]
    for part in parts[1:]:
        if joint.shape[1] * part.shape[1] > MOST_DISTANCES:
            return None
        joint = (joint[:, :, None] + part[:, None]).flatten(1)
    return joint


def _distortion(samples: Tensor, codes: Tensor) -> Tensor:
    """Sum of squared distances of samples (N, E) to the nearest of codes (K, E)."""
    return torch.cdist(samples, codes).amin(1).square().sum()


@torch.no_grad()
def far_samples(samples: Tensor, count: int) -> Tensor:
    """Starting points of k-means that are far from one another: k-means++ (Arthur and Vassilvitskii, 2007).

    Args:
        samples: (1, N, E), as vector-quantize-pytorch hands them over.
        count: How many to choose.

    Returns:
        (1, count, E), the same in all processes that train together.
    """
    points = samples[0].float()
    chosen = [int(torch.randint(len(points), ()))]
    nearest = torch.full((len(points),), float("inf"), device=points.device)
    for _ in range(count - 1):
        nearest = torch.minimum(nearest, (points - points[chosen[-1]]).square().sum(-1))
        chosen.append(int(torch.multinomial(nearest.clamp(min=1e-12), 1)))
    centers = samples[:, chosen].clone()
    if torch.distributed.is_initialized():
        torch.distributed.broadcast(centers, src=0)
    return centers
