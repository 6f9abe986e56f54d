"""What the numbers of LOReL's states and actions mean; needs no simulator."""

import numpy as np

STATE_NAMES = (
    *(f"joint_{i}" for i in range(7)),
    "right_finger",
    "left_finger",
    "white_mug_x",
    "white_mug_y",
    "black_mug_x",
    "black_mug_y",
    "faucet",
    "drawer",
)
"""The 15 numbers: radians (arm, faucet) and metres (fingers, mugs, drawer)."""

ACTION_NAMES = ("x", "y", "z", "wrist", "gripper")
"""Move of the hand's target in units of 0.2 m, the ignored wrist, and the fingers (positive closes)."""

IGNORED_ACTIONS = ("wrist",)
"""Actions without effect: the simulator zeroes the wrist, though the data hold random values for it."""

ACTION_HIGH = (1.0, 1.0, 1.0, float(np.pi), 1.0)
"""Upper bounds of the actions; the lower ones are their negatives."""

WHITE_X, WHITE_Y, BLACK_X, BLACK_Y, FAUCET, DRAWER = range(9, 15)

FPS = 80
"""Steps per simulated second: an action lasts 12.5 ms."""

EPISODE_STEPS = 20
"""Length of an episode of the data and of every single task."""
