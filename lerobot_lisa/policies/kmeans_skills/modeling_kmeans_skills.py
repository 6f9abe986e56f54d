"""The k-means-skills policy in LeRobot's protocol: LISA with clusters in the place of what it learns about skills."""

from math import ceil, prod
from typing import Any

import torch
from torch import Tensor, nn

from lerobot_lisa.episodes.runs import task_runs
from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.kmeans_skills import KMeansCodes, PlainNumbers, WholeVectors
from lerobot_lisa.networks.language import pad_tokens
from lerobot_lisa.networks.lisa import Lisa
from lerobot_lisa.networks.one_observation import OneObservation
from lerobot_lisa.networks.termination import Termination
from lerobot_lisa.policies.base_processor import LONGEST, make_tokenizer
from lerobot_lisa.policies.kmeans_skills.configuration_kmeans_skills import KMeansSkillsConfig
from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy, make_action_predictor
from lerobot_lisa.policies.parts import make_language_encoder, make_observation_encoder

MOST_FRAMES = 200_000  # that are clustered
TOGETHER = 256  # episodes at a time


class KMeansSkillsPolicy(LisaPolicy):
    """Skills by k-means on language and states, and a policy that follows them (the LISA paper's own comparison)."""

    config_class = KMeansSkillsConfig
    name = "kmeans_skills"
    config: KMeansSkillsConfig

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> Lisa:
        """LISA's network with its skill predictor and its codebook replaced."""
        config, language = self.config, make_language_encoder(self.config)
        width = config.dim_model + sum(prod(feature.shape) for feature in config.input_features.values())
        return Lisa(
            language=language.requires_grad_(False),
            observations=make_observation_encoder(config, language, backbone),
            predictor=OneObservation(nn.Identity()),
            source=WholeVectors(width),  # type: ignore[arg-type]
            quantizer=KMeansCodes(width, config.codebook_size),
            skill_embedding=nn.Linear(width, config.dim_model),
            action_predictor=make_action_predictor(config, action_bounds),
            termination=Termination(config.horizon),
            predictor_observations=PlainNumbers(config.input_features),  # type: ignore[arg-type]
        )

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Loss of whole episodes, as every policy's; the first call in training clusters the dataset."""
        codes: Any = self.network.quantizer
        if self.training and not codes.initialised:
            codes.place(self._vectors(batch))
        return super().forward(batch, reduction)

    @torch.no_grad()
    def _vectors(self, batch: dict[str, Any]) -> Tensor:
        """What language and states are at every frame of the dataset, or at enough of them, (n, D + S)."""
        self.gather(batch)  # from here on there is a store, and it is known how to scale what is in it
        store, instructions = self.episode_store, self._instructions_of_runs()
        every = ceil(int(store.lengths[store.present].sum()) / MOST_FRAMES)
        vectors = []
        for episodes in store.present.nonzero()[:, 0].split(TOGETHER):
            frames, packing = store.gather(episodes, self._device)
            tokens, valid = (part.to(self._device) for part in pad_tokens([instructions[i] for i in episodes.tolist()]))
            said, seen = self.network.language(tokens, valid), self.network.predictor_observations
            state = seen(self.scaled(frames), said.tokens[0]).summary  # type: ignore[misc]
            vectors.append(self.network.predictor(said.tokens, valid, state, packing, 1)[::every])
        return torch.cat(vectors)

    def _instructions_of_runs(self) -> list[list[int]]:
        """Token ids of every episode of the store."""
        meta, tokenizer = self.frames.dataset, make_tokenizer(self.config)
        assert meta is not None  # the store has been read
        tasks = dict(zip(meta.tasks["task_index"], meta.tasks.index, strict=True))
        ids = {task: tokenizer.encode(str(text)).ids[:LONGEST] or [1] for task, text in tasks.items()}
        return [ids.get(task, [1]) for task in task_runs(meta).tasks]
