"""A training step on a robot's recordings (two cameras, long episodes) against ACT's, and how long acting takes.

Each figure is from a process of its own, since what a step has needed of memory at most never goes down again. ACT gets
pictures as its loader would hand them over, without the time for decoding them; ours are in the episode store.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS, OBS_STATE
from torch import Tensor

from benchmarks.measuring import Seconds, measure, middle
from benchmarks.policies import CONFIGS, NAMES
from benchmarks.table import Aim, Row
from lerobot_lisa.episodes.pictures import resized_shape
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.policies.base_modeling import EpisodePolicy
from lerobot_lisa.policies.lang_dt.modeling_lang_dt import LangDTPolicy
from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy

HEIGHT, WIDTH, JOINTS, BATCH_SIZE, FPS = 480, 640, 6, 8, 30
CAMERAS = ("observation.images.top", "observation.images.wrist")
LENGTHS = (100, 300, 1000)
STEPS = 300  # of acting
POLICIES = {"lisa": LisaPolicy, "lang_dt": LangDTPolicy}


def rows(options: argparse.Namespace) -> list[Row]:
    act = _in_a_process("act", 0, options)
    found = []
    for kind in NAMES:
        ours = {length: _in_a_process(kind, length, options) for length in LENGTHS}
        found += [_against_act(kind, length, ours[length], act) for length in LENGTHS]
        found += [_flat(kind, ours), _acting(kind, _in_a_process(kind, 0, options))]
    return found


def _in_a_process(kind: str, length: int, options: argparse.Namespace) -> dict[str, float]:
    command = [
        sys.executable,
        "-m",
        "benchmarks.cameras",
        kind,
        str(length),
        str(options.repeats),
        str(options.threads),
    ]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def _against_act(kind: str, length: int, ours: dict[str, float], act: dict[str, float]) -> Row:
    return Row(
        f"a step on {BATCH_SIZE} frames of two cameras, {HEIGHT} x {WIDTH}, {NAMES[kind]}, episodes of {length}",
        "ACT",
        Aim("at least", 1),
        act["cpu"] / ours["cpu"],
        act["wall"] / ours["wall"],
        f"{ours['cpu']:.3g} CPU-s, {ours['peak']:.3g} GB",
        f"{act['cpu']:.3g} CPU-s, {act['peak']:.3g} GB",
        {"ACT's memory / ours": act["peak"] / ours["peak"]},
    )


def _flat(kind: str, ours: dict[int, dict[str, float]]) -> Row:
    # An episode of 100 steps is shorter than an excerpt with all that is before it.
    _, short, long = (ours[length] for length in LENGTHS)
    return Row(
        f"a step on episodes of {LENGTHS[2]} frames, {NAMES[kind]}",
        f"of {LENGTHS[1]}",
        Aim("at most", 1.1),
        long["cpu"] / short["cpu"],
        long["wall"] / short["wall"],
        f"{long['cpu']:.3g} CPU-s, {long['peak']:.3g} GB",
        f"{short['cpu']:.3g} CPU-s, {short['peak']:.3g} GB",
    )


def _acting(kind: str, ours: dict[str, float]) -> Row:
    return Row(
        f"`select_action` with two cameras, {HEIGHT} x {WIDTH}, 99th percentile, {NAMES[kind]}",
        "",
        Aim("at most", 1000 / FPS, "ms"),
        1e3 * ours["cpu"],
        1e3 * ours["wall"],
        f"median {1e3 * ours['median']:.3g} ms",
    )


# What is measured, in a process of its own.


def _features() -> dict[str, Any]:
    pictures = {key: PolicyFeature(FeatureType.VISUAL, (3, HEIGHT, WIDTH)) for key in CAMERAS}
    return {
        "input_features": {OBS_STATE: PolicyFeature(FeatureType.STATE, (JOINTS,)), **pictures},
        "output_features": {ACTION: PolicyFeature(FeatureType.ACTION, (JOINTS,))},
    }


def _policy(kind: str, length: int) -> EpisodePolicy:
    config = CONFIGS[kind](
        **_features(),
        language_encoder="words",
        vocabulary=["put", "the", "cube", "into", "bowl"],
        action_classes=0,
        device="cpu",
        push_to_hub=False,
    )
    config.set_dataset_statistics(None, length or 1000)
    numbers = {"min": -3, "max": 3, "mean": 0, "std": 1}
    stats = {key: {name: torch.full((JOINTS,), float(n)) for name, n in numbers.items()} for key in (OBS_STATE, ACTION)}
    policy: EpisodePolicy = POLICIES[kind](config, stats)
    return policy


def _store(length: int, size: int | None) -> EpisodeStore:
    """Episodes whose pictures are random, of which the same hundred come again and again."""
    frames, shape = BATCH_SIZE * length, (3, *resized_shape(HEIGHT, WIDTH, size))
    pictures = torch.randint(0, 256, (100, *shape), dtype=torch.uint8).repeat(frames // 100, 1, 1, 1)
    joints = {key: torch.randn(frames, JOINTS) for key in (OBS_STATE, ACTION)}
    starts = torch.arange(BATCH_SIZE) * length
    return EpisodeStore({**joints, **dict.fromkeys(CAMERAS, pictures)}, starts, torch.full((BATCH_SIZE,), length))


def _words(rows: int) -> dict[str, Tensor]:
    words = torch.arange(2, 6).repeat(rows, 1)
    return {OBS_LANGUAGE_TOKENS: words, OBS_LANGUAGE_ATTENTION_MASK: torch.ones_like(words)}


def _train_ours(kind: str, length: int, repeats: int) -> dict[str, float]:
    policy = _policy(kind, length).train()
    policy.frames.store = _store(length, policy.config.image_size)
    middles = torch.arange(BATCH_SIZE) * length + length // 2
    return _train(policy, {**_words(BATCH_SIZE), "index": middles}, repeats)


def _train_act(repeats: int) -> dict[str, float]:
    config = ACTConfig(**_features(), pretrained_backbone_weights=None, device="cpu", push_to_hub=False)
    pictures = {key: torch.rand(BATCH_SIZE, 3, HEIGHT, WIDTH) for key in CAMERAS}
    actions = torch.randn(BATCH_SIZE, config.chunk_size, JOINTS)
    padding = torch.zeros(BATCH_SIZE, config.chunk_size, dtype=torch.bool)
    batch = {**pictures, OBS_STATE: torch.randn(BATCH_SIZE, JOINTS), ACTION: actions, "action_is_pad": padding}
    return _train(ACTPolicy(config).train(), batch, repeats)


def _train(policy: PreTrainedPolicy, batch: dict[str, Any], repeats: int) -> dict[str, float]:
    before, optimizer = _peak(), torch.optim.Adam(policy.parameters(), 1e-4)

    def step() -> None:
        optimizer.zero_grad()
        policy.forward(batch)[0].backward()
        optimizer.step()

    step()
    times = middle([measure(step) for _ in range(repeats)])
    return {"cpu": times.cpu, "wall": times.wall, "peak": _peak() - before}


def _act(kind: str) -> dict[str, float]:
    policy = _policy(kind, 0).eval()
    if kind == "lisa":
        policy.frames.store = _store(100, policy.config.image_size)
        policy.train().forward({**_words(BATCH_SIZE), "index": torch.arange(BATCH_SIZE) * 100})  # places the codes
    picture, times = torch.rand(1, 3, HEIGHT, WIDTH), []
    for _ in range(STEPS):
        shown = {**_words(1), OBS_STATE: torch.randn(1, JOINTS), **{key: picture.clone() for key in CAMERAS}}
        start = Seconds.now()
        policy.select_action(shown)
        times.append(Seconds.now().since(start))
    worst = [statistics.quantiles(clock, n=100)[98] for clock in zip(*times, strict=True)]
    return {"cpu": worst[0], "wall": worst[1], "median": statistics.median(time.wall for time in times)}


def _peak() -> float:
    """The most memory that this process has had, in GB."""
    unit = 1e9 if sys.platform == "darwin" else 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


if __name__ == "__main__":
    kind, length, repeats, threads = sys.argv[1], *map(int, sys.argv[2:])
    torch.set_num_threads(threads)
    figures = _train_act(repeats) if kind == "act" else _train_ours(kind, length, repeats) if length else _act(kind)
    print(json.dumps(figures))
