"""What a policy learns of a dataset before it is trained: how long episodes are, which words and phrases are said."""

import logging
from typing import TYPE_CHECKING, Any

import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_lisa.episodes.check import check_metadata
from lerobot_lisa.episodes.runs import task_runs
from lerobot_lisa.episodes.symmetries import symmetry_words
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import (
    InstructionStep,
    build_vocabulary,
    make_tokenizer,
    plain_ids,
    saved_step,
    split_words,
)
from lerobot_lisa.policies.dataset_features import learn_statistics
from lerobot_lisa.policies.episode_settings import WORDS
from lerobot_lisa.policies.lexicon import said_phrases, symbol_words
from lerobot_lisa.policies.parts import named_symbols

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata


def learn_about(config: EpisodePolicyConfig, meta: "LeRobotDatasetMetadata") -> None:
    """Note in a configuration what LeRobot's hook for features has not been told.

    A checkpoint that goes on with a dataset, the same or another, keeps what it knows and learns the rest.

    Raises:
        UserError: The dataset is broken, or does not fit what the configuration says.
    """
    _check_features(config, meta)
    named = (*(config.input_features or {}), ACTION)  # `--rename_map` gives some other names than the dataset's
    check_metadata(meta, [key for key in named if key in meta.features])
    longest, goes_on = int(task_runs(meta).lengths.max()), bool(config.pretrained_path)
    _keep_still(meta.stats or {}, [key for key in named if key not in meta.camera_keys])
    learn_statistics(config, meta.stats, longest)
    if goes_on:
        _learn_picture_sizes(config, meta)
    if goes_on and config.max_timesteps is not None:
        config.max_timesteps = max(config.max_timesteps, longest)
    tasks = [str(task) for task in meta.tasks.index]
    if any(not task.strip() for task in tasks):
        logging.warning("%s: an instruction is blank: its episodes are learned from without words", meta.root)
    if config.language_encoder == WORDS and (goes_on or not config.vocabulary):
        _learn_words(config, tasks)
    if goes_on or not config.lexicon:
        _learn_phrases(config, tasks, symmetry_words(meta.features))


def _check_features(config: EpisodePolicyConfig, meta: "LeRobotDatasetMetadata") -> None:
    """Those of a checkpoint, or chosen by hand, may be others than the dataset has under the same names."""
    theirs = dataset_to_policy_features(meta.features)
    for key, feature in (config.input_features or {}).items():
        if meta.features.get(key, {}).get("dtype") == "string":
            raise UserError(f"`{key}` is text, which no policy here sees: leave it out of --policy.input_features")
        if key not in theirs:
            continue
        ours, given = tuple(feature.shape), tuple(theirs[key].shape)
        if feature.type is FeatureType.VISUAL:
            ours, given = ours[:1], given[:1]  # a camera may have other pixels, but no other colors
        if ours != given:
            raise UserError(
                f"`{key}` has shape {given} in {meta.root}, but the policy takes {ours}: take recordings of the same "
                "kind, or train a new policy, without --policy.path"
            )


def _keep_still(stats: dict[str, dict[str, Any]], keys: list[str]) -> None:
    """Give numbers that never change the deviation 1, where everybody finds it who scales by the dataset's statistics.

    Theirs is 0, or a rounding error: a joint that nobody moved would count a million times as much as any other as soon
    as it trembles.
    """
    for numbers in (stats[key] for key in keys if {"min", "max", "std"} <= stats.get(key, {}).keys()):
        still = np.asarray(numbers["min"]) == np.asarray(numbers["max"])
        numbers["std"] = np.where(still, 1.0, np.asarray(numbers["std"]))


def _learn_picture_sizes(config: EpisodePolicyConfig, meta: "LeRobotDatasetMetadata") -> None:
    """Those of the cameras that it is trained on now: rollouts show pictures as large as in training."""
    features, theirs = config.input_features or {}, dataset_to_policy_features(meta.features)
    for key in set(meta.camera_keys) & features.keys():
        features[key] = PolicyFeature(FeatureType.VISUAL, tuple(theirs[key].shape))


def _learn_words(config: EpisodePolicyConfig, tasks: list[str]) -> None:
    """Known words keep their numbers."""
    new = sorted(set(build_vocabulary(tasks)) - set(config.vocabulary))
    config.vocabulary = [*config.vocabulary, *new]
    logging.info("%s: vocabulary of %d words, %d of them new", config.type, len(config.vocabulary), len(new))


def _learn_phrases(config: EpisodePolicyConfig, tasks: list[str], symmetric: list[str]) -> None:
    """A pretrained encoder's tokenizer comes from the checkpoint, if there is one: its folder may be gone."""
    symbols = [spoken for spoken in named_symbols(config).values() if spoken]
    names = [word for spoken in symbols for word in symbol_words(spoken)] + symmetric
    new = [text for text in said_phrases(map(split_words, tasks), names) if text not in config.lexicon]
    if new:
        kept = config.pretrained_path and config.language_encoder != WORDS
        tokenizer = saved_step(config, InstructionStep).tokenizer if kept else make_tokenizer(config)
        config.lexicon = {**config.lexicon, **{text: plain_ids(tokenizer, text) for text in new}}
