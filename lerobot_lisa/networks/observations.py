"""Observation encoders, one per kind of feature: one embedding per frame, and the parts it can be asked about."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Literal

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.images import BackboneEncoder, FeatureEncoder, ImageEncoder, PatchParts
from lerobot_lisa.networks.parts import Parts, Seen
from lerobot_lisa.networks.symbols import SymbolEncoder, SymbolNames, SymbolParts


@dataclass(frozen=True)
class ObservationSpec:
    """What one observation feature holds.

    Attributes:
        kind: "symbols" (small integers, each position an own vocabulary), "state" (real numbers), "image", or
            "features" that a frozen backbone makes of an image.
        shape: Shape of one frame's value; images are (channels, height, width).
        symbols: How many different values a symbol can take; only for "symbols".
        names: What the symbols are called; None: they have no names.
    """

    kind: Literal["symbols", "state", "image", "features"]
    shape: tuple[int, ...]
    symbols: int = 0
    names: SymbolNames | None = None


@dataclass(frozen=True)
class AskingSpec:
    """How parts can be asked.

    Attributes:
        words: W, width of the space of words.
        values: C, width of what a part answers.
        whole: Product of two equal phrases in units of W, see `WordEncoder.whole`.
        sharpness: Of the attention at first.
    """

    words: int
    values: int
    whole: float = 2.0
    sharpness: float = 8.0

    @property
    def readiness(self) -> float:
        """Of named parts at first: a question has to match more than half of a name, one of two words is too little."""
        return -0.6 * self.whole * self.sharpness


class StateEncoder(nn.Module):
    """State vectors: a two-layer MLP (paper, section 4.1, "Observation Encoder")."""

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(size, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """(N, ...) real numbers -> whole (N, D), and the same as the only part (N, 1, D)."""
        whole = self.mlp(state.flatten(1).float())
        return whole, whole[:, None]


class ObservationEncoder(nn.Module):
    """All observation features of a frame, each through the encoder of its kind, summed; and their parts.

    Args:
        specs: What the features hold.
        width: D.
        backbone: Of images, one for all of them; None: three convolutions.
        asking: How parts can be asked; None: there are no parts.
    """

    def __init__(
        self,
        specs: Mapping[str, ObservationSpec],
        width: int,
        backbone: Backbone | None = None,
        asking: AskingSpec | None = None,
    ) -> None:
        super().__init__()
        self.symbolic = [key for key, spec in specs.items() if spec.kind == "symbols"]
        self.others = {key: key.replace(".", "_") for key in specs if key not in self.symbolic}
        self.encoders, self.parts = nn.ModuleDict(), nn.ModuleDict()
        if self.symbolic:
            positions = sum(prod(specs[key].shape) for key in self.symbolic)
            self.encoders["symbols"] = SymbolEncoder(positions, max(specs[key].symbols for key in self.symbolic), width)
        for key, name in self.others.items():
            self.encoders[name] = _encoder(specs[key], width, backbone)
        self.places = dict.fromkeys(specs, 0)
        named = any(spec.names for spec in specs.values())
        for key, spec in specs.items():
            if asking is None:
                break
            if named and spec.kind == "symbols" and spec.names is None:
                continue  # such as a heading: no thing
            name = key.replace(".", "_")
            self.parts[name] = _parts(spec, self.encoders[name] if key in self.others else None, width, asking)
            self.places[key] = _count_parts(spec, self.encoders[name] if key in self.others else None)

    def forward(self, observations: Mapping[str, Tensor], names: Tensor) -> Seen:
        """Look at N frames.

        Args:
            observations: Features, each (N, *shape).
            names: Vectors (n, W) of what symbols are called; see `LanguageEncoder.names`.
        """
        wholes, parts = [], []
        for key, name in self.others.items():
            whole, patches = self.encoders[name](observations[key])
            wholes.append(whole)
            if name in self.parts:
                parts.append((key, self.parts[name](patches)))
        if self.symbolic:
            symbols = torch.cat([observations[key].flatten(1) for key in self.symbolic], dim=1)
            wholes.append(self.encoders["symbols"](symbols))
        for key in self.symbolic:
            if (name := key.replace(".", "_")) in self.parts:
                parts.append((key, self.parts[name](observations[key], names)))
        return Seen(sum(wholes[1:], wholes[0]), self._join(parts))

    @property
    def all_places(self) -> int:
        """How many parts an observation can have, feature after feature in the order of `places`."""
        return sum(self.places.values())

    def _join(self, parts: list[tuple[str, Parts]]) -> Parts | None:
        """Number the places of all features through."""
        first, starts = 0, {}
        for key, count in self.places.items():
            starts[key] = first
            first += count
        numbered = [part._replace(places=part.places + starts[key]) for key, part in parts]
        return Parts.join(numbered) if numbered else None


def side_by_side(observations: Mapping[str, Tensor], keys: Sequence[str]) -> Tensor:
    """The numbers of some features of N frames, as they are, (N, S)."""
    return torch.cat([observations[key].flatten(1).float() for key in keys], dim=-1)


def _encoder(spec: ObservationSpec, width: int, backbone: Backbone | None) -> nn.Module:
    if spec.kind == "state":
        return StateEncoder(prod(spec.shape), width)
    if spec.kind == "features":
        return FeatureEncoder(spec.shape, width)
    return ImageEncoder(spec.shape[0], width) if backbone is None else BackboneEncoder(backbone, width)


def _parts(spec: ObservationSpec, encoder: nn.Module | None, width: int, asking: AskingSpec) -> nn.Module:
    if spec.kind == "symbols":
        cells = _count_parts(spec, None)
        return SymbolParts(cells, spec.symbols, asking.words, asking.values, spec.names, asking.readiness)
    if spec.kind == "state":
        return PatchParts(1, width, asking.words, asking.values)
    return PatchParts(encoder.patches, encoder.features, asking.words, asking.values)  # type: ignore[union-attr,arg-type]


def _count_parts(spec: ObservationSpec, encoder: nn.Module | None) -> int:
    if spec.kind in ("image", "features"):
        return encoder.patches  # type: ignore[union-attr,return-value]
    return 1 if spec.kind == "state" else prod(spec.shape) // (len(spec.names.channels) if spec.names else 1)
