"""The hidden layers that several networks have in common."""

from torch import nn


def hidden_layers(inputs: int, width: int, dropout: float) -> nn.Sequential:
    """Two of them: (N, inputs) -> (N, width)."""
    first = [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*first, nn.Linear(width, width), nn.ReLU(), nn.Dropout(dropout))
