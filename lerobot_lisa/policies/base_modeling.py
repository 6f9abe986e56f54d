"""What both policies share of LeRobot's protocol: whole episodes in training, a history in rollouts, weights, cards."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from huggingface_hub import ModelCard
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_PREFIX
from safetensors import SafetensorError
from safetensors.torch import load_model
from torch import Tensor

from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.episodes.symmetries import Symmetries, Told
from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import KEY, check_feature_info
from lerobot_lisa.networks.backbones import Backbone, FrozenBackbone
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.real_actions import RealHead
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import Stats
from lerobot_lisa.policies.dataset_knowledge import learn_about
from lerobot_lisa.policies.fine_tuning import at_saved_size
from lerobot_lisa.policies.instructions import InstructionReader, given_tokens, told_apart_by
from lerobot_lisa.policies.known_losses import KnownLosses, Losses, rows_of, state_of
from lerobot_lisa.policies.model_card import make_model_card
from lerobot_lisa.policies.shown_pictures import ShownPictures
from lerobot_lisa.policies.step_randomness import drawing_from
from lerobot_lisa.policies.training_frames import TrainingFrames
from lerobot_lisa.policies.vision import make_backbone

if TYPE_CHECKING:
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

Metrics = dict[str, Tensor]  # scalars, on the device until all are read at once


class EpisodePolicy(PreTrainedPolicy):
    """Base of the policies that learn from whole episodes, or from parts of them (`excerpt_steps`).

    `lerobot-train` hands `forward` single frames. They choose episodes in the episode store, so what a frame
    contributes is its episode, or the part of it that holds the frame, and each is drawn in proportion to its length.
    The loss averages over its frames first, which gives every frame of the dataset the same weight, as in the paper.

    Attributes:
        rollouts: Rollouts begun since training or loading; the next one draws its actions from `action_seed` plus this.
    """

    config_class = EpisodePolicyConfig
    name = "episode_policy"
    loss_name = "action_loss"  # in the training log
    network: EpisodeNetwork

    def __init__(
        self,
        config: EpisodePolicyConfig,
        dataset_stats: Stats | None = None,
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
            learn_about(config, dataset_meta)
        config.fill_in()
        config.validate_features()
        super().__init__(config)
        self.config: EpisodePolicyConfig = config
        backbone = make_backbone(config)
        self.eyes = backbone if isinstance(backbone, FrozenBackbone) else None
        self.frames = TrainingFrames(config, dataset_stats, dataset_meta, self.eyes)
        self.network = self.make_network(self.frames.action_bounds.clone(), backbone)
        self.instructions, self._pictures = InstructionReader(config), ShownPictures(config)
        config.pretrained_backbone_weights = None  # from here on the checkpoint brings them, without a download
        self._symmetries = find_symmetries(config, dataset_meta.features) if dataset_meta and config.augment else None
        self._known_losses = KnownLosses()
        self._history: Any = None
        self._told: list[Any] = []
        self.rollouts = 0
        self._generator = torch.Generator()

    # What a policy fills in.

    @abstractmethod
    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> EpisodeNetwork:
        """The method itself, of the configured size.

        Args:
            action_bounds: Least and greatest of real-valued actions, (2, A).
            backbone: Of pictures, for `make_observation_encoder`.
        """

    @abstractmethod
    def predict(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> tuple[Tensor, Tensor, Metrics]:
        """Predictions for all frames that are learned from, what else enters the loss, and numbers worth logging."""

    # Training.

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Loss of the episodes, or parts of episodes, that a batch's frames belong to.

        Args:
            batch: From LeRobot's loader and this policy's preprocessor. Read are `index` (B,),
                `observation.language.tokens` (B, M) and `observation.language.attention_mask` (B, M).
            reduction: "mean", or "none" for one loss per frame of the batch, (B,).

        Returns:
            The loss and numbers for the training log.

        Raises:
            UserError: The policy was built without a dataset, or its episodes cannot be read or used.
        """
        self.rollouts = 0  # so that evaluation in training draws what `lerobot-eval` of the checkpoint will
        held_out = not self.training and not torch.is_grad_enabled()
        losses, extra, metrics = self._known(batch) if held_out else self._losses(batch)
        loss = losses if reduction == "none" else losses.mean()
        return loss + extra, _numbers({**metrics, self.loss_name: losses.mean()})

    def _losses(self, batch: Mapping[str, Any]) -> Losses:
        frames, packing = self.gather(batch)
        tokens, tokens_valid = self.instructions.read(batch)
        with drawing_from(batch, self._device) if self.training else nullcontext():
            if self.training and self._symmetries is not None:
                frames, tokens = self._symmetries(Told(frames, tokens), packing)
            actions, observations = frames[ACTION], {key: frames[key] for key in self.config.input_features}
            losses, extra, metrics = self.frame_losses(tokens, tokens_valid, observations, actions, packing)
        return packing.learned.mean(losses), extra, metrics

    def frame_losses(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> Losses:
        """Loss of every frame that is learned from, what else enters the loss, and numbers worth logging.

        That of imitation, of what `predict` predicts; policies that learn something else overwrite it.
        """
        outputs, extra, metrics = self.predict(tokens, tokens_valid, frames, actions, packing)
        head = self.network.head
        if packing.learned_rows is not None:
            actions = actions[packing.learned_rows]
        return head.loss(outputs, actions), extra, {**metrics, **head.metrics(outputs.detach(), actions)}

    def _known(self, batch: Mapping[str, Any]) -> Losses:
        """The same in a validation, where frames of one episode come one after another."""
        tokens, valid = self.instructions.read(batch)
        told = tokens.masked_fill(~valid, -1).tolist()
        parts = self.frames.parts(batch, self._device)
        keys = [(*part, *(token for token in words if token >= 0)) for part, words in zip(parts, told, strict=True)]
        return self._known_losses.look_up(keys, state_of(self), lambda rows: self._losses(rows_of(batch, rows)))

    def train(self, mode: bool = True) -> "EpisodePolicy":
        """Whoever begins to train, or to validate, computes everything anew."""
        self._known_losses.forget()
        return super().train(mode)

    def gather(self, batch: Mapping[str, Any]) -> tuple[dict[str, Tensor], Packing]:
        """The episodes of a batch's frames, or excerpts of them, under the policy's names and in its scale.

        An episode is a run of frames with one task, as in a rollout, which starts anew with every instruction.
        Excerpts bring what before them can matter to their predictions (`EpisodeNetwork.reach`).

        Returns:
            Features of all N frames, each (N, *shape), actions (N, A), and where each episode lies among them.
        """
        if self.frames.store is None:
            by_datasets = self.frames.settle_statistics(batch, self._device)
            if by_datasets and isinstance(self.network.head, RealHead):  # whatever a checkpoint knows of actions
                self.network.head.bounds.copy_(self.frames.action_bounds)
        return self.frames.gather(batch, self._device, self.network.reach, self.training)

    def scaled(self, frames: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What the preprocessor does to observations and actions in a rollout, done to stored ones."""
        return self.frames.scaled(frames)

    @property
    def episode_store(self) -> EpisodeStore:
        """Every episode of the training dataset, read at first use."""
        return self.frames.episodes({}, self._device)

    @property
    def _device(self) -> torch.device:
        return next(self.parameters()).device

    # Rollouts.

    @property
    def looks(self) -> dict[str, Tensor] | None:
        """Where skill code (LISA) or words (Lang-DT) looked in the newest observation, (B, places) for each feature.

        Places are a grid's cells or a picture's patches, row by row as the feature's shape has them; what is missing to
        1 for each question looked at nothing. None before the first step, and if nothing is asked.
        """
        looks = None if self._history is None else self._history.looks
        if looks is None:
            return None
        places = self.network.observations.places
        looked = zip(places, looks.split(list(places.values()), dim=1), strict=True)
        return {key: at for key, at in looked if at.shape[1]}

    @property
    def questions(self) -> Tensor | None:
        """How many questions each newest observation was asked, (B,): a code's parts, or words that ask (Lang-DT)."""
        return None if self._history is None else self._history.questions

    def reset(self) -> None:
        """Forget the rollout: the next observation is an episode's first."""
        self._history = None

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **_: Any) -> Tensor:
        """One action for each of B environments that were reset together.

        Another instruction than the step before starts a new episode.

        Args:
            batch: From this policy's preprocessor: observation features (B, *shape), instruction tokens (B, M) and, to
                tell instructions apart whose words are all unknown, their texts.

        Returns:
            Actions (B, A); categorical ones as class numbers (B, 1).

        Raises:
            UserError: The environment does not show what the policy was trained on, or a number is not finite.
        """
        self.action_outputs(batch)
        return self._history.actions

    @torch.no_grad()
    def action_outputs(self, batch: dict[str, Any]) -> Tensor:
        """Advance the rollout by one step; returns what actions are picked from: logits (B, classes) or means."""
        self.eval()
        observations = self._observations(batch)
        told = told_apart_by(batch)
        if self._history is None or told != self._told:
            facts = (batch.get(TransitionKey.INFO.value) or {}).get(KEY, {})
            check_feature_info(self.config.feature_info or {}, facts)
            self.instructions.warn(batch)
            self._begin(*self.instructions.read(batch))
            self._told = told
        outputs = self.network.act(self._history, observations)
        if not torch.isfinite(outputs).all():
            raise UserError(_blame_world(observations))
        self._history.actions = self.network.head.pick(outputs, self._generator)
        return outputs

    def _observations(self, batch: Mapping[str, Any]) -> dict[str, Tensor]:
        """What the policy looks at, (B, *shape) each; `UserError` if the world does not show it."""
        wanted, count = self.config.input_features, len(given_tokens(batch))
        if missing := [key for key in wanted if key not in batch]:
            shown = ", ".join(sorted(key for key in batch if key.startswith(OBS_PREFIX) and "language" not in key))
            raise UserError(
                f"the policy was trained on {', '.join(missing)}, but the environment shows {shown or 'nothing'}: "
                "choose the world it was trained in, or what that shows (LOReL: --env.obs_type=state, pixels or "
                "pixels_state)"
            )
        for key, feature in wanted.items():
            shape = tuple(getattr(batch[key], "shape", ()))
            if len(shape) < 2 or shape[0] != count or not _same_size(shape[1:], feature):
                raise UserError(
                    f"`{key}` has shape {shape}, but the policy takes {(count, *feature.shape)}, a row for each "
                    "instruction: add the batch dimension, or choose the world it was trained in"
                )
        return {key: self._looked_at(key, batch[key], feature) for key, feature in wanted.items()}

    def _looked_at(self, key: str, value: Tensor, feature: PolicyFeature) -> Tensor:
        """Pictures of the trained size, or what a frozen backbone says of them; everything else as it is."""
        value = self._pictures.as_trained(key, value, feature)
        return value if self.eyes is None or feature.type is not FeatureType.VISUAL else self.eyes(value)

    def _begin(self, tokens: Tensor, valid: Tensor) -> None:
        """Start a rollout; what it draws depends on how many came before it, not on what else used random numbers."""
        self._history = self.network.begin(tokens, valid)
        self._generator = torch.Generator(tokens.device).manual_seed(self.config.action_seed + self.rollouts)
        self.rollouts += 1

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Actions (B, 1, A): both policies look at every observation, so a chunk is one action long."""
        return self.select_action(batch, **kwargs)[:, None]

    # Checkpoints and the Hub.

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        """Copies, where weights share memory: on a GPU those of a recurrent network do, which safetensors refuses."""
        if state_dict is None and _share_memory(held := self.state_dict()):
            state_dict = {name: value.detach().cpu().clone() for name, value in held.items()}
        super()._save_pretrained(save_directory, state_dict=state_dict)

    @classmethod
    def _load_as_safetensor(
        cls, model: "EpisodePolicy", model_file: str, map_location: str, strict: bool
    ) -> "EpisodePolicy":
        """Fill in the weights; all must be there, whatever `strict` says: random ones act without a word."""
        try:
            with at_saved_size(model.network, model_file) if model.frames.dataset else nullcontext():
                missing, unexpected = load_model(model, model_file, strict=False, device=map_location)
        except (RuntimeError, OSError, SafetensorError) as error:
            reason = " ".join(str(error).split()).removeprefix(f"Error(s) in loading state_dict for {cls.__name__}: ")
            raise UserError(
                f"{model_file}: the weights do not fit the policy here ({reason:.200}): choose the world it was "
                "trained in, or another checkpoint"
            ) from error
        if missing or (strict and unexpected):
            names = ", ".join(sorted(missing or unexpected))
            raise UserError(f"{model_file}: weights are missing or unknown ({names:.200}): take another checkpoint")
        return model

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


def find_symmetries(config: EpisodePolicyConfig, features: dict[str, dict[str, Any]]) -> Symmetries | None:
    """Those that one of the policy's features names."""
    for key in config.input_features or {}:
        if (features.get(key, {}).get("info") or {}).get("symmetries"):
            return Symmetries(key, features, {word: ids[0] for word, ids in config.lexicon.items() if len(ids) == 1})
    return None


def _numbers(metrics: Metrics) -> dict[str, float]:
    """Scalars as numbers: one wait for the device, not one for each."""
    values = torch.stack([value.detach().float() for value in metrics.values()]).tolist()
    return dict(zip(metrics, values, strict=True))


def _blame_world(observations: Mapping[str, Tensor]) -> str:
    """Why predictions are not finite."""
    for key, value in observations.items():
        if not torch.isfinite(value).all():
            return f"`{key}` holds NaN or infinite numbers: look at the sensor; no action is taken on it"
    return "the policy's weights make predictions that are NaN or infinite: take another checkpoint"


def _same_size(shape: tuple[int, ...], feature: PolicyFeature) -> bool:
    """Whether an observation fits; images may have another height and width."""
    if feature.type is FeatureType.VISUAL:
        return len(shape) == 3 and shape[0] == feature.shape[0]
    return math.prod(shape) == math.prod(feature.shape)


def _share_memory(state: Mapping[str, Tensor]) -> bool:
    return len({value.untyped_storage().data_ptr() for value in state.values()}) < len(state)
