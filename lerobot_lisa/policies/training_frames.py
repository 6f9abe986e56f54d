"""Frames that a training step learns from: whole episodes or excerpts, under the policy's names and in its scale."""

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import NormalizerProcessorStep
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_lisa.episodes.features_on_disk import Looker
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.picture_transforms import PictureTransforms
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.backbones import FrozenBackbone
from lerobot_lisa.networks.excerpts import cut
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import Stats, make_normalizer, saved_step
from lerobot_lisa.policies.renaming import renamed_features
from lerobot_lisa.policies.shown_pictures import ShownPictures
from lerobot_lisa.policies.step_randomness import drawing_from

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata


class TrainingFrames:
    """The episode store as a policy sees it.

    This is no step of the preprocessor, which would rename and scale whole episodes as it does single frames: LeRobot
    rebuilds the preprocessor from JSON to resume and to fine-tune, and tells its steps nothing of the dataset that is
    trained on then. So names are found as the batch shows them renamed, and the scaling is the preprocessor's own step,
    made of the same statistics by the same function.

    Args:
        config: The policy's.
        stats: The dataset's statistics.
        dataset: None: there is nothing to train on.
        eyes: Looks at each picture once; None: the networks see the pictures.

    Attributes:
        store: None until a batch is asked for, which shows how features have been renamed.
        action_bounds: Least and greatest demonstrated action (2, A), normalised; a checkpoint brings its own.
    """

    def __init__(
        self,
        config: EpisodePolicyConfig,
        stats: Stats | None,
        dataset: "LeRobotDatasetMetadata | None",
        eyes: FrozenBackbone | None = None,
    ) -> None:
        self.config, self.dataset, self._eyes = config, dataset, eyes
        self._normalize = make_normalizer(config, stats)
        changes = dataset is not None and config.image_transforms.enable  # of no use to what only acts
        self._change = PictureTransforms(config.image_transforms) if changes else None
        self.store: EpisodeStore | None = None
        self.action_bounds = self._action_bounds(stats)

    def gather(
        self, batch: Mapping[str, Any], device: torch.device, reach: int, training: bool
    ) -> tuple[dict[str, Tensor], Packing]:
        """The episodes of a batch's frames, or excerpts of them.

        Args:
            batch: From LeRobot's loader and the policy's preprocessor.
            device: Where frames go.
            reach: How far before an excerpt can matter to it.
            training: Whether pictures are changed at random.

        Returns:
            Features of all N frames, each (N, *shape), actions (N, A), and where each episode lies among them.
        """
        store, index = self.episodes(batch, device), batch["index"].reshape(-1).cpu()
        if self.config.learned_steps:
            frames, packing = self._cut(store, index, reach, device)
        else:
            frames, packing = store.gather(store.holding(index), device)
        if training and self._change is not None:
            with drawing_from(batch, device, "pictures"):
                frames = self._change(frames, self._cameras, packing)
        return self._as_numbers(self.scaled(frames)), packing

    def parts(self, batch: Mapping[str, Any], device: torch.device) -> list[tuple[int, int, int]]:
        """What is learned from of each of a batch's frames: its episode, the part of it, and how long parts are."""
        store, index, learned = (
            self.episodes(batch, device),
            batch["index"].reshape(-1).cpu(),
            self.config.learned_steps,
        )
        episodes = store.holding(index)
        number = (index - store.starts[episodes]) // learned if learned else torch.zeros_like(index)
        return [(*pair, learned) for pair in zip(episodes.tolist(), number.tolist(), strict=True)]

    def _cut(
        self, store: EpisodeStore, index: Tensor, reach: int, device: torch.device
    ) -> tuple[dict[str, Tensor], Packing]:
        """The excerpts that hold frames (B,)."""
        episodes, config = store.holding(index), self.config
        starts, lengths = store.starts[episodes], store.lengths[episodes]
        packing = cut(lengths, index - starts, config.learned_steps, reach, config.look_stride, device)
        return store.frames(starts[packing.sequence_cpu] + packing.steps_cpu, device), packing

    @property
    def _cameras(self) -> list[str]:
        features = self.config.input_features or {}
        return [key for key, feature in features.items() if feature.type is FeatureType.VISUAL]

    def _as_numbers(self, frames: dict[str, Tensor]) -> dict[str, Tensor]:
        """Actions as (N, A)."""
        frames[ACTION] = frames[ACTION].reshape(len(frames[ACTION]), -1)
        return frames

    def scaled(self, frames: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What the preprocessor does to observations and actions in a rollout, done to stored ones.

        Pictures that nothing is done to stay bytes, a quarter of the memory, until an encoder makes numbers of them.
        """
        bytes_too = self.config.is_scaled(FeatureType.VISUAL)
        features = self.config.input_features or {}
        observations = {
            key: value if key in self._cameras and not bytes_too else _as_real(value, features.get(key))
            for key, value in frames.items()
            if key != ACTION
        }
        actions = frames[ACTION] if self.config.action_classes else frames[ACTION].float()
        scaled = self._normalize({TransitionKey.OBSERVATION: observations, TransitionKey.ACTION: actions})
        return {**scaled[TransitionKey.OBSERVATION], ACTION: scaled[TransitionKey.ACTION]}

    def episodes(self, batch: Mapping[str, Any], device: torch.device) -> EpisodeStore:
        """Every episode of the training dataset, read at first use; `device` is for `episode_store=device`."""
        if self.store is None:
            if self.dataset is None:
                kind = self.config.type
                raise UserError(
                    f"{kind} learns from whole episodes: build it with make_policy(cfg, ds_meta=dataset.meta)"
                )
            tell_apart = partial(self._tell_apart, self.dataset, batch)
            features = self.config.input_features or {}
            ours = renamed_features(features, self.dataset.features, batch, tell_apart)
            theirs = {name: key for key, name in ours.items()}
            keys = [*(theirs.get(key, key) for key in features), ACTION]
            self._say_unused(self.dataset, keys)
            location = self.config.episode_store
            store = load_episodes(self.dataset, keys, location, self.config.image_size, self._looker(device))
            store = store.renamed(ours)
            self.store = store.to(device) if location == "device" else store
        return self.store

    def _say_unused(self, dataset: "LeRobotDatasetMetadata", used: Sequence[str]) -> None:
        """A checkpoint that goes on looks at the cameras that it was trained with, whatever the dataset has besides."""
        unused = [key for key in dataset.camera_keys if key not in used]
        if unused and self.config.pretrained_path:
            logging.warning(
                "%s: the checkpoint was trained without %s and goes on without: only a new policy can use it",
                dataset.root,
                " and ".join(f"`{key}`" for key in unused),
            )

    def _looker(self, device: torch.device) -> Looker | None:
        if (eyes := self._eyes) is None:
            return None
        return Looker(lambda pictures: eyes(pictures.to(device)), eyes.shape, eyes.fingerprint())

    def settle_statistics(self, batch: Mapping[str, Any], device: torch.device) -> bool:
        """Scale as the preprocessor does: by the checkpoint's statistics if it resumes, by the dataset's otherwise.

        LeRobot does not tell a policy which of the two it does, but a batch shows it.

        Returns:
            Whether it is the dataset's.

        Raises:
            UserError: It is neither's.
        """
        stored = self.episodes(batch, device).frames(batch["index"].reshape(-1).cpu(), device)
        wrong = self._scaled_otherwise(batch, stored)
        if wrong is None:
            return True
        if self.config.pretrained_path:
            saved = saved_step(self.config, NormalizerProcessorStep).stats
            self._normalize = make_normalizer(self.config, saved)
            wrong = self._scaled_otherwise(batch, stored)
        if wrong is not None:
            raise UserError(
                f"the preprocessor scales `{wrong}` by other statistics than the dataset's and the checkpoint's: make "
                "it with make_pre_post_processors(cfg, dataset_stats=dataset.meta.stats)"
            )
        return False

    def _scaled_otherwise(self, batch: Mapping[str, Any], stored: Mapping[str, Tensor]) -> str | None:
        """A feature of a batch that was scaled in another way than stored ones of the same frames are."""
        frames, features = self._as_numbers(self.scaled(stored)), self.config.input_features or {}
        numbers = [key for key, feature in features.items() if feature.type is FeatureType.STATE]
        if stored[ACTION].is_floating_point():  # LeRobot scales others by statistics that it cuts to integers
            numbers.append(ACTION)
        for key in (key for key in numbers if key in batch):
            ours, theirs = frames[key].float(), batch[key].to(frames[key].device).float()
            if not torch.allclose(ours.flatten(), theirs.flatten(), rtol=1e-3, atol=1e-4, equal_nan=True):
                return key
        return None

    def _tell_apart(
        self, dataset: "LeRobotDatasetMetadata", batch: Mapping[str, Any], key: str, names: list[str]
    ) -> str | None:
        """Which of the dataset's features of one shape a batch has under the name `key`; None if it cannot be said."""
        stored = load_episodes(dataset, names, "memory", self.config.image_size).frames(batch["index"].cpu())
        feature = (self.config.input_features or {})[key]
        shown = _as_real(ShownPictures(self.config).as_trained(key, batch[key].cpu(), feature), feature).float()
        apart = {}
        for name in names:
            scaled = self._normalize({TransitionKey.OBSERVATION: {key: _as_real(stored[name], feature)}})
            apart[name] = (scaled[TransitionKey.OBSERVATION][key].cpu().float() - shown).abs().mean().item()
        nearest, second = sorted(names, key=lambda name: apart[name])[:2]
        return nearest if apart[nearest] < 0.5 * apart[second] else None

    def _action_bounds(self, stats: Stats | None) -> Tensor:
        size = self.config.action_feature.shape[0]
        if not stats or ACTION not in stats:
            return torch.tensor([[-1.0], [1.0]]).expand(2, size).clone()
        bounds = torch.stack([torch.as_tensor(stats[ACTION][name]).float().view(size) for name in ("min", "max")])
        return self.scaled({ACTION: bounds})[ACTION].cpu()


def _as_real(stored: Tensor, feature: PolicyFeature | None) -> Tensor:
    """Pictures wait in the store as bytes, rollouts and statistics have them in 0..1; integers may be numbers."""
    if feature is None or feature.type is FeatureType.ENV:
        return stored
    if feature.type is FeatureType.VISUAL and stored.dtype == torch.uint8:
        return stored.float() / 255
    return stored if stored.is_floating_point() else stored.float()
