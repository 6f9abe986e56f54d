"""Writes files in the original BabyAI format, as the packages of 2019 would have, for tests."""

import enum
import pickle
import sys
import types
from contextlib import contextmanager

import blosc
import numpy as np


@contextmanager
def gym_minigrid():
    """A stand-in for the package gym_minigrid, which the original actions belong to; yields its Actions."""
    module = types.ModuleType("gym_minigrid.minigrid")

    class MiniGridEnv:
        class Actions(enum.IntEnum):
            left = 0
            right = 1
            forward = 2
            pickup = 3
            drop = 4
            toggle = 5
            done = 6

            def __reduce_ex__(self, protocol):  # as enumerations of Python 3.6 did
                return (type(self), (self.value,))

    for cls, name in ((MiniGridEnv, "MiniGridEnv"), (MiniGridEnv.Actions, "MiniGridEnv.Actions")):
        cls.__module__, cls.__qualname__ = module.__name__, name
    module.MiniGridEnv = MiniGridEnv
    package = types.ModuleType("gym_minigrid")
    package.minigrid = module
    sys.modules.update({"gym_minigrid": package, "gym_minigrid.minigrid": module})
    try:
        yield MiniGridEnv.Actions
    finally:
        del sys.modules["gym_minigrid"], sys.modules["gym_minigrid.minigrid"]


def pack(images: np.ndarray, protocol: int = 4, payload: bytes | None = None) -> bytes:
    """blosc.pack_array with a choice of pickle protocol."""
    raw = pickle.dumps(images, protocol) if payload is None else payload
    return blosc.compress(raw, typesize=1, clevel=9)


def demo(length: int, seed: int = 0, mission: str = "go to the red ball", images: np.ndarray | None = None):
    """(mission, images, directions, actions); the images show a key away from walls, as minigrid encodes it."""
    rng = np.random.default_rng(seed)
    if images is None:
        images = np.zeros((length, 7, 7, 3), np.uint8)
        images[..., 0] = 1
        images[:, 2, 2] = (5, 1, 0)
        images[:, 4, 4, 0] = rng.integers(1, 3, length)
    return mission, images, rng.integers(0, 4, length).tolist(), rng.integers(0, 7, length).tolist()


def dump(demos, protocol: int = 4, actions=int, inner_protocol: int | None = None) -> bytes:
    """Bytes of an original file; `actions` turns an integer into what the file stores."""
    inner = protocol if inner_protocol is None else inner_protocol
    content = [(m, pack(i, inner), d, [actions(a) for a in acts]) for m, i, d, acts in demos]
    return pickle.dumps(content, protocol)
