"""What stands between the skill predictor and the policy: quantisers that make skill codes, or none."""

from abc import ABC, abstractmethod
from math import prod
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from vector_quantize_pytorch import FSQ, ResidualVQ, VectorQuantize
from vector_quantize_pytorch.vector_quantize_pytorch import kmeans

PLACED_ANEW = 50  # training steps between two looks whether k-means would place codes much better
MOST_DISTANCES = 4096  # codes; with more, distances to all of them are not worth their memory


class Quantized(NamedTuple):
    """Skills of N embeddings.

    Attributes:
        embeddings: (N, parts, E), what the policy is conditioned on; gradients pass straight through to the input.
        codes: (N,) skill codes, 0..K-1; None if skills are continuous.
        commitment: Scalar, mean squared distance between inputs and their codes, times the commitment weight.
        distances: (N, K) squared distances between inputs and codes, without gradient; None where there are none.
    """

    embeddings: Tensor
    codes: Tensor | None
    commitment: Tensor
    distances: Tensor | None


class Quantizer(nn.Module, ABC):
    """Turns embeddings (N, parts, E) into skills.

    Attributes:
        sizes: How many codes each part has; a skill code is one number, its parts' codes in mixed radix. Empty if
            skills are continuous.
    """

    sizes: tuple[int, ...]

    @abstractmethod
    def forward(self, embeddings: Tensor) -> Quantized:
        """Skills of real embeddings (N, parts, E), padding left out. In training mode this may move the codes."""

    @abstractmethod
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings (N, parts, E) of skill codes (N,): what the policy gets when a person chooses them."""

    @property
    def n_codes(self) -> int:
        """K; 0 if skills are continuous."""
        return prod(self.sizes) if self.sizes else 0

    @property
    def initialised(self) -> bool:
        """Whether codes have been placed."""
        return True

    def split(self, codes: Tensor) -> Tensor:
        """Skill codes (N,) to codes of their parts (N, parts)."""
        parts = []
        for size in reversed(self.sizes):
            parts.append(codes % size)
            codes = codes // size
        return torch.stack(parts[::-1], dim=-1)

    def join(self, parts: Tensor) -> Tensor:
        """Codes of parts (N, parts) to skill codes (N,)."""
        codes = torch.zeros_like(parts[:, 0])
        for column, size in zip(parts.unbind(1), self.sizes, strict=True):
            codes = codes * size + column
        return codes


class Continuous(Quantizer):
    """No codes at all: an ablation of the paper (appendix, "Continuous skill codes").

    Args:
        width: E.
        code_width: Numbers that pass, layer-normalised; None: all of them, as they are.
    """

    sizes = ()

    def __init__(self, width: int, code_width: int | None) -> None:
        super().__init__()
        self.passage: nn.Module = nn.Identity()
        if code_width is not None:
            narrow = nn.Sequential(nn.Linear(width, code_width), nn.LayerNorm(code_width))
            self.passage = nn.Sequential(narrow, nn.Linear(code_width, width))

    def forward(self, embeddings: Tensor) -> Quantized:
        """Through `code_width` numbers and back, (N, parts, E)."""
        return Quantized(self.passage(embeddings), None, embeddings.new_zeros(()), None)

    def embed(self, codes: Tensor) -> Tensor:
        """There is no code to choose."""
        raise RuntimeError("continuous skills have no codes")


class LearnedCodes(Quantizer):
    """What quantisers with codebooks share: when and how codes are placed.

    At first embeddings pass as they are. What to say has not been learned yet, so that they form no clusters; and it
    would never be learned if codes made all of them alike. Then codes are placed by k-means, from starting points that
    are far from one another (k-means++): codes drawn at random collapse to one within steps, and starting points drawn
    at random leave a third of well-separated clusters without a code of their own.

    Args:
        codebooks: VectorQuantize modules.
        warmup_steps: Training steps before codes are placed.
    """

    steps: Tensor

    def __init__(self, codebooks: list[VectorQuantize], warmup_steps: int) -> None:
        super().__init__()
        self.warmup_steps = warmup_steps
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))
        for codebook in codebooks:
            codebook._codebook.sample_fn = far_samples

    def forward(self, embeddings: Tensor) -> Quantized:
        """Nearest codes of embeddings (N, parts, E)."""
        if self.training:
            self.steps += 1
        if not self.initialised and (not self.training or int(self.steps) <= self.warmup_steps):
            return Quantized(embeddings, None, embeddings.new_zeros(()), None)
        return self.quantize(embeddings)

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
        size: Codes of each part.
        code_width: Numbers per code, after a projection and a layer norm; None: codes lie among the embeddings.
        decay: Of the moving averages.
        commitment_weight: lambda.
        dead_code_threshold: See above; 0 never revives a code.
        parts: How many there are.
        warmup_steps: Training steps before codes are placed.
    """

    def __init__(
        self,
        width: int,
        size: int,
        code_width: int | None,
        decay: float,
        commitment_weight: float,
        dead_code_threshold: float,
        parts: int = 1,
        warmup_steps: int = 0,
    ) -> None:
        quantizers = [
            VectorQuantize(
                dim=width,
                codebook_size=size,
                codebook_dim=code_width or width,
                decay=decay,
                commitment_weight=commitment_weight,
                kmeans_init=True,
                threshold_ema_dead_code=dead_code_threshold,
                layernorm_after_project_in=code_width is not None,
                rotation_trick=False,  # the paper's gradient is straight-through; this costs seven times as much
            )
            for _ in range(parts)
        ]
        super().__init__(quantizers, warmup_steps)
        self.sizes = (size,) * parts
        self.quantizers = nn.ModuleList(quantizers)

    def quantize(self, embeddings: Tensor) -> Quantized:
        """Nearest codes of embeddings (N, parts, E)."""
        if self.training and self.initialised and int(self.steps) % PLACED_ANEW == 0:
            self._place_anew(embeddings.detach())
        distances = self._distances(embeddings) if self.initialised else None
        parts = [book(embeddings[None, :, part]) for part, book in enumerate(self._books)]
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
        if len(embeddings) < 3 * self.sizes[0]:
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

    def __init__(
        self,
        width: int,
        size: int,
        code_width: int | None,
        decay: float,
        commitment_weight: float,
        dead_code_threshold: float,
        parts: int = 2,
        warmup_steps: int = 0,
    ) -> None:
        quantizer = ResidualVQ(
            dim=width,
            num_quantizers=parts,
            codebook_size=size,
            codebook_dim=code_width or width,
            decay=decay,
            commitment_weight=commitment_weight,
            kmeans_init=True,
            threshold_ema_dead_code=dead_code_threshold,
            rotation_trick=False,
            quantize_dropout=False,
        )
        super().__init__(list(quantizer.layers), warmup_steps)
        self.sizes = (size,) * parts
        self.quantizer = quantizer

    def quantize(self, embeddings: Tensor) -> Quantized:
        """Codes of embeddings (N, 1, E)."""
        quantized, indices, losses = self.quantizer(embeddings[:, 0][None])
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


class FiniteScalars(Quantizer):
    """Finite scalar quantisation (arXiv:2309.15505): a few numbers, each rounded to one of a few levels."""

    def __init__(self, width: int, levels: list[int]) -> None:
        super().__init__()
        self.quantizer = FSQ(levels=levels, dim=width)
        self.sizes = (self.quantizer.codebook_size,)

    def forward(self, embeddings: Tensor) -> Quantized:
        """Codes of embeddings (N, 1, E)."""
        quantized, codes = self.quantizer(embeddings[:, 0][None])
        return Quantized(quantized[0][:, None], codes[0].long(), embeddings.new_zeros(()), None)

    @torch.no_grad()
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings of skill codes (N,)."""
        return self.quantizer.indices_to_codes(codes[None])[0][:, None]


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
