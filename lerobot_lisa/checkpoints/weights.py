"""A checkpoint's weights: all that the policy has, of its shapes and types, finite; nothing else."""

from collections.abc import Iterable
from pathlib import Path

import torch
from safetensors import safe_open
from torch import Tensor, nn

from lerobot_lisa.checkpoints.files import RETAKE, refusing
from lerobot_lisa.errors import UserError

OPTIONAL = {"randomness.seed", "randomness.steps"}
"""Of the training step's random numbers, in older checkpoints: nothing that a policy acts with."""

_FIX = f"leave out --policy options that change the network, or {RETAKE}"


def check_weights(path: Path, policy: nn.Module) -> None:
    """Compare a file with a policy before the policy takes memory.

    Args:
        path: Of the weights, safetensors.
        policy: As its configuration builds it, on the meta device.

    Raises:
        UserError: A tensor is missing, unknown, of another shape or type, or holds numbers that are not finite.
    """
    with refusing(f"{path} is no file of weights"), safe_open(path, framework="pt", device="cpu") as file:
        names = set(file.keys())
        _check_names(path, policy, names)
        wanted = policy.state_dict()
        for name in sorted(names & wanted.keys()):
            shape = tuple(file.get_slice(name).get_shape())
            if shape != tuple(wanted[name].shape):
                raise UserError(f"{path}: {name} has shape {shape}, the policy's {tuple(wanted[name].shape)}: {_FIX}")
            _check_values(path, name, file.get_tensor(name), wanted[name].dtype)


def _check_names(path: Path, policy: nn.Module, names: set[str]) -> None:
    wanted = policy.state_dict().keys()
    missing = [group for group in _same_tensors(policy) if group <= wanted and not group & (names | OPTIONAL)]
    if missing:
        listed = _listed(min(group) for group in missing)
        raise UserError(f"{path} lacks {len(missing)} of {len(wanted)} weights ({listed}): {RETAKE}")
    if unknown := names - wanted - OPTIONAL:
        raise UserError(f"{path} has {len(unknown)} weights that the policy does not ({_listed(unknown)}): {RETAKE}")


def _check_values(path: Path, name: str, value: Tensor, dtype: torch.dtype) -> None:
    if value.dtype != dtype:
        raise UserError(f"{path}: {name} is {value.dtype}, the policy's {dtype}: convert it, or {RETAKE}")
    if value.is_floating_point() and not value.isfinite().all():
        raise UserError(f"{path}: {name} is not finite: training went wrong; take an earlier checkpoint")
    if name.endswith("_codebook.initted") and not value.all():
        raise UserError(f"{path}: the codebook is empty ({name} is false): train the policy first")


def _same_tensors(policy: nn.Module) -> list[set[str]]:
    """Names of a policy's tensors; those that share one are saved once."""
    groups: dict[int, set[str]] = {}
    named = [*policy.named_parameters(remove_duplicate=False), *policy.named_buffers(remove_duplicate=False)]
    for name, tensor in named:
        groups.setdefault(id(tensor), set()).add(name)
    return list(groups.values())


def _listed(names: Iterable[str]) -> str:
    first, *more = sorted(names)
    return f"{first:.200}" + (", ..." if more else "")
