"""One episode of random play in our simulator, from a seed."""

import hashlib

import numpy as np

from dataset_converters.lorel.episode import LorelEpisode
from lerobot_lisa.envs.engine import mujoco
from lerobot_lisa.envs.lorel.labels import describe
from lerobot_lisa.envs.lorel.scene import build_model, engine
from lerobot_lisa.envs.lorel.simulator import LorelSimulator
from lerobot_lisa.envs.lorel.state import ACTION_HIGH, EPISODE_STEPS


def play(simulator: LorelSimulator, seed: int) -> LorelEpisode:
    """Reset, act at random for one episode, and describe what happened.

    As in the original data, frame t holds the state before action t, and the label compares the first with the last
    stored state (docs/datasets.md).

    Args:
        simulator: it is reset.
        seed: of the reset, of the actions and of the order of the label's parts.

    Returns:
        An episode without images; what is stored is exactly what was simulated, labelled and executed.
    """
    resets, actions, words = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(3))
    high = np.array(ACTION_HIGH)
    action = actions.uniform(-high, high, (EPISODE_STEPS, len(high))).astype(np.float32)
    state = np.empty((EPISODE_STEPS, simulator.model.nq), np.float32)
    simulator.reset(resets)
    for t in range(EPISODE_STEPS):
        state[t] = simulator.state
        simulator.step(action[t])
    return LorelEpisode(describe(state[0], state[-1], words), state, action, seed=seed, engine=engine())


def scene_digest(arm: str) -> str:
    """Tell scenes apart, so that no collection goes on with the shards of another world."""
    model = build_model(arm)
    compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, compiled)
    return hashlib.sha256(compiled).hexdigest()
