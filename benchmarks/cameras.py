"""A training step on a robot's recordings (two cameras, long episodes) against LeRobot's policies, and acting.

Each figure is from a process of its own, since what a step has needed of memory at most never goes down again.
LeRobot's policies get pictures as its loader would hand them over, without the time for decoding them; ours are in the
episode store. multi_task_dit is there where `diffusers` is installed; VQ-BeT is not, since it takes one camera only.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.multi_task_dit.configuration_multi_task_dit import MultiTaskDiTConfig
from lerobot.policies.multi_task_dit.modeling_multi_task_dit import MultiTaskDiTPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS, OBS_STATE
from torch import Tensor
from transformers import CLIPVisionConfig, CLIPVisionModel

from benchmarks.measuring import Seconds, measure
from benchmarks.policies import CONFIGS, NAMES
from benchmarks.small_clip import save_small_clip
from benchmarks.table import Aim, Row
from lerobot_lisa.episodes.pictures import resized_shape
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.policies.base_modeling import EpisodePolicy
from lerobot_lisa.policies.dataset_features import learn_statistics
from lerobot_lisa.policies.lang_dt.modeling_lang_dt import LangDTPolicy
from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy

HEIGHT, WIDTH, JOINTS, BATCH_SIZE, FPS = 480, 640, 6, 8, 30
CAMERAS = ("observation.images.top", "observation.images.wrist")
LENGTHS = (100, 300, 1000)
STEPS = 300  # of acting
POLICIES = {"lisa": LisaPolicy, "lang_dt": LangDTPolicy}
FROZEN = {"vision_backbone": "resnet18", "freeze_vision_backbone": True, "image_size": 224}  # without weights
OURS = {**NAMES, **{f"{kind} frozen": f"{name}, a frozen ResNet-18's features kept" for kind, name in NAMES.items()}}
DIT = "multi_task_dit"
OTHERS = {"act": "ACT", DIT: f"{DIT} with CLIP ViT-B/16, four times a quarter of the batch"}


def rows(options: argparse.Namespace) -> list[Row]:
    others = {kind: _in_a_process(kind, 0, options) for kind in OTHERS if kind != DIT or find_spec("diffusers")}
    found = []
    for kind in OURS:
        ours = {length: _in_a_process(kind, length, options) for length in LENGTHS}
        found += [_against("act", kind, length, ours[length], others["act"]) for length in LENGTHS]
        found += [_against(DIT, kind, LENGTHS[-1], ours[LENGTHS[-1]], others[DIT])] if DIT in others else []
        found.append(_flat(kind, ours))
    return found + [_acting(kind, _in_a_process(kind, 0, options)) for kind in NAMES]


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


def _against(other: str, kind: str, length: int, ours: dict[str, float], theirs: dict[str, float]) -> Row:
    return Row(
        f"a step on {BATCH_SIZE} frames of two cameras, {HEIGHT} x {WIDTH}, {OURS[kind]}, episodes of {length}",
        OTHERS[other],
        Aim("at least", 1),
        theirs["cpu"] / ours["cpu"],
        theirs["wall"] / ours["wall"],
        f"{ours['cpu']:.3g} CPU-s, {ours['peak']:.3g} GB",
        f"{theirs['cpu']:.3g} CPU-s, {theirs['peak']:.3g} GB",
        {"its memory / ours": theirs["peak"] / ours["peak"]},
    )


def _flat(kind: str, ours: dict[int, dict[str, float]]) -> Row:
    # An episode of 100 steps is shorter than an excerpt with all that is before it.
    _, short, long = (ours[length] for length in LENGTHS)
    return Row(
        f"a step on episodes of {LENGTHS[2]} frames, {OURS[kind]}",
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
    kind, *frozen = kind.split()
    config = CONFIGS[kind](
        **_features(),
        **(FROZEN if frozen else {}),
        language_encoder="words",
        vocabulary=["put", "the", "cube", "into", "bowl"],
        action_classes=0,
        device="cpu",
        push_to_hub=False,
    )
    learn_statistics(config, None, length or 1000)
    numbers = {"min": -3, "max": 3, "mean": 0, "std": 1}
    stats = {key: {name: torch.full((JOINTS,), float(n)) for name, n in numbers.items()} for key in (OBS_STATE, ACTION)}
    policy: EpisodePolicy = POLICIES[kind](config, stats)
    return policy


def _store(length: int, seen: tuple[int, ...], dtype: torch.dtype) -> EpisodeStore:
    """Episodes whose pictures, or features of them, are random, of which the same hundred come again and again."""
    frames = BATCH_SIZE * length
    pictures = torch.randint(0, 256, (100, *seen)).to(dtype).repeat(frames // 100, *[1] * len(seen))
    joints = {key: torch.randn(frames, JOINTS) for key in (OBS_STATE, ACTION)}
    starts = torch.arange(BATCH_SIZE) * length
    return EpisodeStore({**joints, **dict.fromkeys(CAMERAS, pictures)}, starts, torch.full((BATCH_SIZE,), length))


def _store_for(policy: EpisodePolicy, length: int) -> EpisodeStore:
    if policy.eyes is not None:
        return _store(length, policy.eyes.shape, torch.float32)
    return _store(length, (3, *resized_shape(HEIGHT, WIDTH, policy.config.image_size)), torch.uint8)


def _words(rows: int) -> dict[str, Tensor]:
    words = torch.arange(2, 6).repeat(rows, 1)
    return {OBS_LANGUAGE_TOKENS: words, OBS_LANGUAGE_ATTENTION_MASK: torch.ones_like(words)}


def _train_ours(kind: str, length: int, repeats: int) -> dict[str, float]:
    policy = _policy(kind, length).train()
    policy.frames.store = _store_for(policy, length)
    return _train(policy, [{**_words(BATCH_SIZE), "index": index} for index in _drawn(length, repeats)])


def _drawn(length: int, repeats: int) -> list[Tensor]:
    """A frame of each episode for each step, together evenly from the beginning to the end, as the loader draws."""
    starts, places = torch.arange(BATCH_SIZE) * length, (torch.arange(BATCH_SIZE * repeats) + 0.5) / BATCH_SIZE
    return [starts + (places[step::repeats] * length / repeats).long() for step in range(repeats)]


def _train_act() -> dict[str, float]:
    config = ACTConfig(**_features(), pretrained_backbone_weights=None, device="cpu", push_to_hub=False)
    pictures = {key: torch.rand(BATCH_SIZE, 3, HEIGHT, WIDTH) for key in CAMERAS}
    actions = torch.randn(BATCH_SIZE, config.chunk_size, JOINTS)
    padding = torch.zeros(BATCH_SIZE, config.chunk_size, dtype=torch.bool)
    batch = {**pictures, OBS_STATE: torch.randn(BATCH_SIZE, JOINTS), ACTION: actions, "action_is_pad": padding}
    return _train(ACTPolicy(config).train(), [batch])


def _train_dit() -> dict[str, float]:
    """LeRobot's multi_task_dit with its own settings; CLIP has no trained weights, and a small half that reads.

    A quarter of the batch, since the whole one needs more than 10 GB; a whole one takes four times as long, and its
    memory is not known.
    """
    with TemporaryDirectory() as folder:
        save_small_clip(Path(folder) / "clip", ["put the cube into the bowl"])
        CLIPVisionModel(CLIPVisionConfig(patch_size=16)).save_pretrained(Path(folder) / "clip_vision")
        config = MultiTaskDiTConfig(
            **_features(),
            text_encoder_name=f"{folder}/clip",
            vision_encoder_name=f"{folder}/clip_vision",
            device="cpu",
            push_to_hub=False,
        )
        policy = MultiTaskDiTPolicy(config).train()
    rows = BATCH_SIZE // 4
    seen = (rows, config.n_obs_steps)
    pictures = {key: torch.rand(*seen, 3, HEIGHT, WIDTH) for key in CAMERAS}
    numbers = {OBS_STATE: torch.randn(*seen, JOINTS), ACTION: torch.randn(rows, config.horizon, JOINTS)}
    padding = torch.zeros(rows, config.horizon, dtype=torch.bool)
    figures = _train(policy, [{**_words(rows), **pictures, **numbers, "action_is_pad": padding}])
    return {"cpu": 4 * figures["cpu"], "wall": 4 * figures["wall"], "peak": figures["peak"]}


def _train(policy: PreTrainedPolicy, batches: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Means over the steps: they differ where episodes are cut in different places."""
    parameters = [parameter for parameter in policy.parameters() if parameter.requires_grad]
    before, optimizer = _peak(), torch.optim.Adam(parameters, 1e-4)

    def step(batch: dict[str, Any]) -> None:
        optimizer.zero_grad()
        policy.forward(batch)[0].backward()
        optimizer.step()

    step(batches[0])
    times = [measure(partial(step, batch)) for batch in batches]
    cpu, wall = (statistics.mean(clock) for clock in zip(*times, strict=True))
    return {"cpu": cpu, "wall": wall, "peak": _peak() - before}


def _act(kind: str) -> dict[str, float]:
    policy = _policy(kind, 0).eval()
    if kind == "lisa":
        policy.frames.store = _store_for(policy, 100)
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


def _measured(kind: str, length: int, repeats: int) -> dict[str, float]:
    if kind == "act":
        return _train_act()
    if kind == DIT:
        return _train_dit()
    return _train_ours(kind, length, repeats) if length else _act(kind)


if __name__ == "__main__":
    kind, length, repeats, threads = sys.argv[1], *map(int, sys.argv[2:])
    torch.set_num_threads(threads)
    print(json.dumps(_measured(kind, length, repeats)))
