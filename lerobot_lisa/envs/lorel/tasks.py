"""What a LOReL task is: an instruction, the events that fulfil it, and how its episodes start."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from lerobot_lisa.envs.lorel.labels import EVENTS
from lerobot_lisa.envs.lorel.state import BLACK_X, BLACK_Y, DRAWER, EPISODE_STEPS, FAUCET, WHITE_X, WHITE_Y

Bounds = tuple[float, float]

COMPOSITION_STEPS = 40

_TURN: Mapping[int, Bounds] = {FAUCET: (-np.pi / 5, np.pi / 5)}
_PLACEMENTS: tuple[tuple[str, Mapping[int, Bounds]], ...] = (
    ("open drawer", {DRAWER: (-0.05, 0.0)}),
    ("close drawer", {DRAWER: (-0.15, -0.05)}),
    ("turn faucet", _TURN),
    ("move black mug", {BLACK_X: (-0.25, -0.15), BLACK_Y: (0.6, 0.7)}),
    ("move white mug", {WHITE_X: (-0.25, -0.15), WHITE_Y: (0.6, 0.7)}),
)
_AT_THE_MUGS, _AT_THE_EDGE = (-0.1, 0.55, 0.1), (0.0, 0.45, 0.1)


@dataclass(frozen=True)
class Task:
    """A task.

    Attributes:
        instruction: What the policy is told.
        parts: The events, names from `EVENTS`, that it asks for.
        kind: Which sort of instruction it is: seen, unseen verb, unseen noun, unseen verb+noun, human or composition.
        steps: Steps after which an episode is cut.
        released_tests: Events that are tested instead of `parts`; empty: those are tested.
    """

    instruction: str
    parts: tuple[str, ...]
    kind: str = "seen"
    steps: int = EPISODE_STEPS
    released_tests: tuple[str, ...] = ()

    @property
    def tests(self) -> tuple[str, ...]:
        """The events that must all have happened at the same step."""
        return self.released_tests or self.parts

    def succeeded(self, before: np.ndarray, after: np.ndarray) -> bool:
        """Whether everything has happened between the first state of an episode and this one, (15,) each."""
        return all(EVENTS[name].happened(before, after) for name in self.tests)

    @property
    def placement(self) -> Mapping[int, Bounds]:
        """Bounds of the coordinates that an episode starts from: those of all parts."""
        chosen = [bounds for part in self.parts for prefix, bounds in _PLACEMENTS if part.startswith(prefix)]
        return MappingProxyType({index: limits for bounds in chosen for index, limits in bounds.items()})

    @property
    def hand_target(self) -> tuple[float, float, float]:
        """Where the hand is led before the episode, in metres."""
        return _AT_THE_MUGS if any("mug" in part for part in self.parts) else _AT_THE_EDGE
