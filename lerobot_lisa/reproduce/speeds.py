"""How long things take on two cores of an AMD EPYC, from the logs of published runs: what estimates are made of."""

from typing import NamedTuple

SECONDS_TO_START = 15.0  # LeRobot's imports, opening a dataset, loading a policy
SECONDS_FOR_A_MISSION = 0.01  # to draw one


class Speed(NamedTuple):
    """Of one world.

    Attributes:
        frames: Of a training episode, as often as `lerobot-train` draws it: long ones more often.
        demonstrations: Made in a second.
        training: Seconds for a frame of a batch.
        evaluation: Seconds for an episode, told its own instruction and told another one.
    """

    frames: float
    demonstrations: float
    training: float
    evaluation: float


SPEEDS = {
    "GoToLocal": Speed(7, 1200, 1.2e-4, 0.02),
    "GoTo": Speed(60, 100, 1.6e-4, 0.4),
    "GoToSeq": Speed(115, 46, 1.6e-4, 0.9),
    "SynthSeq": Speed(128, 31, 1.6e-4, 1.2),
    "BossLevel": Speed(141, 30, 1.6e-4, 1.5),
    "LOReL states": Speed(20, 75, 0.8e-4, 0.25),
    "LOReL images": Speed(20, 6.2, 4e-4, 0.4),
    "MT10 states": Speed(74, 0.77, 0.3e-4, 1.0),
    "MT10 images": Speed(99, 0.022, 5e-4, 40),
    "Meta-World images": Speed(80, 0.055, 1.5e-4, 40),
}
"""Measured 2026-11-24 and 25: docs/performance.md, docs/scale.md, docs/metaworld.md and the logs of the runs in
docs/results. Demonstrations of MT10 count for each of ten tasks; how long its evaluation takes is a guess. With
images all of it is one, from what drawing costs."""


class Cost(NamedTuple):
    """Of a policy, as a multiple of LISA's.

    Attributes:
        training: Of a frame.
        evaluation: Of an episode.
    """

    training: float = 1
    evaluation: float = 1


COSTS = {
    "babyai_rnn": Cost(8, 2.5),  # six convolutions over a grid of 22 x 22 cells
    "lorel_planner": Cost(0.5, 8),  # 200 imagined episodes for each action
}


def seconds_of_data(world: str, episodes: int) -> float:
    """To make a dataset."""
    return SECONDS_TO_START + episodes / _speed(world).demonstrations


def seconds_of_training(world: str, policy: str, steps: int, batch: int) -> float:
    """To train, with 30 ms of each step for what does not depend on frames."""
    speed, cost = _speed(world), COSTS.get(policy, Cost())
    return SECONDS_TO_START + steps * (0.03 + batch * speed.frames * speed.training * cost.training)


def seconds_of_evaluation(world: str, policy: str, episodes: int) -> float:
    """To run episodes told their own instruction and told another one."""
    return SECONDS_TO_START + episodes * _speed(world).evaluation * COSTS.get(policy, Cost()).evaluation


def shown(seconds: float) -> str:
    """Such as "40 s", "12 min", "3.5 h", "2.1 days"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 36 * 3600 else f"{seconds / 86400:.1f} days"


def _speed(world: str) -> Speed:
    return SPEEDS.get(world, SPEEDS["BossLevel"])
