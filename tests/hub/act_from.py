"""Run by a test in its own process: load policies as a user's script would, and print their actions."""

import json
import sys

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_lisa  # noqa: F401  registers the policies


def actions(name: str) -> list[float]:
    """What a policy does in its first five steps of two episodes."""
    config = PreTrainedConfig.from_pretrained(name)
    policy = get_policy_class(config.type).from_pretrained(name)
    preprocess, postprocess = make_pre_post_processors(policy.config, pretrained_path=name)
    generator = torch.Generator().manual_seed(0)
    taken = []
    for _ in range(5):
        frame = {
            "observation.grid": torch.randint(0, 11, (2, 147), generator=generator).float(),
            "observation.direction": torch.randint(0, 4, (2, 1), generator=generator).float(),
            "task": ["go to the red ball", "open a door"],
        }
        taken += postprocess(policy.select_action(preprocess(frame))).flatten().tolist()
    return taken


print(json.dumps([actions(name) for name in sys.argv[1:]]))
