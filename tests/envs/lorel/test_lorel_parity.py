"""Our tabletop does what the original did: its stored episodes replayed, its rates of events met."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.optimize import minimize

from lerobot_lisa.envs.lorel.labels import EVENTS, happened
from lerobot_lisa.envs.lorel.simulator import LorelSimulator
from lerobot_lisa.envs.lorel.state import ACTION_HIGH

SAMPLE = Path(__file__).parents[4] / "shared" / "data" / "lorel" / "data.hdf5"
MIDDLE = (0.0, 0.5)
"""One of the places that a reset leads the hand to; the first joint then stands at 1.296."""

# Of 1,100 random episodes of the original scene on MuJoCo 2.2.0.
RATES = {
    "close drawer": 0.319,
    "open drawer": 0.089,
    "turn faucet left": 0.278,
    "turn faucet right": 0.161,
    "move white mug down": 0.063,
    "move white mug up": 0.052,
    "move white mug left": 0.105,
    "move white mug right": 0.104,
    "move black mug down": 0.052,
    "move black mug up": 0.050,
    "move black mug left": 0.105,
    "move black mug right": 0.099,
    "nothing": 0.208,
}


def replay(
    simulator: LorelSimulator, state: np.ndarray, target: tuple[float, float], actions: np.ndarray
) -> np.ndarray:
    simulator.set_state(state, (*target, 0.07))
    states = [simulator.state]
    for action in actions:
        simulator.step(action)
        states.append(simulator.state)
    return np.array(states)


def hand(simulator: LorelSimulator, state: np.ndarray) -> np.ndarray:
    simulator.set_state(state)
    return simulator.hand


def target_of(simulator: LorelSimulator, states: np.ndarray, actions: np.ndarray) -> tuple[float, float]:
    """Where a reset had led the hand, which the files do not say: found from the first two steps of the arm."""
    if abs(states[0, 0] - 1.296) < 0.02:
        return MIDDLE

    def error(target: np.ndarray) -> float:
        return float(np.abs(replay(simulator, states[0], tuple(target), actions[:2]) - states[:3])[:, :7].sum())

    start = hand(simulator, states[0])[:2] - (0, -0.02)
    return tuple(minimize(error, start, method="Nelder-Mead", options={"maxfev": 40, "xatol": 1e-3}).x)


@pytest.mark.skipif(not SAMPLE.exists(), reason=f"no sample of the original data at {SAMPLE}")
def test_stored_episodes_replayed() -> None:
    with h5py.File(SAMPLE) as file:
        states, actions = file["sim/state"][:].astype(np.float64), file["sim/actions"][:]
    simulator = LorelSimulator()
    hands, objects, same = [], [], []
    for episode, moves in zip(states, actions, strict=True):
        ours = replay(simulator, episode[0], target_of(simulator, episode, moves), moves[:19])
        hands.append(np.linalg.norm(hand(simulator, ours[19]) - hand(simulator, episode[19])))
        objects.append(np.abs(ours[19, 9:] - episode[19, 9:]))
        events = set(happened(ours[0], ours[19])) ^ set(happened(episode[0], episode[19]))
        same.append(1 - len(events) / len(EVENTS))
    assert len(hands) == 20
    assert np.median(hands) < 0.005
    assert (np.median(objects, axis=0) < 0.01).all()
    assert np.mean(same) >= 0.95


@pytest.mark.slow
def test_events_are_as_frequent_as_in_the_original() -> None:
    simulator, high, episodes = LorelSimulator(), np.array(ACTION_HIGH), 300
    counts = dict.fromkeys(RATES, 0)
    for seed in range(episodes):
        rng = np.random.default_rng(seed)
        simulator.reset(rng)
        before = simulator.state
        for _ in range(19):
            simulator.step(rng.uniform(-high, high))
        for event in happened(before, simulator.state) or ("nothing",):
            counts[event] += 1
    for event, rate in RATES.items():
        error = np.sqrt(rate * (1 - rate) * (1 / episodes + 1 / 1100))
        assert abs(counts[event] / episodes - rate) < 3 * error, (event, counts[event] / episodes, rate)
