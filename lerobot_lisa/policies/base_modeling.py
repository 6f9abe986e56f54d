"""What both policies share of LeRobot's protocol: whole episodes in training, a history in rollouts, weights, cards."""

import hashlib
import logging
import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from huggingface_hub import ModelCard
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS, OBS_PREFIX
from safetensors import SafetensorError
from safetensors.torch import load_model
from torch import Tensor

from lerobot_lisa.episodes.check import check_metadata
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.picture_transforms import PictureTransforms
from lerobot_lisa.episodes.pictures import resize
from lerobot_lisa.episodes.runs import task_runs
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.episodes.symmetries import Symmetries, Told, symmetry_words
from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import KEY, check_feature_info
from lerobot_lisa.networks.episode_network import EpisodeNetwork
from lerobot_lisa.networks.excerpts import cut
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.real_actions import RealHead
from lerobot_lisa.policies.base_configuration import WORDS, EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import (
    InstructionStep,
    Stats,
    build_vocabulary,
    make_normalizer,
    make_tokenizer,
    plain_ids,
    saved_statistics,
    split_words,
)
from lerobot_lisa.policies.fine_tuning import at_saved_size
from lerobot_lisa.policies.lexicon import build_lexicon, symbol_words
from lerobot_lisa.policies.model_card import make_model_card
from lerobot_lisa.policies.parts import named_symbols
from lerobot_lisa.policies.renaming import renamed_features

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
            _learn_about(config, dataset_meta)
        config.fill_in()
        config.validate_features()
        super().__init__(config)
        self.config: EpisodePolicyConfig = config
        self._normalize = make_normalizer(config, dataset_stats)
        self._bounds = self._action_bounds(dataset_stats)
        self.network = self.make_network(self._bounds.clone())
        self._reader = InstructionStep(make_tokenizer(config)) if config.language_encoder == WORDS else None
        self._warned: set[str] = set()
        config.pretrained_backbone_weights = None  # from here on the checkpoint brings them, without a download
        self._dataset = dataset_meta
        self._symmetries = find_symmetries(config, dataset_meta.features) if dataset_meta and config.augment else None
        changes = dataset_meta is not None and config.image_transforms.enable  # of no use to what only acts
        self._change = PictureTransforms(config.image_transforms) if changes else None
        self._store: EpisodeStore | None = None
        self._history: Any = None
        self._instructions: list[Any] = []
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
        frames, packing = self.gather(batch)
        tokens, tokens_valid = self._words(batch)
        with _drawing_from(batch, self._device) if self.training else nullcontext():
            if self.training and self._symmetries is not None:
                frames, tokens = self._symmetries(Told(frames, tokens), packing)
            actions, observations = frames[ACTION], {key: frames[key] for key in self.config.input_features}
            outputs, extra_loss, metrics = self.predict(tokens, tokens_valid, observations, actions, packing)
        head = self.network.head
        if packing.learned_rows is not None:
            actions = actions[packing.learned_rows]
        action_loss = packing.learned.mean(head.loss(outputs, actions))  # (B,)
        metrics = {**metrics, "action_loss": action_loss.mean(), **head.metrics(outputs.detach(), actions)}
        loss = action_loss if reduction == "none" else action_loss.mean()
        return loss + extra_loss, _numbers(metrics)

    def gather(self, batch: Mapping[str, Any]) -> tuple[dict[str, Tensor], Packing]:
        """The episodes of a batch's frames, or excerpts of them, under the policy's names and in its scale.

        An episode is a run of frames with one task, as in a rollout, which starts anew with every instruction.
        Excerpts bring what before them can matter to their predictions (`EpisodeNetwork.reach`).

        This is no step of the preprocessor, which would rename and scale whole episodes as it does single frames:
        LeRobot rebuilds the preprocessor from JSON to resume and to fine-tune, and tells its steps nothing of the
        dataset that is trained on then. So names are found as the batch shows them renamed, and the scaling is the
        preprocessor's own step, made of the same statistics by the same function.

        Returns:
            Features of all N frames, each (N, *shape), actions (N, A), and where each episode lies among them.
        """
        first = self._store is None
        store, index = self._episodes(batch), batch["index"].reshape(-1).cpu()
        if first:
            self._settle_statistics(batch, store.frames(index))
        frames, packing = self._cut(store, index) if self.config.learned_steps else self._whole(store, index)
        if self.training and self._change is not None:
            cameras = [key for key, value in self.config.input_features.items() if value.type is FeatureType.VISUAL]
            with _drawing_from(batch, self._device, "pictures"):
                frames = self._change(frames, cameras, packing)
        return self._as_numbers(self.scaled(frames)), packing

    def _whole(self, store: EpisodeStore, index: Tensor) -> tuple[dict[str, Tensor], Packing]:
        """The whole episodes that hold frames (B,)."""
        return store.gather(store.holding(index), self._device)

    def _cut(self, store: EpisodeStore, index: Tensor) -> tuple[dict[str, Tensor], Packing]:
        """The excerpts that hold frames (B,)."""
        episodes, config = store.holding(index), self.config
        starts, lengths = store.starts[episodes], store.lengths[episodes]
        drawn, reach = index - starts, self.network.reach
        packing = cut(lengths, drawn, config.learned_steps, reach, config.look_stride, self._device)
        return store.frames(starts[packing.sequence_cpu] + packing.steps_cpu, self._device), packing

    def _as_numbers(self, frames: dict[str, Tensor]) -> dict[str, Tensor]:
        """Actions as (N, A), numbers to subtract."""
        actions = frames[ACTION].reshape(len(frames[ACTION]), -1)
        frames[ACTION] = actions.float() if actions.dtype == torch.bool else actions
        return frames

    def scaled(self, frames: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What the preprocessor does to observations and actions in a rollout, done to stored ones."""
        observations = {key: _unit_range(value, self.config.input_features.get(key)) for key, value in frames.items()}
        del observations[ACTION]
        scaled = self._normalize({TransitionKey.OBSERVATION: observations, TransitionKey.ACTION: frames[ACTION]})
        return {**scaled[TransitionKey.OBSERVATION], ACTION: scaled[TransitionKey.ACTION]}

    @property
    def episode_store(self) -> EpisodeStore:
        """Every episode of the training dataset, read at first use."""
        return self._episodes({})

    def _episodes(self, batch: Mapping[str, Any]) -> EpisodeStore:
        if self._store is None:
            if self._dataset is None:
                raise UserError(
                    f"{self.name} learns from whole episodes: build it with make_policy(cfg, ds_meta=dataset.meta)"
                )
            tell_apart = partial(self._tell_apart, self._dataset, batch)
            ours = renamed_features(self.config.input_features, self._dataset.features, batch, tell_apart)
            theirs = {name: key for key, name in ours.items()}
            keys = [*(theirs.get(key, key) for key in self.config.input_features), ACTION]
            location = self.config.episode_store
            store = load_episodes(self._dataset, keys, location, self.config.image_size).renamed(ours)
            self._store = store.to(self._device) if location == "device" else store
        return self._store

    def _settle_statistics(self, batch: Mapping[str, Any], stored: Mapping[str, Tensor]) -> None:
        """Scale as the preprocessor does: by the checkpoint's statistics if it resumes, by the dataset's otherwise.

        LeRobot does not tell a policy which of the two it does, but a batch shows it.
        """
        wrong = self._scaled_otherwise(batch, stored)
        if wrong is None:  # so what a checkpoint knows of actions gives way to the dataset's
            if isinstance(self.network.head, RealHead):
                self.network.head.bounds.copy_(self._bounds)
            return
        if self.config.pretrained_path:
            self._normalize = make_normalizer(self.config, saved_statistics(self.config))
            wrong = self._scaled_otherwise(batch, stored)
        if wrong is not None:
            raise UserError(
                f"the preprocessor scales `{wrong}` by other statistics than the dataset's and the checkpoint's: make "
                "it with make_pre_post_processors(cfg, dataset_stats=dataset.meta.stats)"
            )

    def _scaled_otherwise(self, batch: Mapping[str, Any], stored: Mapping[str, Tensor]) -> str | None:
        """A feature of a batch that was scaled in another way than stored ones of the same frames are."""
        frames = self._as_numbers(self.scaled({key: value.to(self._device) for key, value in stored.items()}))
        numbers = [key for key, value in self.config.input_features.items() if value.type is FeatureType.STATE]
        for key in (key for key in (*numbers, ACTION) if key in batch):
            ours, theirs = frames[key].float(), batch[key].to(self._device).float()
            if not torch.allclose(ours.flatten(), theirs.flatten(), rtol=1e-3, atol=1e-4, equal_nan=True):
                return key
        return None

    def _tell_apart(
        self, dataset: "LeRobotDatasetMetadata", batch: Mapping[str, Any], key: str, names: list[str]
    ) -> str | None:
        """Which of the dataset's features of one shape a batch has under the name `key`; None if it cannot be said."""
        stored = load_episodes(dataset, names, "memory", self.config.image_size).frames(batch["index"].cpu())
        feature, shown = self.config.input_features[key], batch[key].cpu()
        shown = _unit_range(self._small(shown, feature), feature).float()
        apart = {}
        for name in names:
            scaled = self._normalize({TransitionKey.OBSERVATION: {key: _unit_range(stored[name], feature)}})
            apart[name] = (scaled[TransitionKey.OBSERVATION][key].cpu().float() - shown).abs().mean().item()
        nearest, second = sorted(names, key=lambda name: apart[name])[:2]
        return nearest if apart[nearest] < 0.5 * apart[second] else None

    def _action_bounds(self, stats: Stats | None) -> Tensor:
        """Least and greatest demonstrated action (2, A), normalised; a checkpoint brings its own."""
        size = self.config.action_feature.shape[0]
        if not stats or ACTION not in stats:
            return torch.tensor([[-1.0], [1.0]]).expand(2, size).clone()
        bounds = torch.stack([torch.as_tensor(stats[ACTION][name]).float().view(size) for name in ("min", "max")])
        return self.scaled({ACTION: bounds})[ACTION].cpu()

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
        instructions = _instructions(batch)
        if self._history is None or instructions != self._instructions:
            told = (batch.get(TransitionKey.INFO.value) or {}).get(KEY, {})
            check_feature_info(self.config.feature_info or {}, told)
            self._warn_of(batch)
            self._begin(*self._words(batch))
            self._instructions = instructions
        outputs = self.network.act(self._history, observations)
        if not torch.isfinite(outputs).all():
            raise UserError(_blame_world(observations))
        self._history.actions = self.network.head.pick(outputs, self._generator)
        return outputs

    def _words(self, batch: Mapping[str, Any]) -> tuple[Tensor, Tensor]:
        """Instruction tokens (B, M) and which of them are real (B, M).

        With the built-in language encoder the policy reads the texts itself where a batch brings them: once it has been
        fine-tuned it knows more words than the tokenizer that LeRobot has kept from the checkpoint.
        """
        if OBS_LANGUAGE_TOKENS not in batch:
            raise UserError(f"the batch has no {OBS_LANGUAGE_TOKENS}: pass it through the policy's preprocessor")
        tokens, valid = batch[OBS_LANGUAGE_TOKENS], batch[OBS_LANGUAGE_ATTENTION_MASK].bool()
        texts = batch.get("task")
        if self._reader is not None and isinstance(texts, list) and len(texts) == len(tokens):
            tokens, valid = (part.to(tokens.device) for part in self._reader.tokenise(texts))
        return tokens, valid

    def _warn_of(self, batch: Mapping[str, Any]) -> None:
        """Say once of each instruction what of it the policy cannot know."""
        texts = batch.get("task")
        for text in dict.fromkeys([texts] if isinstance(texts, str) else texts or []):
            if text in self._warned or len(self._warned) >= 1000:
                continue
            self._warned.add(text)
            if not text.strip():
                logging.warning("the instruction is blank: say what is to be done, such as with --task")
            elif self._reader is not None and (new := _unknown(text, self.config.vocabulary)):
                logging.warning("instruction %.200r: no training instruction has %s", text, ", ".join(new)[:200])

    def _observations(self, batch: Mapping[str, Any]) -> dict[str, Tensor]:
        """What the policy looks at, (B, *shape) each; `UserError` if the world does not show it."""
        wanted, count = self.config.input_features, len(self._words(batch)[0])
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
        return {key: self._small(batch[key], feature) for key, feature in wanted.items()}

    def _small(self, value: Tensor, feature: PolicyFeature) -> Tensor:
        """Pictures as they wait in the episode store."""
        size = self.config.image_size
        if feature.type is not FeatureType.VISUAL or size is None or max(value.shape[-2:]) <= size:
            return value
        # Pictures that the preprocessor scales were small in training (`validate_features`): no bytes any more.
        return value if self.config.is_scaled(FeatureType.VISUAL) else resize(value, size)

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

    @classmethod
    def _load_as_safetensor(
        cls, model: "EpisodePolicy", model_file: str, map_location: str, strict: bool
    ) -> "EpisodePolicy":
        """Fill in the weights; all must be there, whatever `strict` says: random ones act without a word."""
        try:
            with at_saved_size(model.network, model_file) if model._dataset else nullcontext():
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


def _learn_about(config: EpisodePolicyConfig, meta: "LeRobotDatasetMetadata") -> None:
    """What LeRobot's hook for features has not been told."""
    named = (*(config.input_features or {}), ACTION)  # `--rename_map` gives some other names than the dataset's
    check_metadata(meta, [key for key in named if key in meta.features])
    longest, tuned = int(task_runs(meta).lengths.max()), bool(config.pretrained_path)
    config.set_dataset_statistics(meta.stats, longest)
    if tuned and config.max_timesteps is not None:
        config.max_timesteps = max(config.max_timesteps, longest)
    tasks = [str(task) for task in meta.tasks.index]
    if config.language_encoder == WORDS and (tuned or not config.vocabulary):
        new = sorted(set(build_vocabulary(tasks)) - set(config.vocabulary))
        config.vocabulary = [*config.vocabulary, *new]  # known words keep their numbers
        logging.info("%s: vocabulary of %d words, %d of them new", config.type, len(config.vocabulary), len(new))
    if tuned or not config.lexicon:
        symbols = [spoken for spoken in named_symbols(config).values() if spoken]
        names = [word for spoken in symbols for word in symbol_words(spoken)] + symmetry_words(meta.features)
        tokenizer = make_tokenizer(config)
        found = build_lexicon(map(split_words, tasks), names, lambda text: plain_ids(tokenizer, text))
        config.lexicon = {**found, **config.lexicon} if tuned else found


def find_symmetries(config: EpisodePolicyConfig, features: dict[str, dict[str, Any]]) -> Symmetries | None:
    """Those that one of the policy's features names."""
    for key in config.input_features or {}:
        if (features.get(key, {}).get("info") or {}).get("symmetries"):
            return Symmetries(key, features, {word: ids[0] for word, ids in config.lexicon.items() if len(ids) == 1})
    return None


def _unknown(text: str, vocabulary: list[str]) -> list[str]:
    """Words of an instruction that are not in the vocabulary."""
    known = set(vocabulary)
    return [word for word in dict.fromkeys(split_words(text)) if word not in known]


def _instructions(batch: Mapping[str, Any]) -> list[Any]:
    """What tells B instructions from others: their texts, or their tokens where a batch does not bring the texts."""
    task = batch.get("task")
    return list(task) if task is not None and not isinstance(task, str) else [task, batch[OBS_LANGUAGE_TOKENS].tolist()]


@contextmanager
def _drawing_from(batch: Mapping[str, Any], device: torch.device, *purpose: str) -> Iterator[None]:
    """Let a training step draw (dropout, codes to revive) from a seed that its frames make, in their order.

    LeRobot restores torch's generator when it resumes, but its loader then draws from it once more than without an
    interruption. Which frames make a step depends on `--seed` and the step alone, resumed or not.
    """
    frames = batch["index"]
    rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
    drawn = hashlib.blake2b(repr((rank, frames.reshape(-1).tolist(), *purpose)).encode(), digest_size=7)
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        torch.manual_seed(int.from_bytes(drawn.digest()))
        yield


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


def _unit_range(stored: Tensor, feature: PolicyFeature | None) -> Tensor:
    """Pictures wait in the store as bytes; rollouts and statistics have them in 0..1."""
    if feature is None or feature.type is not FeatureType.VISUAL:
        return stored
    return stored.float() / 255 if stored.dtype == torch.uint8 else stored
