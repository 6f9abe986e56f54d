"""Augmentation by the symmetries of a symbolic world: episodes mirrored, recoloured, with other kinds of things.

A dataset names its symmetries in the `info` of a symbolic feature, under "symmetries":

    {"mirror": {"axis": "column", "swap_actions": [["left", "right"]], "swap_words": [["left", "right"]],
                "swap_symbols": {"observation.direction": [["right", "left"]]}},
     "permute": [{"channel": "color", "words": ["red", ...], "where": {"kind": ["ball", ...]}},
                 {"channel": "kind", "words": ["ball", ...], "unless": {"kind": ["door"], "state": ["locked"]}}]}

`mirror` reverses one axis of the feature, and swaps actions, words and other features' symbols along with it. `permute`
renames the symbols of one channel, in the observations and in the instruction alike: only `where` other channels hold
certain symbols, and not in episodes where some cell is as `unless` says.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from lerobot_lisa.networks.packing import Packing

ACTION = "action"
Features = Mapping[str, Mapping[str, Any]]


class Told(NamedTuple):
    """Episodes and what they were told.

    Attributes:
        frames: Features of all N frames, each (N, *shape), with the action.
        tokens: Instruction tokens (B, M).
    """

    frames: dict[str, Tensor]
    tokens: Tensor


class Symmetries:
    """Draws a change for every episode of a batch.

    Args:
        key: The feature that names symmetries.
        features: The dataset's features, as in `info.json`.
        token_ids: The token of each word that may change; words without are never said, and stay.
    """

    def __init__(self, key: str, features: Features, token_ids: Mapping[str, int]) -> None:
        self.key, self.token_ids = key, dict(token_ids)
        info = features[key]["info"]
        self.shape = tuple(info["symbols"]["shape"])
        self.axes: list[str] = info["symbols"].get("axes", [])
        self.channels = {channel["name"]: list(channel["words"]) for channel in info["symbols"]["channels"]}
        self.permutes: list[dict[str, Any]] = info["symmetries"].get("permute", [])
        self.mirror: dict[str, Any] | None = info["symmetries"].get("mirror")
        self.actions = _classes(features.get(ACTION, {}))
        self.words = {name: _words(feature) for name, feature in features.items()}

    def __call__(self, told: Told, packing: Packing) -> Told:
        """Change every episode in a way of its own, drawn from torch's generator."""
        device, episodes = told.tokens.device, len(told.tokens)
        frames = {**told.frames, self.key: told.frames[self.key].reshape(-1, *self.shape)}
        renamed = torch.arange(1 + max(int(told.tokens.max()), *self.token_ids.values(), 0), device=device)
        renamed = renamed.repeat(episodes, 1)
        for permute in self.permutes:
            self._permute(permute, frames, renamed, packing)
        if self.mirror is not None:
            self._mirror(self.mirror, frames, renamed, packing)
        frames[self.key] = frames[self.key].reshape(told.frames[self.key].shape)
        return Told(frames, renamed.gather(1, told.tokens))

    def _permute(self, permute: dict[str, Any], frames: dict[str, Tensor], renamed: Tensor, packing: Packing) -> None:
        names = list(self.channels)
        channel, words = names.index(permute["channel"]), self.channels[permute["channel"]]
        changing = [words.index(word) for word in permute["words"] if word in self.token_ids]
        tokens = [self.token_ids[words[number]] for number in changing]
        if len(changing) < 2:
            return
        grid, device = frames[self.key], renamed.device
        order = torch.rand(len(renamed), len(changing), device=device).argsort(1)
        stays = self._episodes_with(permute.get("unless"), grid, packing)
        order = torch.where(stays[:, None], torch.arange(len(changing), device=device), order)

        table = torch.arange(256, device=device).repeat(len(renamed), 1)
        table[:, changing] = torch.tensor(changing, device=device)[order]
        symbols = grid[..., channel].long()
        changed = table[packing.sequence].gather(1, symbols.flatten(1)).view_as(symbols).to(grid.dtype)
        grid = grid.clone()
        grid[..., channel] = torch.where(self._cells_with(permute.get("where"), grid), changed, grid[..., channel])
        frames[self.key] = grid
        renamed[:, tokens] = renamed[:, tokens].gather(1, order)

    def _mirror(self, mirror: dict[str, Any], frames: dict[str, Tensor], renamed: Tensor, packing: Packing) -> None:
        flipped = torch.rand(len(renamed), device=renamed.device) < 0.5
        rows = flipped[packing.sequence]
        grid = frames[self.key]
        turned = grid.flip(1 + self.axes.index(mirror["axis"]))
        frames[self.key] = torch.where(rows.view(-1, *[1] * (grid.dim() - 1)), turned, grid)
        frames[ACTION] = _swap(frames[ACTION], rows, mirror.get("swap_actions", []), self.actions)
        for key, pairs in mirror.get("swap_symbols", {}).items():
            if key in frames:
                frames[key] = _swap(frames[key], rows, pairs, self.words[key])
        for one, other in mirror.get("swap_words", []):
            if one in self.token_ids and other in self.token_ids:
                both = [self.token_ids[one], self.token_ids[other]]
                renamed[:, both] = torch.where(flipped[:, None], renamed[:, both[::-1]], renamed[:, both])

    def _cells_with(self, wanted: Mapping[str, Sequence[str]] | None, grid: Tensor) -> Tensor:
        """(N, ...) cells whose channels hold one of the wanted symbols each; all cells if nothing is wanted."""
        cells = torch.ones(grid.shape[:-1], dtype=torch.bool, device=grid.device)
        for name, words in (wanted or {}).items():
            known = self.channels[name]
            numbers = torch.tensor([known.index(word) for word in words], device=grid.device, dtype=grid.dtype)
            cells &= torch.isin(grid[..., list(self.channels).index(name)], numbers)
        return cells

    def _episodes_with(self, wanted: Mapping[str, Sequence[str]] | None, grid: Tensor, packing: Packing) -> Tensor:
        """(B,) episodes in which a cell is as wanted; none if nothing is wanted."""
        if not wanted:
            return torch.zeros(len(packing.lengths), dtype=torch.bool, device=grid.device)
        return packing.mean(self._cells_with(wanted, grid).flatten(1).any(1).float()) > 0


def _swap(values: Tensor, rows: Tensor, pairs: Sequence[Sequence[str]], words: Sequence[str]) -> Tensor:
    """Exchange the numbers of pairs of words in some rows of values (N, ...)."""
    swapped = values.clone()
    for one, other in pairs:
        a, b = words.index(one), words.index(other)
        swapped = torch.where(values == a, b, torch.where(values == b, a, swapped))
    return torch.where(rows.view(-1, *[1] * (values.dim() - 1)), swapped.to(values.dtype), values)


def _classes(feature: Mapping[str, Any]) -> list[str]:
    names = feature.get("names")
    return list(names["classes"]) if isinstance(names, Mapping) and "classes" in names else []


def _words(feature: Mapping[str, Any]) -> list[str]:
    """What the numbers of a feature of one symbol are called."""
    symbols = (feature.get("info") or {}).get("symbols")
    return list(symbols["channels"][0]["words"]) if symbols else _classes(feature)


def symmetry_words(features: Features) -> list[str]:
    """All words that a dataset's symmetries may change."""
    words: list[str] = []
    for feature in features.values():
        symmetries = (feature.get("info") or {}).get("symmetries", {})
        words += [word for permute in symmetries.get("permute", []) for word in permute["words"]]
        words += [word for pair in symmetries.get("mirror", {}).get("swap_words", []) for word in pair]
    return list(dict.fromkeys(words))
