"""Numbers about skill codes that the training log shows: information, perplexity, codes in use."""

import torch
from torch import Tensor


def mutual_information(distances: Tensor) -> Tensor:
    """Mutual information in bits between instructions and skill codes, as the paper's listing defines it.

    p(z | l) = softmax(-distance / 2); the result is H(mean p) - mean H(p).

    Args:
        distances: Squared distances (N, K) of N embeddings to K codes.
    """
    conditional = torch.softmax(-distances / 2, dim=-1)
    return _entropy(conditional.mean(0)) - _entropy(conditional).mean()


def perplexity(codes: Tensor, size: int) -> Tensor:
    """How many codes are in effective use: 2 to the entropy of their frequencies, between 1 and `size`."""
    return 2 ** _entropy(_counts(codes, size) / max(1, len(codes)))


def codes_used(codes: Tensor, size: int) -> Tensor:
    """How many different codes occur."""
    return (_counts(codes, size) > 0).sum()


def _counts(codes: Tensor, size: int) -> Tensor:
    """(K,) how often each code occurs; `bincount` and `unique` would make a GPU's host wait."""
    return torch.zeros(size, device=codes.device).index_add(0, codes, torch.ones(len(codes), device=codes.device))


def _entropy(probabilities: Tensor) -> Tensor:
    """In bits, over the last dimension; 0 log 0 is 0, which `xlogy` knows."""
    return -torch.special.xlogy(probabilities, probabilities).sum(-1) / torch.log(torch.tensor(2.0))
