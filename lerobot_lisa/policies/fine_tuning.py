"""Load weights into a policy that has grown since they were saved: more words, longer episodes."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from safetensors import safe_open
from torch import Tensor, nn

from lerobot_lisa.networks.language import WordEncoder
from lerobot_lisa.networks.timesteps import TimestepEmbedding


@contextmanager
def at_saved_size(network: nn.Module, file: str) -> Iterator[None]:
    """Cut the tables of words and steps to the rows that a file has of them, and put the others back afterwards.

    New words keep their fresh embeddings. New steps get that of the last old one, which they shared so far.
    """
    with safe_open(file, "pt") as saved:
        known = set(saved.keys())
        rows = {
            module: saved.get_slice(key).get_shape()[0]
            for name, module in network.named_modules()
            if isinstance(module, WordEncoder | TimestepEmbedding)
            and (key := f"network.{name}.embedding.weight") in known
        }
    fresh = {module: module.embedding.weight.data for module in rows}
    for module, count in rows.items():
        if count < len(fresh[module]):
            module.embedding.weight.data = fresh[module][:count].clone()
    yield
    for module, count in rows.items():
        if count < len(fresh[module]):
            module.embedding.weight.data = _joined(module, fresh[module])


def _joined(module: WordEncoder | TimestepEmbedding, fresh: Tensor) -> Tensor:
    """What has been loaded, and the rows that were not there."""
    loaded = module.embedding.weight.data
    rest = fresh[len(loaded) :].to(loaded.device)
    if isinstance(module, TimestepEmbedding):
        rest = loaded[-1:].expand_as(rest)
    return torch.cat([loaded, rest])
