"""What both policies share of LeRobot's protocol: whole episodes in training, a history in rollouts, model cards."""

import logging
from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import torch
from huggingface_hub import ModelCard
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import NormalizerProcessorStep
from lerobot.utils.constants import ACTION, OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS, OBS_PREFIX
from torch import Tensor

from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import KEY, check_feature_info
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.policies.base_configuration import WORDS, EpisodePolicyConfig
from lerobot_lisa.policies.instructions import build_vocabulary
from lerobot_lisa.policies.model_card import make_model_card
from lerobot_lisa.policies.renaming import renamed_features
from lerobot_lisa.policies.step_randomness import StepRandomness

if TYPE_CHECKING:
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

Metrics = dict[str, Tensor]  # scalars, on the device until all are read at once


class EpisodePolicy(PreTrainedPolicy):
    """Base of the policies that learn from whole episodes.

    `lerobot-train` hands `forward` single frames. Their episode indices choose whole episodes in the episode store, so
    what a frame contributes is its episode, and an episode is drawn in proportion to its length. The loss averages over
    each episode's frames first, which gives every frame of the dataset the same weight, as in the paper.

    Attributes:
        rollouts: Rollouts begun since training or loading; the next one draws its actions from `action_seed` plus this.
    """

    config_class = EpisodePolicyConfig
    name = "episode_policy"
    network: EpisodeNetwork

    def __init__(
        self,
        config: EpisodePolicyConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: "LeRobotDatasetMetadata | None" = None,
        **_: Any,
    ) -> None:
        """Build the policy; `dataset_meta` is needed for training only.

        Raises:
            UserError: The configuration is another policy's, its features cannot work, or the language encoder is not
                there.
        """
        if config.type != self.name:
            raise UserError(
                f"{type(self).__name__} cannot load a {config.type} policy (its config.json says so): "
                f"choose a {self.name} checkpoint, or let --policy.path alone find the policy"
            )
        if dataset_meta is not None:
            _learn_about(config, dataset_meta)
        config.validate_features()
        super().__init__(config)
        self.config: EpisodePolicyConfig = config
        self._normalize = _normalizer(config, dataset_stats)
        self.network = self.make_network(self._action_bounds(dataset_stats))
        self.randomness = StepRandomness()
        config.pretrained_backbone_weights = None  # from here on the checkpoint brings them, without a download
        self._dataset = dataset_meta
        self._store: EpisodeStore | None = None
        self._renamed: dict[str, str] = {}  # the dataset's name to the policy's
        self._history: Any = None
        self._instruction: Tensor | None = None
        self.rollouts = 0
        self._generator = torch.Generator()

    # What a policy fills in.

    @abstractmethod
    def make_network(self, action_bounds: Tensor) -> EpisodeNetwork:
        """The method itself, of the configured size; real-valued actions lie within `action_bounds` (2, A)."""

    @abstractmethod
    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions for all N frames, what else enters the loss (a scalar), and numbers worth logging."""

    # Training.

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Loss of the whole episodes that a batch's frames belong to.

        Args:
            batch: From LeRobot's loader and this policy's preprocessor. Read are `episode_index` (B,),
                `observation.language.tokens` (B, M) and `observation.language.attention_mask` (B, M).
            reduction: "mean", or "none" for one loss per frame of the batch, (B,).

        Returns:
            The loss and numbers for the training log.

        Raises:
            UserError: The policy was built without a dataset.
        """
        self.rollouts = 0  # so that evaluation in training draws what `lerobot-eval` of the checkpoint will
        self._note_renamed_features(batch)
        frames, packing = self.episode_store.gather(batch["episode_index"], self._device)
        frames = self._scaled(frames)
        actions = frames.pop(ACTION).reshape(packing.total, -1)
        tokens, tokens_valid = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK].bool()
        with self.randomness.next_step():
            outputs, extra_loss, metrics = self.predict(tokens, tokens_valid, frames, actions, packing)
        head = self.network.head
        action_loss = packing.mean(head.loss(outputs, actions))  # (B,)
        metrics = {**metrics, "action_loss": action_loss.mean(), **head.metrics(outputs.detach(), actions)}
        loss = action_loss if reduction == "none" else action_loss.mean()
        return loss + extra_loss, _numbers(metrics)

    @property
    def episode_store(self) -> EpisodeStore:
        """Every episode of the training dataset, read at first use."""
        if self._store is None:
            if self._dataset is None:
                raise UserError(
                    f"{self.name} learns from whole episodes: build it with make_policy(cfg, ds_meta=dataset.meta)"
                )
            location = self.config.episode_store
            theirs = {ours: name for name, ours in self._renamed.items()}
            keys = [*(theirs.get(key, key) for key in self.config.input_features), ACTION]
            store = load_episodes(self._dataset, keys, location).renamed(self._renamed)
            self._store = store.to(self._device) if location == "device" else store
        return self._store

    def _note_renamed_features(self, batch: dict[str, Any]) -> None:
        if self._store is None and self._dataset is not None:
            self._renamed = renamed_features(self.config.input_features, self._dataset.features, batch)

    def _scaled(self, frames: dict[str, Tensor]) -> dict[str, Tensor]:
        """What the preprocessor does to observations and actions in a rollout, done to stored ones."""
        observations = {key: _unit_range(value, self.config.input_features.get(key)) for key, value in frames.items()}
        del observations[ACTION]
        scaled = self._normalize({TransitionKey.OBSERVATION: observations, TransitionKey.ACTION: frames[ACTION]})
        return {**scaled[TransitionKey.OBSERVATION], ACTION: scaled[TransitionKey.ACTION]}

    def _action_bounds(self, stats: dict[str, dict[str, Any]] | None) -> Tensor:
        """Least and greatest demonstrated action (2, A), normalised; a checkpoint brings its own."""
        size = self.config.action_feature.shape[0]
        if not stats or ACTION not in stats:
            return torch.tensor([[-1.0], [1.0]]).expand(2, size).clone()
        bounds = torch.stack([torch.as_tensor(stats[ACTION][name]).float().view(size) for name in ("min", "max")])
        return self._normalize({TransitionKey.OBSERVATION: {}, TransitionKey.ACTION: bounds})[
            TransitionKey.ACTION
        ].cpu()

    @property
    def _device(self) -> torch.device:
        return next(self.parameters()).device

    # Rollouts.

    def reset(self) -> None:
        """Forget the rollout: the next observation is an episode's first."""
        self._history, self._instruction = None, None

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **_: Any) -> Tensor:
        """One action for each of B environments that were reset together.

        Another instruction than the step before starts a new episode.

        Args:
            batch: From this policy's preprocessor: observation features (B, *shape) and instruction tokens (B, M).

        Returns:
            Actions (B, A); categorical ones as class numbers (B, 1).
        """
        self.action_outputs(batch)
        return self._history.actions

    @torch.no_grad()
    def action_outputs(self, batch: dict[str, Any]) -> Tensor:
        """Advance the rollout by one step; returns what actions are picked from: logits (B, classes) or means."""
        self.eval()
        tokens, valid = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK].bool()
        if self._history is None or self._instruction is None or not torch.equal(tokens, self._instruction):
            self._check_world(batch)
            self._begin(tokens, valid)
        observations = {key: batch[key] for key in self.config.input_features}
        outputs = self.network.act(self._history, observations)
        self._history.actions = self.network.head.pick(outputs, self._generator)
        return outputs

    def _check_world(self, batch: dict[str, Any]) -> None:
        """Raise `UserError` if an environment does not show what the policy was trained on."""
        missing = [key for key in self.config.input_features if key not in batch]
        if missing:
            shown = ", ".join(sorted(key for key in batch if key.startswith(OBS_PREFIX) and "language" not in key))
            raise UserError(
                f"the policy was trained on {', '.join(missing)}, but the environment shows {shown or 'nothing'}: "
                "choose what it shows (LOReL: --env.obs_type=state, pixels or pixels_state)"
            )
        told = (batch.get(TransitionKey.INFO.value) or {}).get(KEY, {})
        check_feature_info(self.config.feature_info or {}, told)

    def _begin(self, tokens: Tensor, valid: Tensor) -> None:
        """Start a rollout; what it draws depends on how many came before it, not on what else used random numbers."""
        self._history, self._instruction = self.network.begin(tokens, valid), tokens
        self._generator = torch.Generator(tokens.device).manual_seed(self.config.action_seed + self.rollouts)
        self.rollouts += 1

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Actions (B, 1, A): both policies look at every observation, so a chunk is one action long."""
        return self.select_action(batch, **kwargs)[:, None]

    # Hub.

    def generate_model_card(
        self,
        dataset_repo_id: str,
        model_type: str,
        license: str | None,
        tags: list[str] | None,
        cfg: "TrainPipelineConfig | None" = None,
        dataset_meta: "LeRobotDatasetMetadata | None" = None,
    ) -> ModelCard:
        """A card that names the paper and the licence; LeRobot's own would list every instruction."""
        return make_model_card(self.config, dataset_repo_id, license, tags, cfg, dataset_meta)


def _learn_about(config: EpisodePolicyConfig, meta: "LeRobotDatasetMetadata") -> None:
    starts, stops = (meta.episodes[f"dataset_{end}_index"][:] for end in ("from", "to"))
    config.describe_dataset(meta.features, meta.stats, max(b - a for a, b in zip(starts, stops, strict=True)))
    if config.language_encoder == WORDS and not config.vocabulary:
        config.vocabulary = build_vocabulary(str(task) for task in meta.tasks.index)
        logging.info("%s: vocabulary of %d words", config.type, len(config.vocabulary))


def _numbers(metrics: Metrics) -> dict[str, float]:
    """Scalars as numbers: one wait for the device, not one for each."""
    values = torch.stack([value.detach().float() for value in metrics.values()]).tolist()
    return dict(zip(metrics, values, strict=True))


def _unit_range(stored: Tensor, feature: PolicyFeature | None) -> Tensor:
    """Pictures wait in the store as bytes; rollouts and statistics have them in 0..1."""
    if feature is None or feature.type is not FeatureType.VISUAL:
        return stored
    return stored.float() / 255 if stored.dtype == torch.uint8 else stored


def _normalizer(config: EpisodePolicyConfig, stats: dict[str, dict[str, Any]] | None) -> NormalizerProcessorStep:
    features = {**(config.input_features or {}), **(config.output_features or {})}
    return NormalizerProcessorStep(features=features, norm_map=config.normalization_mapping, stats=stats)
